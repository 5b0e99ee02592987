"""A robot on another computer, as a plant."""

from __future__ import annotations

import logging
import weakref
from collections import Counter
from secrets import randbits
from time import monotonic

import numpy as np

from ssmr_torch.checked_arguments import checked
from ssmr_torch.plants.base import PlantSheet, finite_vector
from ssmr_torch.quantities import ADDRESS, PATH, PATIENCE, WAIT
from ssmr_torch.ranges import OrNone
from ssmr_torch.settings import non_negative, positive
from ssmr_torch.wire.limits import legible
from ssmr_torch.wire.link import ControllerLink
from ssmr_torch.wire.messages import Code, Kind, Malformed, Message, RobotDescription, read_description, unpack
from ssmr_torch.wire.notices import Notices
from ssmr_torch.wire.seal import read_key
from ssmr_torch.wire.stream import MeasurementStream, Place

log = logging.getLogger(__name__)

# s without a word from the robot after which another connection may speak for it.
GIVES_WAY = 5.0


class RemotePlant(PlantSheet):
    """A robot that connects to this address, such as ssmr serve-plant or your own robot (docs/wire.md).

    bind: address to wait at. The robot sends its names, timestep, rest and bounds in its HELLO.
    wait: s to wait for the robot.   timeout, patience: s of silence after which a robot in real time or in lock-step is
    gone.   deadline: as in `wire.controller_end.ControllerEnd`.   key_file: see `wire.seal.read_key`.
    The true displacement is not known here, so it is the last observation. A measurement that does not arrive in time
    is NaN. The robot does not send its state, which therefore is (0,).   counts: what was wrong with the messages.
    stamp: s by the robot's own clock, at the last observation; NaN where it is missing.
    As long as the robot is heard, others are told that the driver is busy, and their messages are dropped and counted.
    Raises OSError for an address that is in use, and TimeoutError when no robot came whose HELLO can be read. `reset`
    and `step` raise ConnectionError when the robot is gone.
    """

    @checked(bind=ADDRESS, wait=WAIT, deadline=OrNone(WAIT), timeout=PATIENCE, patience=PATIENCE,
             key_file=OrNone(PATH))
    def __init__(self, bind: str = "tcp://*:5555", wait: float = 60.0, deadline: float | None = None,
                 timeout: float = 0.5, patience: float = 60.0, key_file: str | None = None):
        self.bind, self.deadline, self.key_file = bind, deadline, key_file
        self.wait, self.timeout, self.patience = (
            positive(name, value, "s")
            for name, value in (("wait", wait), ("timeout", timeout), ("patience", patience)))
        if deadline is not None:
            non_negative("deadline", deadline, "s")
        self.counts: Counter[str] = Counter()
        self.stamp = np.nan
        self._link = ControllerLink(bind, read_key(key_file))
        self._link.counts, self._notices = self.counts, Notices(log)
        self._run, self._peer, self._sender, self._request = randbits(32), b"", b"", 0
        self._described = self._meet()
        self.name, self.timestep, self.rest = self._described.name, self._described.timestep, self._described.rest
        self.input_bounds, self.input_unit = self._described.input_bounds, self._described.input_unit
        self.output_names, self.input_names = self._described.output_names, self._described.input_names
        self._last = np.zeros(len(self.output_names))
        self._stream = self._new_stream()
        self._pending: Message | None = None
        self._start = self._command = Message(Kind.START)
        self._heard = self._due = 0.0
        self._current = _Current(self._link, self._peer, self._run)
        self.close = weakref.finalize(self, self._current.farewell)

    @property
    def parameters(self) -> dict:
        """The constructor's arguments."""
        return {"bind": self.bind, "wait": self.wait, "deadline": self.deadline, "timeout": self.timeout,
                "patience": self.patience} | ({} if self.key_file is None else {"key_file": str(self.key_file)})

    @property
    def displacement(self) -> np.ndarray:
        return self._last.copy()

    @property
    def state(self) -> np.ndarray:
        return np.empty(0)

    def reset(self, seed: int | None = None, state: np.ndarray | None = None) -> np.ndarray:
        """Begin a run; the robot goes to rest. Any state but None raises ValueError."""
        if state is not None:
            raise ValueError("a state was given, but a robot on another computer cannot be put into a state; expected "
                             "None, which means rest")
        before = self._run
        while self._run in (before, 0):
            self._run = randbits(32)  # not to be guessed
        self._stream, self._pending = self._new_stream(), None
        text = '{"seed": %s}' % ("null" if seed is None else int(seed))
        self._start = Message(Kind.START, self._run, self._request, text=text)
        self._request += self._request > 0
        self._heard = monotonic()
        self._tell(self._start)
        return self._next(monotonic() + self.patience)

    def step(self, input: np.ndarray) -> np.ndarray:
        """Send the inputs (m,), clipped to the bounds. Returns the next observation (p,), NaN if it does not come in
        time.
        """
        u = np.clip(finite_vector(input, len(self.input_names), "input"), *self.input_bounds)
        if not self._stream.next:
            self.reset()
        self._command = Message(Kind.COMMAND, self._run, self._stream.number, values=u)
        self._tell(self._command)
        return self._next(self._due if self._described.real_time else monotonic() + self.patience)

    def _new_stream(self) -> MeasurementStream:
        span = self.timeout if self._described.real_time else self.patience
        return MeasurementStream(len(self._described.output_names), self._described.timestep,
                                 max(1, round(span / self._described.timestep)), self.counts)

    def _tell(self, message: Message) -> None:
        self._link.send(self._peer, message)
        if message.kind is Kind.START:
            self._current.peer, self._current.run = self._peer, self._run

    def _meet(self) -> RobotDescription:
        log.info("waiting for a robot at %s", self._link.endpoint)
        until, refused = monotonic() + self.wait, ""
        while (message := self._receive(until)) is not None:
            if message.kind is not Kind.HELLO:
                # The robot still is in a run with an earlier program. This message makes it say HELLO.
                self._answer(Message(Kind.END, message.run, status=Code.OTHER, text="no such run"))
                continue
            try:
                described = read_description(message.text)
            except ValueError as error:
                refused = f". A robot was refused: {legible(str(error))}"
                self._refuse(message, str(error))
                continue
            self._peer, self._request = self._sender, message.sequence
            return described
        self._link.close()
        raise TimeoutError(f"no robot connected to {self.bind} within {self.wait:g} s; start ssmr serve-plant "
                           f"with connect=tcp://THIS_COMPUTER:PORT, and check the address and the key{refused}")

    def _answer(self, message: Message) -> None:
        """Answer the sender of the last message, whoever it is."""
        self._link.send(self._sender, message)

    def _refuse(self, hello: Message, why: str, status: int = Code.OK) -> None:
        self._answer(Message(Kind.REFUSE, sequence=hello.sequence, status=status, text=legible(why, 1000)))

    def _receive(self, until: float) -> Message | None:
        """The next well-formed message from anyone, or None when none arrives before `until`."""
        while (received := self._link.receive(max(until - monotonic(), 0.0))) is not None:
            self._sender, data = received
            try:
                return unpack(data)
            except Malformed as error:
                self.counts["malformed"] += 1
                self._notices.say("malformed", f"a malformed message was dropped: {error}")
            if monotonic() > until:
                return None
        return None

    def _next(self, until: float) -> np.ndarray:
        """The observation of the next sample; NaN when a real-time robot's does not arrive before `until`."""
        message = self._pending if self._pending is not None else self._await(until)
        if message is None:
            if not (self._described.real_time and self._stream.begun) or monotonic() - self._heard > self.timeout:
                raise ConnectionError(f"the robot {self.name!r} is silent: measurement {self._stream.next} did not "
                                      "arrive. Check the robot and start both programs again")
            self._due += self.timestep
        elif message.sequence + self._stream.shift == self._stream.next:
            self._pending, self.stamp = None, message.time
            _, observation = self._stream.take(message, monotonic())
            if np.isfinite(observation).all():
                self._last = observation
            return observation.copy()
        else:
            self._pending = message
        self._stream.skip()
        self.stamp = np.nan
        return np.full(len(self.output_names), np.nan)

    def _await(self, until: float) -> Message | None:
        while (message := self._receive(until)) is not None:
            place = self._heed(message)
            if place is Place.NEXT:
                return message
            if place is Place.LATE and self._described.real_time:
                until = max(until, self._due)
            if monotonic() > until:
                return None
        return None

    def _heed(self, message: Message) -> Place | None:
        """The place of a measurement of this run; None for what is not one."""
        ours = self._sender == self._peer or monotonic() - self._heard > GIVES_WAY
        if message.kind is Kind.HELLO:
            self._greet_again(message, ours)
            return None
        if not ours or message.run != self._run or message.kind not in (Kind.MEASUREMENT, Kind.END):
            self.counts["foreign"] += 1
            return None
        if message.kind is Kind.END:
            raise ConnectionError(f"the robot {self.name!r} ended the run: {legible(message.text)}")
        place = self._stream.place(message, monotonic())
        if place is Place.BEYOND:
            raise ConnectionError(f"measurement {message.sequence} of the robot {self.name!r} arrived after "
                                  f"{self._stream.number}: too many in between are missing. Check the connection")
        if place is not Place.INVALID:
            self._peer, self._heard = self._sender, monotonic()
            slack = 0.5 * self.timestep if self.deadline is None else self.deadline
            self._due = self._heard + self.timestep + slack
            if place is Place.AGAIN and self._command.run == self._run:
                self._tell(self._command)
        return place

    def _greet_again(self, message: Message, ours: bool) -> None:
        if not ours:
            self.counts["foreign"] += 1
            self._refuse(message, f"the driver is busy with the robot {self.name!r}", Code.BUSY)
            return
        if self._stream.next:
            if self._request and self._request - message.sequence in range(1, 2**20):
                self.counts["repeated"] += 1  # the HELLO that this run answers
                return
            raise ConnectionError(f"the robot {self.name!r} was restarted during a run; start this run again")
        try:
            same = message.text == self._described.text or read_description(message.text).text == self._described.text
        except ValueError as error:
            self._refuse(message, str(error))
            return
        if not same:
            text = f"this run began with {self._described.text}, but now the robot is {message.text}; start again"
            self._refuse(message, text)
            raise ValueError(legible(text, 1000))
        self._peer = self._sender
        if message.sequence not in range(self._request - 2**20, self._request + 1):
            self._start = Message(Kind.START, self._run, message.sequence, text=self._start.text)
            self._request = message.sequence + (message.sequence > 0)
        self._tell(self._start)


class _Current:
    """What is needed to end the robot's run when the plant is deleted."""

    def __init__(self, link: ControllerLink, peer: bytes, run: int):
        self.link, self.peer, self.run = link, peer, run

    def farewell(self) -> None:
        self.link.send(self.peer, Message(Kind.END, self.run, text="the driver is done"))
        self.link.close()
