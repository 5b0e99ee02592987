"""`Trajectory`: one uninterrupted, uniformly sampled run of a robot, without a seam (restart or joined recording)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ssmr_torch import data_sheet as sheet
from ssmr_torch.data_sheet import DataSheet

KINDS = ("decay", "controlled", "static")
SPLITS = ("train", "validation", "test")
JITTER_TOLERANCE = 1e-3
STRETCH = 65536  # number of samples that are read at once


class Run(DataSheet):
    """Base class of trajectories in memory and trajectories in a file."""

    if TYPE_CHECKING:  # what they have; a property here would become the default of a dataclass's field
        name: str
        kind: str
        split: str

        @property
        def length(self) -> int:
            raise NotImplementedError

        @property
        def timestep(self) -> float:
            raise NotImplementedError

        def slice(self, start: int, stop: int) -> tuple[np.ndarray, np.ndarray]:
            raise NotImplementedError

    def extremes(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest values of the observation (2, p), m, and of the input (2, m); read piece by piece."""
        parts = [self.slice(start, min(start + STRETCH, self.length)) for start in range(0, self.length, STRETCH)]
        observation, inputs = (np.stack([np.min([part[which].min(0) for part in parts], axis=0),
                                         np.max([part[which].max(0) for part in parts], axis=0)]) for which in (0, 1))
        return observation, inputs

    def data_sheet(self) -> tuple[str, dict]:
        observation, inputs = self.extremes()
        named = [[f"{letter}{place}" for place in range(1, array.shape[1] + 1)]
                 for letter, array in (("y", observation), ("u", inputs))]
        return (f"{type(self).__name__} {self.name!r}: {self.length} samples, "
                f"{sheet.number(self.timestep * (self.length - 1))} s", {
                    "use": f"{self.kind}, {self.split}", "sampling time": sheet.period(self.timestep),
                    "observation": sheet.spans(named[0], observation[0], observation[1], "mm", 1e3),
                    "input": sheet.spans(named[1], inputs[0], inputs[1], "")})


@dataclass(frozen=True, eq=False)
class Trajectory(Run):
    """One run of a robot.

    time: (T,) s, strictly increasing, uniform within `JITTER_TOLERANCE` of its step.
    observation: (T, p) displacement from the rest position, m.
    input: (T, m); input[k] is held from time[k] to time[k+1], so it does not act on observation[k] yet.

    Raises ValueError if the arrays differ in length, hold non-finite numbers, or time is not uniform.

    >>> Trajectory([0.0, 0.1, 0.2], [[0.0], [0.001], [0.0015]], [[1.0], [1.0], [0.0]], name="step")
    Trajectory 'step': 3 samples, 0.2 s
    ├─ use: controlled, train
    ├─ sampling time: 0.1 s (10 Hz)
    ├─ observation
    │  └─ y1: 0 … 1.5 mm
    └─ input
       └─ u1: 0 … 1
    """

    time: np.ndarray
    observation: np.ndarray
    input: np.ndarray
    kind: str = "controlled"
    split: str = "train"
    name: str = ""

    def __post_init__(self):
        for attribute in ("time", "observation", "input"):
            object.__setattr__(self, attribute, own_copy(getattr(self, attribute)))
        _validate(self)

    @property
    def length(self) -> int:
        return len(self.time)

    @property
    def timestep(self) -> float:
        """Sampling time in s."""
        return float((self.time[-1] - self.time[0]) / (self.length - 1))

    def slice(self, start: int, stop: int) -> tuple[np.ndarray, np.ndarray]:
        """Observations and inputs of the samples start ≤ k < stop."""
        return self.observation[start:stop], self.input[start:stop]

    def read(self) -> Trajectory:
        return self

    def observing(self, columns: Sequence[int]) -> Trajectory:
        """The same run with only these columns of the observation."""
        return replace(self, observation=self.observation[:, list(columns)])

    def part(self, start: int, stop: int | None = None, **changes: Any) -> Trajectory:
        """The samples start ≤ k < stop as a separate trajectory, with other fields changed by name."""
        kept = slice(start, stop)
        return replace(self, time=self.time[kept], observation=self.observation[kept], input=self.input[kept],
                       **changes)


def own_copy(array) -> np.ndarray:
    """A read-only copy, which later changes of the original do not affect."""
    copy = np.array(array, dtype=np.float64)
    copy.setflags(write=False)
    return copy


def _validate(trajectory: Trajectory) -> None:
    name = trajectory.name or "trajectory"
    time, observation, inputs = trajectory.time, trajectory.observation, trajectory.input
    if time.ndim != 1 or observation.ndim != 2 or inputs.ndim != 2:
        raise ValueError(f"{name}: expected time (T,), observation (T, p), input (T, m); "
                         f"got {time.shape}, {observation.shape}, {inputs.shape}")
    if not len(time) == len(observation) == len(inputs):
        raise ValueError(f"{name}: {len(time)} times, {len(observation)} observations and {len(inputs)} inputs; "
                         "expected the same number of all three")
    if len(time) < 2:
        raise ValueError(f"{name}: {len(time)} samples; expected at least 2")
    if trajectory.kind not in KINDS or trajectory.split not in SPLITS:
        raise ValueError(f"{name}: kind {trajectory.kind!r} and split {trajectory.split!r}; "
                         f"expected one of {KINDS} and one of {SPLITS}")
    for label, array in (("time", time), ("observation", observation), ("input", inputs)):
        bad = np.flatnonzero(~np.isfinite(array.reshape(len(array), -1)).all(axis=1))
        if len(bad):
            raise ValueError(f"{name}: {len(bad)} of {len(array)} samples of {label} are not finite, "
                             f"the first one is sample {bad[0]}; remove or repair them")
    steps = np.diff(time)
    if (steps <= 0).any():
        raise ValueError(f"{name}: time does not increase at sample {int(np.argmax(steps <= 0)) + 1}")
    jitter = np.abs(steps / trajectory.timestep - 1).max()
    if jitter > JITTER_TOLERANCE:
        raise ValueError(f"{name}: the sampling interval deviates by up to {100 * jitter:.3g} % from "
                         f"{trajectory.timestep:.6g} s, more than the permitted {100 * JITTER_TOLERANCE:g} %; "
                         "resample the run to a uniform grid first")
