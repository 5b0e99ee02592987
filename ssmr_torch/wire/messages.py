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

MAGIC, VERSION = b"SSMR", 1
HEADER = struct.Struct("<4sBBHIIQd")
# Largest number of values or characters in a message; no robot or description needs nearly as many.
LARGEST = 65536


class Kind(IntEnum):
    """The kind of a message; → from the robot to the controller, ← from the controller to the robot."""

    HELLO = 1        # → the robot's description as JSON; the robot asks for a run
    START = 2        # ← {"seed": …} as JSON; reset and send measurement 0 of this run
    REFUSE = 3       # ← the reason as text; status BUSY: ask again later
    MEASUREMENT = 4  # → the observation, with the robot's time stamp
    COMMAND = 5      # ← the input for the measurement with the same number, and the solve time
    END = 6          # ↔ this run is over; text: the reason; status OK: as intended; the robot applies its safe input


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
    BUSY = 254
    OTHER = 255


_TEXTS = (Kind.HELLO, Kind.START, Kind.REFUSE, Kind.END)


class Malformed(ValueError):
    """Bytes that are not a message of this version."""


@dataclass(frozen=True, eq=False)
class Message:
    """One message.

    run: number of the run, chosen by the controller in START.   sequence: number of the sample, from 0.
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
            body = self.text.encode()
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
        raise Malformed(f"a message that begins with {magic!r}, version {version}; "
                        f"expected {MAGIC!r}, version {VERSION}: use the same release on both sides")
    if number not in Kind._value2member_map_:
        raise Malformed(f"a message of kind {number}; expected 1 to {max(Kind)}")
    kind = Kind(number)
    expected = HEADER.size + count * (1 if kind in _TEXTS else 8)
    if count > LARGEST or len(data) != expected:
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
    Raises ValueError when sizes disagree or a number is not finite.
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
        for name in ("output_names", "input_names"):
            object.__setattr__(self, name, tuple(str(part) for part in getattr(self, name)))
        for name in ("rest", "input_bounds"):
            object.__setattr__(self, name, np.array(getattr(self, name), dtype=np.float64))
        p, m = len(self.output_names), len(self.input_names)
        if not p or not m or self.rest.shape != (p,) or self.input_bounds.shape != (2, m):
            raise ValueError(f"the robot has {p} output names and a rest of shape {self.rest.shape}, {m} input names "
                             f"and input_bounds of shape {self.input_bounds.shape}; expected (p,) and (2, m)")
        numbers = np.concatenate([self.rest, self.input_bounds.ravel()])
        if not (np.isfinite(numbers).all() and (self.input_bounds[0] < self.input_bounds[1]).all()):
            raise ValueError(f"the robot's rest is {self.rest.tolist()} and its input_bounds "
                             f"{self.input_bounds.tolist()}; expected finite numbers, the lowest below the highest")
        if not (isinstance(self.timestep, (int, float)) and np.isfinite(self.timestep) and self.timestep > 0):
            raise ValueError(f"the robot's timestep is {self.timestep!r}; expected a positive number of s")
        if self.length_unit != "m":
            raise ValueError(f"the robot measures in {self.length_unit!r}; expected 'm', as in the controller: "
                             "convert the observation and rest to m")

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
    content = _object(text, "a HELLO")
    known = {part.name for part in fields(RobotDescription)}
    needed = {"name", "output_names", "input_names", "timestep", "rest", "input_bounds"}
    if not needed <= content.keys() <= known:
        raise ValueError(f"a HELLO has the keys {sorted(content)}; expected {sorted(needed)}, and perhaps "
                         f"{sorted(known - needed)}")
    try:
        return RobotDescription(**content)
    except TypeError as error:
        raise ValueError(f"a HELLO cannot be read: {error}") from error


def read_start(text: str) -> int | None:
    """The seed in a START. Raises ValueError for another text."""
    seed = _object(text, "a START").get("seed")
    if seed is not None and not (isinstance(seed, int) and seed >= 0):
        raise ValueError(f"a START has the seed {seed!r}; expected a whole number of 0 or more, or null")
    return seed


def _object(text: str, what: str) -> dict:
    try:
        content = json.loads(text)
    except json.JSONDecodeError as error:
        raise ValueError(f"the text of {what} is not JSON: {error}") from error
    if not isinstance(content, dict):
        raise ValueError(f"the text of {what} is a JSON {type(content).__name__}; expected a JSON object")
    return content
