"""`Recorded`: the runs of a dataset and the quantities that several checks use, computed once."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ssmr_torch.recording_checks.noise import Noise, measurement_noise
from ssmr_torch.recording_clocks.lag import Lag, lag_of
from ssmr_torch.recording_clocks.onset import Onset, Signals, onset_of
from ssmr_torch.recording_estimates.modes import Modes, slow_modes
from ssmr_torch.trajectory import Trajectory, TrajectoryDataset


@dataclass(frozen=True, eq=False)
class Recorded:
    """The runs of a dataset in memory, and the slow modes, noise and delay of its training runs."""

    dataset: TrajectoryDataset

    @cached_property
    def runs(self) -> tuple[Trajectory, ...]:
        return tuple(run.read() for run in self.dataset)

    def of(self, split: str, kind: str | None = None) -> tuple[Trajectory, ...]:
        """Runs of this split and kind; without a kind, all runs except static ones."""
        return tuple(run for run in self.runs if run.split == split and (
            run.kind != "static" if kind is None else run.kind == kind))

    @cached_property
    def training(self) -> tuple[Trajectory, ...]:
        return self.of("train")

    @cached_property
    def extent(self) -> np.ndarray:
        """(p,), m, difference between the highest and the lowest position in the training runs."""
        y = np.concatenate([run.observation for run in self.training or self.runs])
        return np.ptp(y, axis=0)

    @property
    def reach(self) -> float:
        """m, the largest extent of any output."""
        return float(self.extent.max())

    @cached_property
    def input_extent(self) -> np.ndarray:
        """(m,), difference between the highest and the lowest input in the training runs."""
        return np.ptp(np.concatenate([run.input for run in self.training or self.runs]), axis=0)

    @cached_property
    def modes(self) -> Modes:
        return slow_modes(self.training)

    @cached_property
    def noise(self) -> Noise:
        return measurement_noise(self.training or self.runs)

    @cached_property
    def delay(self) -> Onset:
        return onset_of(self._signals)

    @cached_property
    def lag(self) -> Lag:
        return lag_of(self._signals, self.dataset.timestep)

    @property
    def _signals(self) -> list[Signals]:
        return [(run.observation, run.input) for run in self.of("train", "controlled")]
