"""The controller's answers to the measurements of one run."""

from __future__ import annotations

from collections import Counter
from time import perf_counter
from typing import NamedTuple

import numpy as np

from ssmr_torch.wire.messages import Code, Kind, Message, RobotDescription
from ssmr_torch.wire.stream import MeasurementStream

# So many samples that are missing at once are given to the controller one by one; more would take too long.
ONE_BY_ONE = 5


class Sample(NamedTuple):
    """One sample: time s, observation (p,) m (NaN where nothing came), the controller's Command, solve time s."""

    time: float
    observation: np.ndarray
    command: object
    solve_time: float


class Answers:
    """Asks the controller at every sample of a run.

    run: its number.   silence: s, in which so many samples may be missing.   duration: s, of the task; None: no end.
    stream: the measurements.   samples: what was asked.   newest: the last COMMAND.
    """

    def __init__(self, run: int, robot: RobotDescription, controller, silence: float, duration: float | None,
                 counts: Counter):
        self.run, self.robot, self.controller = run, robot, controller
        self.last = np.inf if duration is None else np.ceil(duration / robot.timestep - 1e-9)
        self.stream = MeasurementStream(len(robot.output_names), robot.timestep,
                                        max(1, round(silence / robot.timestep)), counts)
        self.samples: list[Sample] = []
        self.newest: Message | None = None

    def to(self, message: Message, now: float) -> Message | None:
        """The COMMAND for the next measurement; those before it that did not come are missing. None: the task is done.
        """
        ahead = message.sequence + self.stream.shift - self.stream.next
        if ahead > ONE_BY_ONE:
            self.stream.skip(ahead)
        for _ in range(ahead if ahead <= ONE_BY_ONE else 0):
            self._ask(self.stream.skip(), self._nothing)
        time, observation = self.stream.take(message, now)
        return self._command(time, observation, missed=not np.isfinite(observation).all())

    def blind(self, overdue: int = 0) -> Message | None:
        """The COMMAND without the next measurement; None: the task is done.

        overdue: number of samples that are missing besides. Many of them are passed over: this end was held up as well.
        """
        if overdue > ONE_BY_ONE:
            self.stream.skip(overdue)
        return self._command(self.stream.skip(), self._nothing, missed=True)

    @property
    def _nothing(self) -> np.ndarray:
        return np.full(self.stream.outputs, np.nan)

    def _ask(self, time: float, observation: np.ndarray) -> Sample:
        start = perf_counter()
        command = self.controller(time, observation)
        sample = Sample(time, observation, command, perf_counter() - start)
        self.samples.append(sample)
        return sample

    def _command(self, time: float, observation: np.ndarray, missed: bool) -> Message | None:
        sample = self._ask(time, observation)
        if self.stream.next - 1 >= self.last:
            return None
        status = Code.MISSED if missed else code_of(sample.command)
        self.newest = Message(Kind.COMMAND, self.run, self.stream.number, sample.solve_time, status,
                              sample.command.input)
        return self.newest


def code_of(command) -> Code:
    """The status for a COMMAND message with this Command."""
    if command.fallback is not None:
        return Code.__members__.get(command.fallback.name, Code.OTHER)
    return Code.HELD if command.held else Code.OK
