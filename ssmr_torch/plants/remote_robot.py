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
from ssmr_torch.quantities import ADDRESS, PATIENCE, WAIT
from ssmr_torch.ranges import OrNone
from ssmr_torch.wire.link import ControllerLink
from ssmr_torch.wire.messages import Code, Kind, Malformed, Message, RobotDescription, read_description, unpack
from ssmr_torch.wire.stream import MeasurementStream, Place

log = logging.getLogger(__name__)


class RemotePlant(PlantSheet):
    """A robot that connects to this address, such as ssmr serve-plant or your own robot (docs/wire.md).

    bind: address to wait at. The robot sends its names, timestep, rest and bounds in its HELLO.
    wait: s to wait for the robot.   deadline, timeout, patience: as in `wire.controller_end.ControllerEnd`.
    The true displacement is not known here, so it is the last observation. A measurement that does not arrive in time
    is NaN. The robot does not send its state, which therefore is (0,).   counts: what was wrong with the messages.
    stamp: s by the robot's own clock, at the last observation; NaN where it is missing.
    Raises OSError for an address that is in use, TimeoutError when no robot came, and ValueError for a HELLO that
    cannot be read. `reset` and `step` raise ConnectionError when the robot is gone.
    """

    @checked(bind=ADDRESS, wait=WAIT, deadline=OrNone(WAIT), timeout=PATIENCE, patience=PATIENCE)
    def __init__(self, bind: str = "tcp://*:5555", wait: float = 60.0, deadline: float | None = None,
                 timeout: float = 0.5, patience: float = 60.0):
        self.bind, self.wait, self.deadline = bind, float(wait), deadline
        self.timeout, self.patience = float(timeout), float(patience)
        self.counts: Counter[str] = Counter()
        self.stamp = np.nan
        self._link = ControllerLink(bind)
        self._run, self._peer, self._sender = randbits(32), b"", b""
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
                "patience": self.patience}

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
        self._run = (self._run + 1) % 2**32
        self._stream, self._pending = self._new_stream(), None
        self._start = Message(Kind.START, self._run, text='{"seed": %s}' % ("null" if seed is None else int(seed)))
        self._tell(self._start)
        return self._next(monotonic() + self.patience)

    def step(self, input: np.ndarray) -> np.ndarray:
        """Send the inputs (m,), clipped to the bounds. Returns the next observation (p,), NaN if it does not come in
        time.
        """
        u = np.clip(finite_vector(input, len(self.input_names), "input"), *self.input_bounds)
        if not self._stream.next:
            self.reset()
        self._command = Message(Kind.COMMAND, self._run, self._stream.next - 1, values=u)
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
        until = monotonic() + self.wait
        while (message := self._receive(until)) is not None:
            if message.kind is Kind.HELLO:
                return self._description_of(message)
            # The robot still is in a run with an earlier program. This message makes it say HELLO.
            self._link.send(self._sender, Message(Kind.END, message.run, status=Code.OTHER, text="no such run"))
        self._link.close()
        raise TimeoutError(f"no robot connected to {self.bind} within {self.wait:g} s; start ssmr serve-plant "
                           "with connect=tcp://THIS_COMPUTER:PORT, and check the address")

    def _description_of(self, message: Message) -> RobotDescription:
        try:
            return read_description(message.text)
        except ValueError as error:
            self._link.send(self._peer, Message(Kind.REFUSE, text=str(error)))
            raise

    def _receive(self, until: float) -> Message | None:
        """The next well-formed message from anyone, or None when none arrives before `until`."""
        while True:
            received = self._link.receive(max(until - monotonic(), 0.0))
            if received is None:
                return None
            peer, data = received
            try:
                message = unpack(data)
            except Malformed as error:
                self.counts["malformed"] += 1
                log.warning("a malformed message was dropped: %s", error)
                continue
            self._sender = peer
            if message.kind is Kind.HELLO:
                self._peer = peer
            return message

    def _next(self, until: float) -> np.ndarray:
        """The observation of the next sample; NaN when a real-time robot's does not arrive before `until`."""
        message = self._pending if self._pending is not None else self._await(until)
        if message is None:
            if not (self._described.real_time and self._stream.begun) or monotonic() - self._heard > self.timeout:
                raise ConnectionError(f"the robot {self.name!r} is silent: measurement {self._stream.next} did not "
                                      "arrive. Check the robot and start both programs again")
            self._due += self.timestep
        elif message.sequence == self._stream.next:
            self._pending, self.stamp = None, message.time
            _, observation = self._stream.take(message)
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
            if message.kind is Kind.HELLO:
                self._greet_again(message)
            elif message.run != self._run or message.kind not in (Kind.MEASUREMENT, Kind.END):
                self.counts["foreign"] += 1
            elif message.kind is Kind.END:
                raise ConnectionError(f"the robot {self.name!r} ended the run: {message.text}")
            elif (place := self._stream.place(message)) is Place.BEYOND:
                raise ConnectionError(f"measurement {message.sequence} of the robot {self.name!r} arrived after "
                                      f"{self._stream.next - 1}: too many in between are missing. Check the connection")
            elif place is not Place.INVALID:
                self._heard = monotonic()
                slack = 0.5 * self.timestep if self.deadline is None else self.deadline
                self._due = self._heard + self.timestep + slack
                if place is Place.NEXT:
                    return message
                if place is Place.PAST and self._described.real_time:
                    until = max(until, self._due)
                if place is Place.AGAIN and self._command.run == self._run:
                    self._tell(self._command)
        return None

    def _greet_again(self, message: Message) -> None:
        if self._stream.next:
            raise ConnectionError(f"the robot {self.name!r} was restarted during a run; start this run again")
        if message.text != self._described.text and self._description_of(message).text != self._described.text:
            text = f"this run began with {self._described.text}, but now the robot is {message.text}; start again"
            self._link.send(self._peer, Message(Kind.REFUSE, text=text))
            raise ValueError(text)
        self._tell(self._start)


class _Current:
    """What is needed to end the robot's run when the plant is deleted."""

    def __init__(self, link: ControllerLink, peer: bytes, run: int):
        self.link, self.peer, self.run = link, peer, run

    def farewell(self) -> None:
        self.link.send(self.peer, Message(Kind.END, self.run, text="the driver is done"))
        self.link.close()
