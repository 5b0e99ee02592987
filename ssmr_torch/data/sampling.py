"""Resamples a recording from its own times to the uniform time grid of a trajectory."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from ssmr_torch.recording_clocks.held_inputs import mean_of_held
from ssmr_torch.trajectory import JITTER_TOLERANCE

IRREGULAR = 0.3


@dataclass(frozen=True)
class SamplingRule:
    """What to do with samples that are not on a uniform grid.

    sampling: "resample" to the grid, or "refuse" recordings that are not uniform.
    timestep: s, of the grid; None: the median interval, rounded to four digits.
    irregularity: largest share of the median interval by which 95 % of the intervals may deviate.
    missing: "refuse" rows that are not finite, or "split" the run there.
    minimum_length: number of samples; shorter runs are left out.
    """

    sampling: str = "resample"
    timestep: float | None = None
    irregularity: float = IRREGULAR
    missing: str = "refuse"
    minimum_length: int = 10

    def __post_init__(self):
        for key, value, known in (("sampling", self.sampling, ("resample", "refuse")),
                                  ("missing", self.missing, ("refuse", "split"))):
            if value not in known:
                raise ValueError(f"{key} is {value!r}; expected one of {known}")
        if self.timestep is not None and not self.timestep > 0:
            raise ValueError(f"timestep is {self.timestep} s; expected a positive number")
        if not (self.irregularity > 0 and self.minimum_length >= 2):
            raise ValueError(f"irregularity is {self.irregularity} and minimum_length {self.minimum_length}; "
                             "expected a positive share and at least 2 samples")


def irregularity(time: np.ndarray) -> float:
    """Largest deviation of 95 % of the sampling intervals from the median interval, as a share of it."""
    steps = np.diff(time)
    return float(np.quantile(np.abs(steps / np.median(steps) - 1), 0.95))


def is_uniform(time: np.ndarray, timestep: float) -> bool:
    """Whether all intervals are equal to `timestep` within the tolerance of a trajectory."""
    steps = np.diff(time)
    return bool(np.abs(steps / steps.mean() - 1).max() <= JITTER_TOLERANCE
                and abs(steps.mean() / timestep - 1) <= JITTER_TOLERANCE)


def resample(time: np.ndarray, observation: np.ndarray, inputs: np.ndarray,
             timestep: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The run on the grid time[0] + k·timestep, up to the end of the recording.

    Observations are values of a cubic spline (error O(timestep⁴) for smooth motion). Inputs are held between the
    irregular times; on the grid they become

        input[k] = (1 / timestep) ∫ u(t) dt   from grid[k] to grid[k+1],

    which keeps the impulse. (The latest sample instead would delay an input by a whole step if it comes microseconds
    after its grid point.)
    """
    count = int(np.floor((time[-1] - time[0]) / timestep * (1 + 1e-12) + 1e-9)) + 1
    grid = time[0] + timestep * np.arange(count)
    motion = CubicSpline(time, observation, axis=0)(np.minimum(grid, time[-1]))
    return grid, motion, mean_of_held(time, inputs, np.r_[grid, grid[-1] + timestep])


def to_grid(time: np.ndarray, observation: np.ndarray, inputs: np.ndarray, rule: SamplingRule,
            timestep: float, name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The run on a uniform grid; unchanged, if it is already uniform.

    Raises ValueError if the run is not uniform and the rule says "refuse", or if it is too irregular to resample.
    """
    if is_uniform(time, timestep):
        return time, observation, inputs
    if rule.sampling == "refuse":
        raise ValueError(f"{_facts(time, timestep, name)} within {100 * JITTER_TOLERANCE:g} %; set "
                         "sampling=resample to interpolate")
    refuse_irregular(time, rule, timestep, name)
    return resample(time, observation, inputs, timestep)


def refuse_irregular(time: np.ndarray, rule: SamplingRule, timestep: float, name: str) -> None:
    """Raises ValueError if the intervals deviate by more than the rule permits for interpolation."""
    spread = irregularity(time)
    if spread > rule.irregularity:
        raise ValueError(f"{_facts(time, timestep, name)}; 5 % of them deviate by more than "
                         f"{100 * spread:.3g} % from the median, the limit is {100 * rule.irregularity:.3g} "
                         "%; set stamps: even where the sampling was even, or raise irregularity to interpolate anyway")


def _facts(time: np.ndarray, timestep: float, name: str) -> str:
    steps = np.diff(time)
    return (f"{name}: sampling intervals from {steps.min():.4g} to {steps.max():.4g} s, median "
            f"{np.median(steps):.4g}, mean {steps.mean():.4g} s; expected {timestep:.4g} s")
