"""The robot's end of the wire: it connects any plant to a controller on another computer or in another process."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable
from time import monotonic

import numpy as np

from ssmr_torch.checked_arguments import checked
from ssmr_torch.quantities import PATIENCE, TRUTH, VECTOR
from ssmr_torch.ranges import Number
from ssmr_torch.wire.messages import Code, Kind, Malformed, Message, RobotDescription, read_start, unpack

log = logging.getLogger(__name__)

# s between two HELLOs; in lock-step also between two copies of an unanswered measurement.
AGAIN = 0.5


class RobotEnd:
    """Sends a plant's measurements to a controller and applies its commands.

    link: a `RobotLink`.   real_time: True: the plant is stepped by the clock, one timestep at a time; False: it waits
    for every command (lock-step, for simulations).
    timeout: s without a command after which, in real time, the controller counts as dead.   patience: the same in
    lock-step.   answer_within: share of a timestep in which a command must come in real time. If none comes, the last
    input is held; a command that comes later in the timestep is used from the next step on.
    safe_input: (m,), applied without a controller; default: the admissible input nearest to zero.
    clock: s, never goes back.
    counts: late, repeated, malformed and foreign messages; missed answers; overruns (steps that took longer than the
    timestep); lost_controllers; busy controllers.
    Raises ValueError for settings out of range.
    """

    @checked(real_time=TRUTH, timeout=PATIENCE, patience=PATIENCE, answer_within=Number(1e-3, 1.0), safe_input=VECTOR)
    def __init__(self, plant, link, *, real_time: bool = False, timeout: float = 0.2, patience: float = 60.0,
                 answer_within: float = 0.5, safe_input=None, clock: Callable[[], float] = monotonic):
        if not (timeout > 0 and patience > 0 and 0 < answer_within <= 1):
            raise ValueError(f"timeout is {timeout} s, patience {patience} s and answer_within {answer_within}; "
                             "expected a positive timeout and patience, and a share of a timestep, 1 at most")
        self.plant, self.link, self.clock, self.real_time = plant, link, clock, bool(real_time)
        self.description = RobotDescription.of(plant, real_time)
        self.timeout, self.patience, self.answer_within = float(timeout), float(patience), float(answer_within)
        self.safe_input = _safe_input(safe_input, self.description)
        self.counts: Counter[str] = Counter()
        self._run: int | None = None
        self._seed: int | None = None
        self._sequence = self._answered = -1
        self._input, self._heard = self.safe_input, clock()

    def drive(self, runs: int | None = 1, wait: float | None = None) -> None:
        """Take part in `runs` runs, which a controller ends (None: for ever). If one dies, wait for another.

        wait: s to wait for a controller each time; None: for ever.
        Raises TimeoutError when no controller came, and ConnectionError, with the reason, when one refused this robot.
        At the end, also after an error, the safe input is applied and the controller is informed.
        """
        done, started = 0, False
        try:
            while runs is None or done < runs:
                try:
                    if not started:
                        self._await_start(wait)
                    started = False
                    self._run_through()
                except _Started:
                    started = True
                except _Over as over:
                    done += over.finished
                    self._run = None
                    self.plant.step(self.safe_input)
        finally:
            if self._run is not None:
                self.link.send(Message(Kind.END, self._run, max(self._sequence, 0), status=Code.OTHER,
                                       text="the robot stops"))
                self.plant.step(self.safe_input)

    def _await_start(self, wait: float | None) -> None:
        """Send HELLO until a START raises _Started; in real time the plant goes on under the safe input."""
        begun = hello = tick = self.clock()
        while wait is None or self.clock() - begun <= wait:
            if self.clock() >= hello:
                self.link.send(Message(Kind.HELLO, text=self.description.text))
                hello = self.clock() + AGAIN
            self._listen(min(hello, tick) if self.real_time else hello)
            if self.real_time and self.clock() >= tick:
                self.plant.step(self.safe_input)
                tick = max(tick + self.description.timestep, self.clock())
        raise TimeoutError(f"no controller answered within {wait:g} s; start ssmr serve-controller, or "
                           "ssmr control with plant=remote, and check the address")

    def _run_through(self) -> None:
        """One run, until _Over or _Started is raised."""
        observation, self._input = self.plant.reset(self._seed), self.safe_input
        self._sequence, self._answered = 0, -1
        tick = self._heard = self.clock()
        while True:
            if self._ask(observation, tick) is None:
                self.counts["missed"] += 1
                if self.clock() - self._heard > self.timeout or not self.real_time:
                    self.counts["lost_controllers"] += 1
                    log.warning("the controller is silent; the safe input is applied")
                    raise _Over(finished=False)
            observation = self.plant.step(self._input)
            if self.real_time:
                tick = self._pace(tick + self.description.timestep)
            self._sequence += 1

    def _ask(self, observation: np.ndarray, tick: float) -> np.ndarray | None:
        """The input for this observation, or None when none came in time."""
        stamp = self.clock() if self.real_time else self.description.timestep * self._sequence
        message = Message(Kind.MEASUREMENT, self._run, self._sequence, stamp, values=observation)
        if self.real_time:
            self.link.send(message)
            return self._listen(tick + self.answer_within * self.description.timestep)
        until = self.clock() + self.patience
        while self.clock() < until:
            self.link.send(message)
            answer = self._listen(min(until, self.clock() + AGAIN))
            if answer is not None:
                return answer
        return None

    def _pace(self, tick: float) -> float:
        """Wait for the next tick. Returns its time."""
        late = self.clock() - tick
        if late > 0:
            self.counts["overruns"] += 1
            # A delay of less than a step is caught up. After a longer one, many steps would follow each other at once.
            return tick if late < self.description.timestep else self.clock()
        while self.clock() < tick:
            if self._listen(tick) is not None:
                # Too late for this step, but newer than the input that would be held in the next step.
                self.counts["late"] += 1
        return tick

    def _listen(self, until: float) -> np.ndarray | None:
        """The command for the newest measurement, or None at `until`. Raises _Started and _Over."""
        while True:
            data = self.link.receive(max(until - self.clock(), 0.0))
            if data is None:
                return None
            try:
                answer = self._heed(unpack(data))
            except Malformed as error:
                self.counts["malformed"] += 1
                log.warning("a malformed message was dropped: %s", error)
                answer = None
            if answer is not None or self.clock() >= until:
                return answer

    def _heed(self, message: Message) -> np.ndarray | None:
        if message.kind is Kind.COMMAND:
            return self._command(message)
        if message.kind is Kind.START:
            try:
                seed = read_start(message.text)
            except ValueError as error:
                raise Malformed(str(error)) from error
            if message.run != self._run:
                self._run, self._seed = message.run, seed
                raise _Started
        elif message.kind is Kind.END and message.run == self._run:
            log.info("the run is over: %s", message.text)
            raise _Over(finished=message.status == Code.OK)
        elif message.kind is Kind.REFUSE and self._run is None:
            if message.status != Code.BUSY:
                raise ConnectionError(f"the controller refused this robot: {message.text}")
            self.counts["busy"] += 1
            log.info("%s; asking again", message.text)
        return None

    def _command(self, message: Message) -> np.ndarray | None:
        if message.run != self._run:
            self.counts["foreign"] += 1
        elif message.values.shape != self.safe_input.shape or not np.isfinite(message.values).all():
            raise Malformed(f"a COMMAND has the input {message.values.tolist()}; expected {len(self.safe_input)} "
                            "finite numbers")
        elif message.sequence == self._answered:
            self.counts["repeated"] += 1
        elif message.sequence != self._sequence:
            self.counts["late"] += 1
        else:
            self._answered, self._heard, self._input = message.sequence, self.clock(), message.values
            return message.values
        return None


class _Started(Exception):
    """A controller began a run."""


class _Over(Exception):
    """The run is over: the controller ended it, or is gone."""

    def __init__(self, finished: bool):
        super().__init__()
        self.finished = finished


def _safe_input(value, robot: RobotDescription) -> np.ndarray:
    low, high = robot.input_bounds
    safe = np.clip(0.0, low, high) if value is None else np.array(value, dtype=np.float64)
    if safe.shape != low.shape or not ((low <= safe) & (safe <= high)).all():
        raise ValueError(f"safe_input is {safe.tolist()}; expected {len(low)} numbers between {low.tolist()} and "
                         f"{high.tolist()}")
    return safe
