"""The controller's end of the wire: how it answers each message. It has no socket and no clock of its own."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable
from secrets import randbits
from time import perf_counter
from typing import NamedTuple

import numpy as np

from ssmr_torch.wire.messages import Code, Kind, Malformed, Message, RobotDescription, read_description, unpack
from ssmr_torch.wire.stream import MeasurementStream, Place

log = logging.getLogger(__name__)


class Sample(NamedTuple):
    """One sample: time s, observation (p,) m (NaN where nothing came), the controller's Command, solve time s."""

    time: float
    observation: np.ndarray
    command: object
    solve_time: float


class Reply(NamedTuple):
    """A message for a robot."""

    peer: bytes
    message: Message


class ControllerEnd:
    """Answers robots with the commands of a controller, one robot at a time.

    build: RobotDescription → Controller; if it raises ValueError, the robot is refused with this message.
    duration: s, length of a run; None: no limit.
    deadline: s after a measurement of a real-time robot was due, at which the controller continues without it; default:
    half of the robot's timestep.   timeout: s without a measurement after which a real-time robot counts as dead.
    patience: the same for a robot in lock-step, and for the first measurement of every robot.   seed: for the robots.

    The controller sees a missing measurement as a vector of NaN, like that of a rig with `dropped=missing`. A model
    predictive controller then gives the next input of its last plan, later the safe input, within bounds and rate. When
    a robot dies, the controller is reset and waits for the next robot.
    description, samples: of the present run, or of the last one.   counts: of messages and of lost robots, over all
    runs (docs/wire.md).   finished: number of runs that the task or the robot ended.
    """

    def __init__(self, build: Callable[[RobotDescription], object], *, duration: float | None = None,
                 deadline: float | None = None, timeout: float = 0.5, patience: float = 60.0, seed: int | None = 0):
        if not (timeout > 0 and patience > 0 and (deadline is None or deadline >= 0)):
            raise ValueError(f"deadline is {deadline} s, timeout {timeout} s and patience {patience} s; expected a "
                             "deadline of 0 or more, or null for half a timestep, and a positive timeout and patience")
        self.build, self.duration, self.deadline, self.seed = build, duration, deadline, seed
        self.timeout, self.patience = float(timeout), float(patience)
        self.counts: Counter[str] = Counter()
        self.finished = 0
        self.description: RobotDescription | None = None
        self.samples: list[Sample] = []
        self.controller = None
        self._peer: bytes | None = None
        self._run = randbits(32)
        self._answer: Message | None = None
        self._stream: MeasurementStream | None = None
        self._heard = self._due = 0.0

    @property
    def running(self) -> bool:
        """Whether a robot is in a run."""
        return self._peer is not None

    def due(self) -> float:
        """When `tick` must be called next, on the clock of `now`; infinite without a robot."""
        if not self.running:
            return np.inf
        if self._paced:
            return self._due
        return self._heard + self.patience

    def receive(self, peer: bytes, data: bytes, now: float) -> list[Reply]:
        """The replies to these bytes; now: s of any clock that never goes back."""
        try:
            message = unpack(data)
        except Malformed as error:
            return self._malformed(error)
        if message.kind is Kind.HELLO:
            return self._hello(peer, message, now)
        if message.kind is Kind.MEASUREMENT:
            return self._measurement(peer, message, now)
        if message.kind is Kind.END:
            if self.running and message.run == self._run:
                log.info("the robot ended the run: %s", message.text)
                self._stop(finished=message.status == Code.OK)
            return []
        return self._malformed(f"a {message.kind.name}, which only a controller sends")

    def tick(self, now: float) -> list[Reply]:
        """The messages to send because nothing has come. Call it at `due` when no message waits to be read."""
        replies: list[Reply] = []
        while now >= self.due():
            limit = self.timeout if self._paced else self.patience
            if now - self._heard >= limit:
                self.counts["lost_robots"] += 1
                return replies + self.end(f"no measurement for {limit:g} s")
            self._due += self.description.timestep
            replies += self._decide(self._stream.skip(), np.full(self._stream.outputs, np.nan), missed=True)
        return replies

    def end(self, why: str, finished: bool = False) -> list[Reply]:
        """End the run, if there is one, and be ready for the next one."""
        if not self.running:
            return []
        log.info("the run is over: %s", why)
        reply = Reply(self._peer, Message(Kind.END, self._run, self._stream.next,
                                          status=Code.OK if finished else Code.OTHER, text=why))
        self._stop(finished)
        return [reply]

    @property
    def _paced(self) -> bool:
        return self.description.real_time and self._stream.begun

    def _stop(self, finished: bool) -> None:
        self.controller.reset()
        self._peer, self._answer = None, None
        self.finished += finished and bool(self.samples)

    def _hello(self, peer: bytes, message: Message, now: float) -> list[Reply]:
        if self.running and peer == self._peer and not self._stream.begun:
            self._heard = now
            return [self._start()]
        if self.running and peer != self._peer:
            self.counts["foreign"] += 1
            return [Reply(peer, Message(Kind.REFUSE, status=Code.BUSY,
                                        text=f"the controller is busy with the robot {self.description.name!r}"))]
        if self.running:
            self.counts["lost_robots"] += 1
            self._stop(finished=False)
        try:
            robot = read_description(message.text)
            controller = self.build(robot)
        except ValueError as error:
            self.counts["refused"] += 1
            log.warning("refused a robot: %s", error)
            return [Reply(peer, Message(Kind.REFUSE, text=str(error)))]
        controller.reset()
        self.description, self.controller, self.samples = robot, controller, []
        span = self.timeout if robot.real_time else self.patience
        self._stream = MeasurementStream(len(robot.output_names), robot.timestep, max(1, round(span / robot.timestep)),
                                         self.counts)
        self._peer, self._run, self._heard = peer, (self._run + 1) % 2**32, now
        log.info("a run with %s begins", robot.name)
        return [self._start()]

    def _start(self) -> Reply:
        text = '{"seed": %s}' % ("null" if self.seed is None else int(self.seed))
        return Reply(self._peer, Message(Kind.START, self._run, text=text))

    def _measurement(self, peer: bytes, message: Message, now: float) -> list[Reply]:
        if not self.running or message.run != self._run:
            self.counts["foreign"] += 1
            return [Reply(peer, Message(Kind.END, message.run, status=Code.OTHER,
                                        text="there is no such run; say HELLO for a new one"))]
        place = self._stream.place(message)
        if place is Place.INVALID:
            return self._malformed(f"{len(message.values)} values at {message.time} s as measurement "
                                   f"{message.sequence}", counted=True)
        self._peer, self._heard = peer, now
        # A late measurement also shows the present travel time. `due` is the time when the next one should be here.
        ahead = message.sequence + 1 - self._stream.next
        if place is Place.NEXT or ahead == 0:
            self._due = now + self.description.timestep + self._slack
        if place is Place.BEYOND:
            self.counts["lost_robots"] += 1
            return self.end(f"measurement {message.sequence} arrived after {self._stream.next - 1}: too many between "
                            "them are missing")
        if place is Place.AGAIN:
            return [] if self._answer is None else [Reply(peer, self._answer)]
        if place is Place.PAST:
            return []
        while self._stream.next < message.sequence:
            self._ask(self._stream.skip(), np.full(self._stream.outputs, np.nan))
        time, observation = self._stream.take(message)
        return self._decide(time, observation, missed=not np.isfinite(observation).all())

    @property
    def _slack(self) -> float:
        return 0.5 * self.description.timestep if self.deadline is None else self.deadline

    def _ask(self, time: float, observation: np.ndarray) -> Sample:
        start = perf_counter()
        command = self.controller(time, observation)
        sample = Sample(time, observation, command, perf_counter() - start)
        self.samples.append(sample)
        return sample

    def prepare(self) -> None:
        """After a real-time robot got its input: do the work that can be done before its next measurement."""
        if self.description is not None and self.description.real_time:
            getattr(self.controller, "prepare", lambda: None)()

    def _decide(self, time: float, observation: np.ndarray, missed: bool) -> list[Reply]:
        sample, number = self._ask(time, observation), self._stream.next - 1
        if self.duration is not None and number >= np.ceil(self.duration / self.description.timestep - 1e-9):
            return self.end("the task is done", finished=True)
        status = Code.MISSED if missed else code_of(sample.command)
        self._answer = Message(Kind.COMMAND, self._run, number, sample.solve_time, status, sample.command.input)
        return [Reply(self._peer, self._answer)]

    def _malformed(self, what, counted: bool = False) -> list[Reply]:
        self.counts["malformed"] += not counted
        if self.counts["malformed"] == 1:
            log.warning("a malformed message was dropped; further ones will be dropped without a message: %s", what)
        return []


def code_of(command) -> Code:
    """The status for a COMMAND message with this Command."""
    if command.fallback is not None:
        return Code.__members__.get(command.fallback.name, Code.OTHER)
    return Code.HELD if command.held else Code.OK
