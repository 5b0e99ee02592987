"""The controller's end of the wire: how it answers each message. It has no socket and no clock of its own."""

from __future__ import annotations

import logging
from collections import Counter, deque
from collections.abc import Callable, Sequence
from secrets import randbits
from typing import NamedTuple

import numpy as np

from ssmr_torch.wire.answers import ONE_BY_ONE, Answers, Sample, code_of
from ssmr_torch.wire.limits import legible
from ssmr_torch.wire.messages import Code, Kind, Malformed, Message, RobotDescription, read_description, unpack
from ssmr_torch.wire.notices import Notices
from ssmr_torch.wire.stream import Place

__all__ = ["ControllerEnd", "Reply", "Sample", "code_of"]

log = logging.getLogger(__name__)

# So many measurements that wait to be read are all used; of more, only the newest.
WAITING = 2
# s: a robot that was told to start, and does not, gives way to another one; a silent one to the same one over a new
# connection.
GIVES_WAY = 5.0
# s without a measurement after which the same robot may go on over a new connection in lock-step.
RECONNECTS = 0.5
LONGEST_REASON = 1000  # characters of a REFUSE


class Reply(NamedTuple):
    """A message for a robot."""

    peer: bytes
    message: Message


class ControllerEnd:
    """Answers robots with the commands of a controller, one robot at a time.

    build: RobotDescription → Controller; if it raises an error, the robot is refused with its message.
    duration: s, length of a run; None: no limit.
    deadline: s after a measurement of a real-time robot was due, at which the controller continues without it; default:
    half of the robot's timestep.   timeout: s without a measurement after which the run of a real-time robot is
    suspended.   patience: s after which a suspended run is over, and the same for a robot in lock-step and for the
    first measurement of every robot.   seed: for the robots.

    The controller sees a missing measurement as a vector of NaN, like that of a rig with `dropped=missing`. A model
    predictive controller then gives the next input of its last plan, later the safe input, within bounds and rate.
    A suspended run goes on when its robot is back, and its controller is reset; without it the next robot is taken.
    description, samples: of the present run, or of the last one.   counts: of messages and of lost robots, over all
    runs (docs/wire.md).   finished: number of runs that the task or the robot ended.
    """

    def __init__(self, build: Callable[[RobotDescription], object], *, duration: float | None = None,
                 deadline: float | None = None, timeout: float = 0.5, patience: float = 60.0, seed: int | None = 0):
        if not (0 < timeout < np.inf and 0 < patience < np.inf and (deadline is None or 0 <= deadline < np.inf)):
            raise ValueError(f"deadline is {deadline} s, timeout {timeout} s and patience {patience} s; expected a "
                             "deadline of 0 or more, or null for half a timestep, and a positive timeout and patience")
        self.build, self.duration, self.deadline, self.seed = build, duration, deadline, seed
        self.timeout, self.patience = float(timeout), float(patience)
        self.counts: Counter[str] = Counter()
        self.finished = 0
        self._answers: Answers | None = None
        self._peer: bytes | None = None
        self._run, self._request, self._suspended = randbits(32), 0, False
        self._last_end, self._hello_text = None, ""
        self._requests: deque[int] = deque(maxlen=1000)  # of runs that have begun
        self._heard = self._due = self._offered = 0.0
        self._notices, self._runs = Notices(log), Notices(log, first=100)

    @property
    def description(self) -> RobotDescription | None:
        return None if self._answers is None else self._answers.robot

    @property
    def controller(self):
        return None if self._answers is None else self._answers.controller

    @property
    def samples(self) -> list[Sample]:
        return [] if self._answers is None else self._answers.samples

    @property
    def running(self) -> bool:
        """Whether a robot is in a run."""
        return self._peer is not None and not self._suspended

    @property
    def paced_peer(self) -> bytes | None:
        """The connection of the robot in a run in real time; None without such a run."""
        return self._peer if self.running and self._paced else None

    def due(self) -> float:
        """When `tick` must be called next, on the clock of `now`; infinite without a robot."""
        if not self.running:
            return np.inf
        if self._paced:
            return self._due
        return self._heard + self.patience

    def receive(self, peer: bytes, data: bytes, now: float) -> list[Reply]:
        """The replies to these bytes; now: s of any clock that never goes back."""
        return self.receive_all([(peer, data)], now)

    def receive_all(self, waiting: Sequence[tuple[bytes, bytes]], now: float) -> list[Reply]:
        """The replies to all messages that wait to be read, as (peer, bytes).

        Where more than `WAITING` measurements of a real-time robot wait, the controller was held up. Only the newest of
        them is used, because the robot drops the answers to all others.
        """
        messages = []
        for peer, data in waiting:
            try:
                messages.append((peer, unpack(data)))
            except Malformed as error:
                self._malformed(error)
        first, replies = self._first_used(messages), []
        for peer, message in messages:
            if message.kind is Kind.MEASUREMENT and message.run == self._run and message.sequence < first:
                self.counts["outdated"] += 1
            else:
                replies += self._reply(peer, message, now)
        return replies

    def tick(self, now: float) -> list[Reply]:
        """The messages to send because nothing has come. Call it at `due` when no message waits to be read."""
        replies: list[Reply] = []
        while now >= self.due():
            limit = self.timeout if self._paced else self.patience
            if now - self._heard >= limit:
                self.counts["lost_robots"] += 1
                return replies + self._lose(f"no measurement for {limit:g} s")
            overdue = int((now - self._due) / self.description.timestep)
            overdue = overdue if overdue > ONE_BY_ONE else 0
            self._due += (1 + overdue) * self.description.timestep
            replies += self._told(self._answers.blind(overdue))
        return replies

    def end(self, why: str, finished: bool = False) -> list[Reply]:
        """End the run, if there is one, and be ready for the next one."""
        if self._peer is None:
            return []
        self._runs.say("over", f"the run is over: {why}", level=logging.INFO)
        message = Message(Kind.END, self._run, max(self._stream.number + 1, 0),
                          status=Code.OK if finished else Code.OTHER, text=why)
        reply = Reply(self._peer, message)
        self._last_end = message
        self._stop(finished)
        return [reply]

    def prepare(self) -> None:
        """After a real-time robot got its input: do the work that can be done before its next measurement."""
        if self.description is not None and self.description.real_time:
            getattr(self.controller, "prepare", lambda: None)()

    @property
    def _stream(self):
        return self._answers.stream

    @property
    def _paced(self) -> bool:
        return self.description.real_time and self._stream.begun

    @property
    def _slack(self) -> float:
        return 0.5 * self.description.timestep if self.deadline is None else self.deadline

    def _first_used(self, messages: list[tuple[bytes, Message]]) -> int:
        """The number of the first waiting measurement that is used."""
        if self._answers is None or not self.description.real_time:
            return 0
        numbers = {message.sequence for peer, message in messages
                   if message.kind is Kind.MEASUREMENT and message.run == self._run and peer == self._peer}
        return max(numbers) if len(numbers) > WAITING else 0

    def _reply(self, peer: bytes, message: Message, now: float) -> list[Reply]:
        if message.kind is Kind.HELLO:
            return self._hello(peer, message, now)
        if message.kind is Kind.MEASUREMENT:
            return self._measurement(peer, message, now)
        if message.kind is not Kind.END:
            return self._malformed(f"a {message.kind.name}, which only a controller sends")
        if self._peer is not None and message.run == self._run and self._may_speak(peer, now):
            self._runs.say("over", f"the robot ended the run: {legible(message.text)}", level=logging.INFO)
            self._stop(finished=message.status == Code.OK)
        else:
            self.counts["foreign"] += 1
        return []

    def _may_speak(self, peer: bytes, now: float) -> bool:
        """Whether a message of the present run from this connection is the robot's. Connections may break and be made
        again; but as long as the old one is heard, another one is a stranger's.
        """
        silent = self.description.timestep + self._slack if self._paced else RECONNECTS
        return peer == self._peer or self._suspended or now - self._heard > silent

    def _stop(self, finished: bool) -> None:
        self.controller.reset()
        self._peer, self._answers.newest, self._suspended = None, None, False
        self.finished += finished and bool(self.samples)

    def _lose(self, why: str) -> list[Reply]:
        """The robot is silent: a run in real time is suspended, one in lock-step is over."""
        if not self._paced:
            return self.end(why)
        self._runs.say("over", f"the run is suspended: {why}", level=logging.INFO)
        self.controller.reset()
        self._answers.newest, self._suspended = None, True
        return [Reply(self._peer, Message(Kind.END, self._run, self._stream.number + 1, status=Code.SUSPENDED,
                                          text=f"{why}; the run goes on with the next one"))]

    def _hello(self, peer: bytes, message: Message, now: float) -> list[Reply]:
        request = message.sequence
        if request in self._requests:
            self.counts["repeated"] += 1
            return []
        if self.running and peer == self._peer and not self._stream.begun:
            self._heard, self._request = now, request
            return [self._start()]
        if self.running and peer != self._peer and not self._gives_way(message, now):
            self.counts["foreign"] += 1
            return [Reply(peer, Message(Kind.REFUSE, sequence=request, status=Code.BUSY,
                                        text=f"the controller is busy with the robot {self.description.name!r}"))]
        if self.running:
            self.counts["lost_robots"] += 1
            self._stop(finished=False)
        try:
            robot = read_description(message.text)
            controller = self.build(robot)
        except Exception as error:  # whatever a stranger's description leads to, this end goes on
            known = isinstance(error, ValueError)
            reason = legible(str(error) if known else f"no controller can be built: {type(error).__name__}: {error}",
                             LONGEST_REASON)
            self.counts["refused"] += 1
            self._notices.say("refused", f"refused a robot: {reason}")
            return [Reply(peer, Message(Kind.REFUSE, sequence=request, text=reason))]
        controller.reset()
        self._hello_text = message.text
        self._begin(peer, request, robot, controller, now)
        return [self._start()]

    def _gives_way(self, hello: Message, now: float) -> bool:
        """Whether the present robot is given up for another one, or for itself, started again."""
        if not self._stream.begun:
            return now - self._offered >= GIVES_WAY
        return now - self._heard >= GIVES_WAY and hello.text == self._hello_text

    def _begin(self, peer: bytes, request: int, robot: RobotDescription, controller, now: float) -> None:
        before = self._run
        while self._run in (before, 0):
            self._run = randbits(32)  # not to be guessed
        silence = self.timeout if robot.real_time else self.patience
        self._answers = Answers(self._run, robot, controller, silence, self.duration, self.counts)
        self._peer, self._request, self._suspended = peer, request, False
        self._heard = self._offered = now
        self._runs.say("begins", f"a run with {robot.name} begins", level=logging.INFO)

    def _start(self) -> Reply:
        text = '{"seed": %s}' % ("null" if self.seed is None else int(self.seed))
        return Reply(self._peer, Message(Kind.START, self._run, self._request, text=text))

    def _measurement(self, peer: bytes, message: Message, now: float) -> list[Reply]:
        forgotten = self._suspended and now - self._heard > self.patience
        if self._peer is None or forgotten or message.run != self._run:
            return [Reply(peer, self._no_such_run(message))]
        if not self._may_speak(peer, now):
            self.counts["foreign"] += 1
            return []
        place = self._stream.place(message, now)
        if place is Place.INVALID:
            return self._malformed(f"{len(message.values)} values at {message.time} s as measurement "
                                   f"{message.sequence}", counted=True)
        if self._suspended and place is not Place.NEXT:
            return []
        if self._suspended:
            self._suspended = False
            self.counts["resumed"] += 1
            self._runs.say("begins", f"the run with {self.description.name} goes on", level=logging.INFO)
        self._peer, self._heard = peer, now
        # A late measurement also shows the present travel time. `due` is the time when the next one should be here.
        if place in (Place.NEXT, Place.LATE):
            self._due = now + self.description.timestep + self._slack
        if place is Place.BEYOND:
            self.counts["lost_robots"] += 1
            return self.end(f"measurement {message.sequence} arrived after {self._stream.number}: too many between "
                            "them are missing")
        if place is Place.AGAIN and self._answers.newest is not None:
            return [Reply(peer, self._answers.newest)]
        if place is not Place.NEXT:
            return []
        if not self._stream.begun and self._request:
            self._requests.append(self._request)
        return self._told(self._answers.to(message, now))

    def _told(self, command: Message | None) -> list[Reply]:
        return self.end("the task is done", finished=True) if command is None else [Reply(self._peer, command)]

    def _no_such_run(self, message: Message) -> Message:
        if self._last_end is not None and message.run == self._last_end.run:
            self.counts["repeated"] += 1
            return self._last_end  # it was lost
        self.counts["foreign"] += 1
        return Message(Kind.END, message.run, status=Code.OTHER, text="there is no such run; say HELLO for a new one")

    def _malformed(self, what, counted: bool = False) -> list[Reply]:
        self.counts["malformed"] += not counted
        self._notices.say("malformed", f"a malformed message was dropped: {what}")
        return []
