"""The robot's end of the wire: it connects any plant to a controller on another computer or in another process."""

from __future__ import annotations

import logging
from collections import Counter, deque
from collections.abc import Callable
from math import ceil
from secrets import randbits
from time import monotonic

import numpy as np

from ssmr_torch.checked_arguments import checked
from ssmr_torch.quantities import PATIENCE, TRUTH, VECTOR
from ssmr_torch.ranges import Number
from ssmr_torch.wire.limits import LARGEST_BODY, legible
from ssmr_torch.wire.messages import Code, Kind, Malformed, Message, RobotDescription, read_start, unpack
from ssmr_torch.wire.notices import Notices
from ssmr_torch.wire.stopping import ended_by_signals

log = logging.getLogger(__name__)

# s between two HELLOs; in lock-step also between two copies of an unanswered measurement.
AGAIN = 0.5
ROUNDING = 1e-6  # share of its range by which an input may exceed a bound; it is clipped
STARTS = 2**20  # that may follow one HELLO
WAITING = 4096  # messages that are read at once after a pause


class RobotEnd:
    """Sends a plant's measurements to a controller and applies its commands.

    link: a `RobotLink`.   real_time: True: the plant is stepped by the clock, one timestep at a time; False: it waits
    for every command (lock-step, for simulations).
    timeout: s without a fresh command after which, in real time, the safe input is applied until the next one comes.
    patience: s after which the run is given up; the same in lock-step.   answer_within: share of a timestep in which a
    command must come in real time. If none comes, the last input is held; a command that comes later in the timestep is
    used from the next step on.   safe_input: (m,), applied without a controller; default: the admissible input nearest
    to zero.   clock: s, never goes back.
    A command is fresh when it has the run and the number of the newest measurement, and comes within a timestep of it.
    After a pause of its own the robot skips numbers, so that they go on giving the time.
    counts: late, repeated, malformed and foreign messages; missed answers; overruns (steps that took longer than the
    timestep); lost_controllers; busy controllers; unauthenticated frames, see `wire.link`.
    Raises ValueError for settings out of range, and for a description that does not fit into a HELLO.
    """

    @checked(real_time=TRUTH, timeout=PATIENCE, patience=PATIENCE, answer_within=Number(1e-3, 1.0), safe_input=VECTOR)
    def __init__(self, plant, link, *, real_time: bool = False, timeout: float = 0.2, patience: float = 60.0,
                 answer_within: float = 0.5, safe_input=None, clock: Callable[[], float] = monotonic):
        if not (0 < timeout < np.inf and 0 < patience < np.inf and 0 < answer_within <= 1):
            raise ValueError(f"timeout is {timeout} s, patience {patience} s and answer_within {answer_within}; "
                             "expected a positive timeout and patience, and a share of a timestep, 1 at most")
        self.plant, self.link, self.clock, self.real_time = plant, link, clock, bool(real_time)
        self.description = RobotDescription.of(plant, real_time)
        size = len(self.description.text.encode())
        if size > LARGEST_BODY:
            raise ValueError(f"the robot's description has {size} bytes; expected {LARGEST_BODY} at most: observe "
                             "fewer outputs")
        self.timeout, self.patience, self.answer_within = float(timeout), float(patience), float(answer_within)
        self.safe_input = _safe_input(safe_input, self.description)
        self.counts: Counter[str] = Counter()
        if link is not None:
            link.counts = self.counts
        self._signed = getattr(link, "seal", None) is not None
        self._run: int | None = None
        self._seed: int | None = None
        self._request, self._started = 0, deque(maxlen=1000)  # the number of a HELLO; runs that have been started
        self._sequence = self._answered = -1
        self._input, self._alone = self.safe_input, True
        self._begun = self._heard = self._sent = clock()
        self._notices = Notices(log)

    def drive(self, runs: int | None = 1, wait: float | None = None) -> None:
        """Take part in `runs` runs, which a controller ends (None: for ever). If one dies, wait for another.

        wait: s to wait for a controller each time; None: for ever.
        Raises TimeoutError when no controller came, and ConnectionError, with the reason, when one refused this robot.
        At the end, also after an error, the safe input is applied and the controller is informed.
        """
        with ended_by_signals():
            try:
                self._drive(runs, wait)
            finally:
                if self._run is not None:
                    self.link.send(Message(Kind.END, self._run, max(self._sequence, 0), status=Code.OTHER,
                                           text="the robot stops"))
                    self.plant.step(self.safe_input)

    def _drive(self, runs: int | None, wait: float | None) -> None:
        done, started = 0, False
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

    def _await_start(self, wait: float | None) -> None:
        """Send HELLO until a START raises _Started; in real time the plant goes on under the safe input."""
        begun = hello = tick = self.clock()
        self._request = 1 + randbits(62)
        while wait is None or self.clock() - begun <= wait:
            if self.clock() >= hello:
                self.link.send(Message(Kind.HELLO, sequence=self._request, text=self.description.text))
                hello = self.clock() + AGAIN
            self._listen(min(hello, tick) if self.real_time else hello)
            if self.real_time and self.clock() >= tick:
                self.plant.step(self.safe_input)
                tick = max(tick + self.description.timestep, self.clock())
        raise TimeoutError(f"no controller answered within {wait:g} s; start ssmr serve-controller, or "
                           "ssmr control with plant=remote, and check the address and the key")

    def _run_through(self) -> None:
        """One run, until _Over or _Started is raised."""
        observation, self._input = self.plant.reset(self._seed), self.safe_input
        self._sequence, self._answered, self._alone = 0, -1, False
        tick = self._begun = self._heard = self.clock()
        while True:
            if self._ask(observation, tick) is None:
                self._unanswered()
            if self.real_time:
                self._be_safe_if_silent()  # it may have paused since it heard the command
            observation, observed = self.plant.step(self._input), self.clock()
            tick = self._pace()
            if self.real_time and self.clock() - observed >= 2 * self.description.timestep:
                # After a pause in between, this observation is as old as the pause.
                self._be_safe_if_silent()
                observation = self.plant.step(self._input)

    def _unanswered(self) -> None:
        """Hold the last input until the timeout, then the safe one; give up when the patience ends."""
        if not self.real_time:
            self.counts["missed"] += 1
            self._leave_alone("the controller is silent; the safe input is applied")
            raise _Over(finished=False)
        self.counts["missed"] += not self._alone
        self._be_safe_if_silent()
        if self._alone and self.clock() - self._heard > self.patience:
            raise _Over(finished=False)

    def _be_safe_if_silent(self) -> None:
        silent = self.clock() - self._heard
        if silent > self.timeout and not self._alone:
            self._leave_alone(f"no fresh command for {silent:.3g} s; the safe input is applied until one comes")

    def _leave_alone(self, why: str) -> None:
        self.counts["lost_controllers"] += 1
        self._notices.say("lost", why)
        self._alone, self._input = True, self.safe_input

    def _ask(self, observation: np.ndarray, tick: float) -> np.ndarray | None:
        """The input for this observation, or None when none came in time."""
        stamp = self.clock() if self.real_time else self.description.timestep * self._sequence
        message = Message(Kind.MEASUREMENT, self._run, self._sequence, stamp, values=observation)
        self._sent = self.clock()
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

    def _pace(self) -> float:
        """Wait for the next sample and set its number. Returns its time."""
        number = self._sequence + 1
        if self.real_time:
            late = self.clock() > self._time_of(number)
            self._wait_for(number)
            while self.clock() - self._time_of(number) >= self.description.timestep:
                # A delay of less than a step is caught up. After a longer one, the numbers that are over are skipped.
                late = True
                self._read_all()
                number = ceil((self.clock() - self._begun) / self.description.timestep)
                self._wait_for(number)
            if late:
                self.counts["overruns"] += 1
        self._sequence = number
        return self._time_of(number)

    def _time_of(self, number: int) -> float:
        return self._begun + number * self.description.timestep

    def _wait_for(self, number: int) -> None:
        while self.clock() < self._time_of(number):
            if self._listen(self._time_of(number)) is not None:
                # Too late for this step, but newer than the input that would be held in the next step.
                self.counts["late"] += 1

    def _read_all(self) -> None:
        """Read what came during a pause: none of it answers the measurement that is sent next."""
        for _ in range(WAITING):
            data = self.link.receive(0.0)
            if data is None:
                return
            self._take(data)

    def _listen(self, until: float) -> np.ndarray | None:
        """The command for the newest measurement, or None at `until`. Raises _Started and _Over."""
        while True:
            data = self.link.receive(max(until - self.clock(), 0.0))
            if data is None:
                return None
            answer = self._take(data)
            if answer is not None or self.clock() >= until:
                return answer

    def _take(self, data: bytes) -> np.ndarray | None:
        """The command in these bytes, if it is fresh. Raises _Started and _Over."""
        try:
            return self._heed(unpack(data))
        except Malformed as error:
            self.counts["malformed"] += 1
            self._notices.say("malformed", f"a malformed message was dropped: {error}")
            return None

    def _heed(self, message: Message) -> np.ndarray | None:
        if message.kind is Kind.COMMAND:
            return self._command(message)
        if message.kind is Kind.START:
            self._start(message)
        elif message.kind is Kind.END and message.run == self._run:
            self._end(message)
        elif message.kind is Kind.REFUSE and self._run is None and self._answers(message):
            if message.status != Code.BUSY:
                raise ConnectionError(f"the controller refused this robot: {legible(message.text, 1000)}")
            self.counts["busy"] += 1
            self._notices.say("busy", f"{legible(message.text)}; asking again", level=logging.INFO)
        return None

    def _answers(self, message: Message) -> bool:
        """Whether a START or REFUSE answers the last HELLO; controllers of older releases do not tell."""
        return 0 <= message.sequence - self._request < STARTS or message.sequence == 0 and not self._signed

    def _start(self, message: Message) -> None:
        try:
            seed = read_start(message.text)
        except ValueError as error:
            raise Malformed(str(error)) from error
        if message.run == self._run:
            return
        if not self._answers(message) or message.run in self._started:
            self.counts["repeated"] += 1
            return
        self._started.append(message.run)
        self._run, self._seed, self._request = message.run, seed, max(self._request, message.sequence + 1)
        raise _Started

    def _end(self, message: Message) -> None:
        if message.status != Code.SUSPENDED:
            self._notices.say("over", f"the run is over: {legible(message.text)}", level=logging.INFO)
            raise _Over(finished=message.status == Code.OK)
        if self.real_time and not self._alone and message.sequence > self._answered:
            self._leave_alone("the controller suspended the run; the safe input is applied until a command comes")

    def _command(self, message: Message) -> np.ndarray | None:
        low, high = self.description.input_bounds
        slack = ROUNDING * (high - low)
        if message.run != self._run:
            self.counts["foreign"] += 1
        elif message.values.shape != low.shape or not ((low - slack <= message.values)
                                                       & (message.values <= high + slack)).all():
            raise Malformed(f"a COMMAND has the input {legible(str(message.values.tolist()))}; expected {len(low)} "
                            "numbers within the bounds of this robot")
        elif message.sequence == self._answered:
            self.counts["repeated"] += 1
        elif message.sequence != self._sequence or not self._in_time:
            self.counts["late"] += 1
        else:
            self._answered, self._heard, self._alone = message.sequence, self.clock(), False
            self._input = np.clip(message.values, low, high)
            return self._input
        return None

    @property
    def _in_time(self) -> bool:
        """Whether a command that comes now is fresh; in lock-step the robot's time stands still."""
        return not self.real_time or self.clock() - self._sent <= self.description.timestep


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
