"""What several findings need of the recordings, computed once."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ssmr_torch.recording_checks.delay import Delay, command_delay
from ssmr_torch.recording_checks.modes import Modes, slow_modes
from ssmr_torch.recording_checks.noise import Noise, measurement_noise
from ssmr_torch.trajectory import Trajectory, TrajectoryDataset


@dataclass(frozen=True, eq=False)
class Recorded:
    """A dataset's runs in memory, and its slow modes, noise and delay, from what is trained on."""

    dataset: TrajectoryDataset

    @cached_property
    def runs(self) -> tuple[Trajectory, ...]:
        return tuple(run.read() for run in self.dataset)

    def of(self, split: str, kind: str | None = None) -> tuple[Trajectory, ...]:
        """Runs of this split and kind; without a kind all but static ones."""
        return tuple(run for run in self.runs if run.split == split and (
            run.kind != "static" if kind is None else run.kind == kind))

    @cached_property
    def training(self) -> tuple[Trajectory, ...]:
        return self.of("train")

    @cached_property
    def extent(self) -> np.ndarray:
        """(p,) m, from the lowest to the highest position of the training."""
        y = np.concatenate([run.observation for run in self.training or self.runs])
        return np.ptp(y, axis=0)

    @property
    def reach(self) -> float:
        """m, the largest of the outputs' extents."""
        return float(self.extent.max())

    @cached_property
    def input_extent(self) -> np.ndarray:
        """(m,), from the lowest to the highest input of the training."""
        return np.ptp(np.concatenate([run.input for run in self.training or self.runs]), axis=0)

    @cached_property
    def modes(self) -> Modes:
        return slow_modes(self.training)

    @cached_property
    def noise(self) -> Noise:
        return measurement_noise(self.training or self.runs)

    @cached_property
    def delay(self) -> Delay:
        return command_delay(self.of("train", "controlled"))
