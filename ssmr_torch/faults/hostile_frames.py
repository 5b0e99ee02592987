"""Hostile frames at a controller's end of the wire while an honest robot is in a run: they are dropped and counted."""

from __future__ import annotations

import gc
import json
import logging
import struct
from collections import Counter

import numpy as np

from ssmr_torch.benchmarks.endurance import LIMIT, memory
from ssmr_torch.control.base import Command
from ssmr_torch.faults.outcome import Found
from ssmr_torch.faults.reading import log_lines
from ssmr_torch.wire.controller_end import ControllerEnd
from ssmr_torch.wire.messages import HEADER, Kind, Message, unpack

KIND = "hostile frames"
TIMESTEP, BOUND, EVERY = 0.01, 1.0, 50
FEW_LINES = 200  # of the log, however many frames there are
ROBOT, FOE = b"robot", b"foe"


class _Steering:
    """A controller that any robot may have."""

    period = TIMESTEP

    def __init__(self):
        self.counts: Counter[str] = Counter()
        self.fallbacks: Counter[str] = Counter()

    def reset(self) -> None: ...

    def prepare(self) -> None: ...

    def __call__(self, time: float, observation: np.ndarray) -> Command:
        good = np.isfinite(observation).all()
        return Command(np.clip(np.array([observation[0], -observation[0]]), -BOUND, BOUND) if good else np.zeros(2))


def description(**changes) -> str:
    """The HELLO of an honest robot in lock-step, with these keys changed."""
    return json.dumps({"name": "honest", "output_names": ["x", "y"], "input_names": ["u1", "u2"], "timestep": TIMESTEP,
                       "rest": [0.0, 0.0], "input_bounds": [[-BOUND] * 2, [BOUND] * 2]} | changes)


def hello(text: str) -> bytes:
    body = text.encode()
    return HEADER.pack(b"SSMR", 1, Kind.HELLO, 0, 0, len(body), 0, 0.0) + body


HELLOS = (
    lambda rng: "[" * 20000 + "]" * 20000, lambda rng: '{"a":' * 5000 + "1" + "}" * 5000,
    lambda rng: description().replace("0.01", "1e400"), lambda rng: description(timestep=1e-9),
    lambda rng: description(timestep=-0.01), lambda rng: description(timestep="fast"),
    lambda rng: description(output_names=[f"y{k}" for k in range(5000)], rest=[0.0] * 5000),
    lambda rng: description(name="x" * 60000), lambda rng: description(rest=[1e308, float("nan")]),
    lambda rng: description(input_bounds=[[1.0] * 2, [-1.0] * 2]), lambda rng: description(input_bounds=None),
    lambda rng: description(name={"a": [1, 2]}), lambda rng: "null", lambda rng: "1e5", lambda rng: "",
    lambda rng: "{}",
    lambda rng: description(extra=1), lambda rng: description(real_time="no"), lambda rng: "9" * 60000)


def frame(rng: np.random.Generator, run: int, sequence: int) -> bytes:
    """One hostile frame; run, sequence: of the honest robot, which a foe may have guessed or heard."""
    kind = int(rng.integers(10))
    if kind == 0:
        return rng.bytes(int(rng.integers(0, 200)))
    if kind == 1:
        return hello(HELLOS[int(rng.integers(len(HELLOS)))](rng)[:65536])
    if kind == 2:  # a header with any numbers
        count = int(rng.integers(0, 5))
        return struct.pack("<4sBBHIIQd", b"SSMR", int(rng.integers(3)), int(rng.integers(9)),
                           int(rng.integers(1 << 16)),
                           int(rng.integers(1 << 32)), count, int(rng.integers(1 << 62)), float(rng.normal())) \
            + rng.bytes(8 * count)
    if kind == 3:  # says that more follows than does
        return HEADER.pack(b"SSMR", 1, 4, 0, run, 2**32 - 1, sequence, 0.0)
    if kind == 4:
        return Message(Kind.END, int(rng.integers(1 << 32)), text="foreign").pack()
    if kind == 5:
        return Message(Kind(int(rng.integers(1, 7))), int(rng.integers(1 << 32)), int(rng.integers(1 << 40)),
                       text="?").pack()
    if kind == 6:  # an old number of this run
        return Message(Kind.MEASUREMENT, (run + 1) % 2**32, sequence, TIMESTEP * sequence,
                       values=np.full(2, 1e3)).pack()
    if kind == 7:
        return Message(Kind.MEASUREMENT, run, max(sequence - 1 - int(rng.integers(100)), 0), 0.0,
                       values=np.ones(2)).pack()
    data = bytearray(Message(Kind.MEASUREMENT, run, sequence, TIMESTEP * sequence, values=np.ones(2)).pack())
    if kind == 8:
        return bytes(data[:int(rng.integers(len(data)))])
    data[int(rng.integers(6))] ^= 1 << int(rng.integers(8))  # magic, version, kind
    return bytes(data)


def frames(count: int, seed: int = 0) -> list[dict]:
    """So many hostile frames, one honest measurement after each 50 of them; one row."""
    rng, end, now = np.random.default_rng(seed), ControllerEnd(lambda robot: _Steering()), 0.0
    wrong: Counter[str] = Counter()
    with log_lines() as lines:
        logging.getLogger("ssmr_torch").propagate = False
        start = _answers(end, ROBOT, hello(description()), now, wrong)
        run, sequence, before, grown = start[0].run if start else 0, 0, None, 0.0
        for k in range(count):
            now += TIMESTEP / EVERY
            _answers(end, FOE, frame(rng, run, sequence), now, wrong)
            if k % EVERY == EVERY - 1:
                value = float(rng.normal())
                sent = Message(Kind.MEASUREMENT, run, sequence, TIMESTEP * sequence,
                               values=np.array([value, 0.0])).pack()
                replies = _answers(end, ROBOT, sent, now, wrong)
                right = np.clip([value, -value], -BOUND, BOUND)
                wrong["measurements without the right command"] += not any(
                    reply.kind is Kind.COMMAND and reply.sequence == sequence and np.array_equal(reply.values, right)
                    for reply in replies)
                sequence += 1
                end.samples.clear()
            if (k + 1) % max(1, count // 10) == 0:
                gc.collect()
                before = memory() if before is None else before
                grown = memory() - before
        wrong["lines of the log beyond few"] = max(0, len(lines) - FEW_LINES)
    wrong["MB of memory"] = round(grown) if grown > LIMIT else 0
    case, said = f"{count} frames, {sequence} honest measurements", \
        f"memory {grown:+.1f} MB, {len(lines)} lines of log, {sum(end.counts.values())} counted"
    bad = {what: number for what, number in wrong.items() if number}
    outcome = "traceback" if any(what.startswith("exception") for what in bad) else "wrong" if bad else "counted"
    return [Found(KIND, case, outcome, "; ".join([*(f"{number} {what}" for what, number in bad.items()), said])).row()]


def _answers(end: ControllerEnd, peer: bytes, data: bytes, now: float, wrong: Counter) -> list[Message]:
    """What the end sends to this peer; exceptions are counted."""
    try:
        return [unpack(reply.message.pack()) for reply in end.receive(peer, data, now) if reply.peer == peer]
    except Exception as error:  # whatever it is: that is what is looked for
        wrong[f"exceptions {type(error).__name__}: {error}"[:80]] += 1
        return []
