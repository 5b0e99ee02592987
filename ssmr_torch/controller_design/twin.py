"""Closed loops against a twin: a second model of the same recordings, which stands for the robot, with disturbances."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ssmr_torch.control.actuator import Actuator, ActuatorState
from ssmr_torch.control.model_step import Stepper
from ssmr_torch.controller_design.noises import Noises
from ssmr_torch.controller_design.recordings import Recordings
from ssmr_torch.models.polynomial import PolynomialModel
from ssmr_torch.tasks.references import Task

LOST = 0.05          # of the reach: a loop with a larger error for `PATIENCE` s counts as lost
PATIENCE = 0.3       # s
BEGIN = 1.0          # s at the start of a loop that do not count
SECONDS = 4.0        # length of a reference
SMALLER, SLOWER, WIDER = 0.7, 2.0, 2.2   # of a recorded motion: amplitude, duration; amplitude out of reach
SETTLED = 300        # samples in which the twin comes to rest


@dataclass(frozen=True)
class Case:
    """A disturbance of the twin: delay and lag added to the actuator's, s; gain of the first input; load, a constant
    input, as a share of half the range; play, as a share of the range.
    """

    name: str
    delay: float = 0.0
    lag: float = 0.0
    gain: float = 1.0
    load: float = 0.0
    play: float = 0.0


CASES = (Case("as it is"), Case("delay of 20 ms", delay=0.02), Case("delay and lag of 20 ms", delay=0.02, lag=0.02),
         Case("one input at 80 %", gain=0.8), Case("a load", load=0.1), Case("play of 2.5 %", play=0.025))


class Twin:
    """A simulated robot with `reset` and `step` like a plant; outputs in m, with the noise of the sensors.

    The twin has no white noise of states or inputs. Such noise would favour observers that follow the newest
    measurement more than the model, and these lost the reference where the robot was not as recorded.
    """

    def __init__(self, model: PolynomialModel, actuator: Actuator, recordings: Recordings, noises: Noises, case: Case):
        self.model, self.case, self.recordings = model, case, recordings
        self._of_sensor = noises.sensor * recordings.reach
        self._step = Stepper(model)
        extra = round(case.delay / actuator.timestep)
        if case.delay:
            extra = max(1, extra)
        self._actuator = replace(actuator, delay=actuator.delay + extra, play=actuator.play + case.play)
        self._share = float(np.exp(-actuator.timestep / case.lag)) if case.lag else 0.0
        self._gain = np.ones(model.input_dim)
        self._gain[0] = case.gain
        self._load = np.zeros(model.input_dim)
        self._load[0] = 0.5 * case.load * recordings.input_range[0]

    def reset(self) -> np.ndarray:
        neutral = self.recordings.neutral
        self.state = ActuatorState(self._actuator)
        self.state.rest_at(neutral)
        self._rng, self._lagged = np.random.default_rng(0), self.state.acting
        model = self.model
        self._z = model.encode(np.zeros((model.delays + 1, model.output_dim)), np.tile(neutral, (model.delays, 1)))
        for _ in range(SETTLED):
            self._z, self.output = self._step(self._z, self._acting(self.state.acting))
        return self._seen()

    def _acting(self, acting: np.ndarray) -> np.ndarray:
        lower, upper = self.recordings.bounds
        neutral = self.recordings.neutral
        return np.minimum(np.maximum(neutral + self._gain * (acting - neutral) + self._load, lower), upper)

    def step(self, command: np.ndarray) -> np.ndarray:
        self.state.apply(command)
        self._lagged = self._share * self._lagged + (1.0 - self._share) * self.state.acting
        with np.errstate(over="ignore", invalid="ignore"):
            self._z, self.output = self._step(self._z, self._acting(self._lagged))
        return self._seen()

    def _seen(self) -> np.ndarray:
        return self.output + self._of_sensor * self._rng.standard_normal(len(self.output))


def tracking_error(twin: Twin, controller: Callable, task: Task, columns, *, lost: float = LOST) -> float:
    """Root mean square of the tracking error after `BEGIN` s, as a share of the reach; infinite for a lost loop."""
    recordings = twin.recordings
    h, reach, columns = recordings.timestep, recordings.reach, list(columns)
    controller.reset()
    measured = twin.reset()
    times = h * np.arange(round(task.duration / h))
    reference = task.reference(times)
    total, count, bad = 0.0, 0, 0
    for time, target in zip(times, reference):
        error = float(np.square(twin.output[columns] - target).sum()) / reach**2
        if not np.isfinite(error):
            return np.inf
        if time >= BEGIN:
            total, count = total + error, count + 1
            bad = bad + 1 if error > lost**2 else 0
            if bad * h > PATIENCE:
                return np.inf
        measured = twin.step(controller(float(time), measured).input)
    return float(np.sqrt(total / max(count, 1)))


def recorded_motion(recordings: Recordings, names, *, scale: float = 1.0) -> Task:
    """A held-out run of the tracked outputs as a task from rest, smaller, slower and smoothed; scale: of its amplitude.
    """
    h, columns = recordings.timestep, list(recordings.tracked)
    observed = max(recordings.held, key=lambda piece: len(piece.input)).observation[:, columns]
    count = min(round(SECONDS / h), round(SLOWER * (len(observed) - 1)))
    at = np.arange(count) / SLOWER
    slow = np.stack([np.interp(at, np.arange(len(observed)), column) for column in observed.T], axis=1)
    kernel = np.hanning(max(3, round(0.1 / h)) + 2)
    kernel /= kernel.sum()
    smooth = np.stack([np.convolve(np.pad(column, len(kernel) // 2, mode="edge"), kernel, "same")
                       [len(kernel) // 2:][:count] for column in slow.T], axis=1)
    path = _Sampled(h, SMALLER * scale * smooth)
    return Task("a recorded motion", h * count, tuple(names), path)


@dataclass(frozen=True, eq=False)
class _Sampled:
    """Points every h s, with linear interpolation."""

    h: float
    points: np.ndarray

    def __call__(self, time: np.ndarray) -> np.ndarray:
        return np.stack([np.interp(time, self.h * np.arange(len(self.points)), column) for column in self.points.T], 1)
