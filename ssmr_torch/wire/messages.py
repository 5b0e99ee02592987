"""The messages between a robot and a controller: one fixed layout, little-endian (docs/wire.md).

    0   char[4]     "SSMR"
    4   uint8       version
    5   uint8       kind
    6   uint16      status
    8   uint32      run
    12  uint32      count
    16  uint64      sequence
    24  float64     time
    32  float64[count], of HELLO, START, REFUSE and END char[count] of UTF-8
"""

from __future__ import annotations

import json
import struct
from dataclasses import asdict, dataclass, field, fields
from enum import IntEnum

import numpy as np

from ssmr_torch.wire import limits

MAGIC, VERSION, SEALED = b"SSMR", 1, 2  # SEALED: the version of a signed frame, see `ssmr_torch.wire.seal`
HEADER = struct.Struct("<4sBBHIIQd")


class Kind(IntEnum):
    """The kind of a message; → from the robot to the controller, ← from the controller to the robot."""

    HELLO = 1        # → the robot's description as JSON; the robot asks for a run
    START = 2        # ← {"seed": …} as JSON; reset and send measurement 0 of this run
    REFUSE = 3       # ← the reason as text; status BUSY: ask again later
    MEASUREMENT = 4  # → the observation, with the robot's time stamp
    COMMAND = 5      # ← the input for the measurement with the same number, and the solve time
    END = 6          # ↔ this run is over; text: the reason; status OK: as intended, SUSPENDED: the run can go on later;
                     #   the robot applies its safe input


class Code(IntEnum):
    """The status of a COMMAND, REFUSE or END. Those from 3 on are the fallbacks of `ssmr_torch.status.Status`."""

    OK = 0
    HELD = 1
    MISSED = 2
    ITERATION_LIMIT = 3
    PRIMAL_INFEASIBLE = 4
    CLOSEST_FEASIBLE = 5
    DUAL_INFEASIBLE = 6
    NOT_RUN = 7
    NOT_FINITE = 8
    RESIDUAL_TOO_LARGE = 9
    NOT_DESCENDING = 10
    OUT_OF_RANGE = 11
    FROZEN_SENSOR = 12
    WRONG_TIME = 13
    SUSPENDED = 253
    BUSY = 254
    OTHER = 255


_TEXTS = (Kind.HELLO, Kind.START, Kind.REFUSE, Kind.END)


class Malformed(ValueError):
    """Bytes that are not a message of this version."""


@dataclass(frozen=True, eq=False)
class Message:
    """One message.

    run: number of the run, chosen by the controller in START.   sequence: number of the sample, from 0; in a HELLO the
    number of the request, which START and REFUSE repeat.
    time: s; the robot's own clock in a measurement, the solve time in a command.   values: float64, (p,) m in a
    measurement, (m,) in a command.   text: of the other kinds.
    """

    kind: Kind
    run: int = 0
    sequence: int = 0
    time: float = 0.0
    status: int = Code.OK
    values: np.ndarray = field(default_factory=lambda: np.empty(0))
    text: str = ""

    def pack(self) -> bytes:
        """The bytes to send."""
        if self.kind in _TEXTS:
            body = self.text.encode(errors="replace")[:limits.LARGEST_BODY]
            count = len(body)
        else:
            body, count = np.asarray(self.values, dtype="<f8").tobytes(), len(self.values)
        return HEADER.pack(MAGIC, VERSION, self.kind, self.status, self.run, count, self.sequence, self.time) + body


def unpack(data: bytes) -> Message:
    """Read a message. Raises Malformed for bytes that are no message of this version. Values may be NaN, times not."""
    if len(data) < HEADER.size:
        raise Malformed(f"a message of {len(data)} bytes; expected at least the header of {HEADER.size} bytes")
    magic, version, number, status, run, count, sequence, time = HEADER.unpack_from(data)
    if magic != MAGIC or version != VERSION:
        remedy = "give this end the other's key" if version == SEALED else "use the same release on both sides"
        raise Malformed(f"a message that begins with {magic!r}, version {version}; "
                        f"expected {MAGIC!r}, version {VERSION}: {remedy}")
    if number not in Kind._value2member_map_:
        raise Malformed(f"a message of kind {number}; expected 1 to {max(Kind)}")
    kind = Kind(number)
    body = count * (1 if kind in _TEXTS else 8)
    expected = HEADER.size + body
    if body > limits.LARGEST_BODY or len(data) != expected:
        raise Malformed(f"a {kind.name} of {len(data)} bytes with a count of {count}; expected {expected} bytes")
    if not np.isfinite(time):
        raise Malformed(f"a {kind.name} with the time {time}; expected a finite number of s")
    if kind in _TEXTS:
        try:
            return Message(kind, run, sequence, time, status, text=data[HEADER.size:].decode())
        except UnicodeDecodeError as error:
            raise Malformed(f"a {kind.name} whose text is not UTF-8: {error}") from error
    values = np.frombuffer(data, "<f8", count, HEADER.size).astype(np.float64)
    return Message(kind, run, sequence, time, status, values)


@dataclass(frozen=True)
class RobotDescription:
    """What a robot says of itself in its HELLO. The names are those of a `Plant`.

    timestep: s, between two measurements.   rest: (p,) m.   input_bounds: (2, m).   real_time: True: time goes on
    without a command; False: the robot waits for every command (lock-step).
    Raises ValueError when sizes disagree, and for what is outside the limits (`ssmr_torch.wire.limits`).
    """

    name: str
    output_names: tuple[str, ...]
    input_names: tuple[str, ...]
    timestep: float
    rest: np.ndarray
    input_bounds: np.ndarray
    input_unit: str = "N"
    length_unit: str = "m"
    real_time: bool = False

    def __post_init__(self):
        checked = {"name": limits.name("the robot's name", self.name), "timestep": limits.timestep(self.timestep),
                   "output_names": limits.names("output_names", self.output_names, limits.MOST_OUTPUTS),
                   "input_names": limits.names("input_names", self.input_names, limits.MOST_INPUTS),
                   "rest": limits.numbers("rest", self.rest),
                   "input_bounds": limits.numbers("input_bounds", self.input_bounds),
                   "input_unit": limits.name("the robot's input_unit", self.input_unit)}
        for part, value in checked.items():
            object.__setattr__(self, part, value)
        p, m = len(self.output_names), len(self.input_names)
        if not p or not m or self.rest.shape != (p,) or self.input_bounds.shape != (2, m):
            raise ValueError(f"the robot has {p} output names and a rest of shape {self.rest.shape}, {m} input names "
                             f"and input_bounds of shape {self.input_bounds.shape}; expected (p,) and (2, m)")
        if not (self.input_bounds[0] < self.input_bounds[1]).all():
            raise ValueError(f"the robot's input_bounds are {limits.legible(str(self.input_bounds.tolist()))}; "
                             "expected the lowest below the highest")
        if not isinstance(self.real_time, bool):
            raise ValueError(f"the robot's real_time is {limits.legible(repr(self.real_time))}; expected true or false")
        if self.length_unit != "m":
            raise ValueError(f"the robot measures in {limits.legible(repr(self.length_unit))}; expected 'm', as in the "
                             "controller: convert the observation and rest to m")

    @classmethod
    def of(cls, plant, real_time: bool = False) -> RobotDescription:
        """The description of a `Plant`."""
        return cls(plant.name, plant.output_names, plant.input_names, float(plant.timestep), plant.rest,
                   plant.input_bounds, plant.input_unit, real_time=bool(real_time))

    @property
    def text(self) -> str:
        """The JSON of a HELLO."""
        arrays = {"rest": self.rest.tolist(), "input_bounds": self.input_bounds.tolist()}
        return json.dumps(asdict(self) | arrays)


def read_description(text: str) -> RobotDescription:
    """The description in a HELLO. Raises ValueError, with the reason, where it cannot be read."""
    content = limits.json_object(text, "a HELLO")
    known = {part.name for part in fields(RobotDescription)}
    needed = {"name", "output_names", "input_names", "timestep", "rest", "input_bounds"}
    if not needed <= content.keys() <= known:
        raise ValueError(f"a HELLO has the keys {limits.legible(str(sorted(content)))}; expected {sorted(needed)}, and "
                         f"perhaps {sorted(known - needed)}")
    return RobotDescription(**content)


def read_start(text: str) -> int | None:
    """The seed in a START. Raises ValueError for another text."""
    seed = limits.json_object(text, "a START").get("seed")
    whole = isinstance(seed, int) and not isinstance(seed, bool) and 0 <= seed < 2**64
    if seed is not None and not whole:
        raise ValueError(f"a START has the seed {limits.legible(repr(seed))}; expected a whole number of 0 or more, or "
                         "null")
    return seed
