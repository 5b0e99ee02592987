"""Starts of the rollouts that score a model: random samples of the scored runs."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ssmr_torch.periods import TOLERANCE


@dataclass(frozen=True, eq=False)
class ScoredRuns:
    """The runs on which a model is scored during training, over `horizon` s from `starts` samples drawn with `seed`.

    runs: the measured runs, to which predictions are compared. seen: the same runs, with noise if the windows at the
    starts have noise.
    """

    runs: tuple
    seen: tuple
    horizon: float
    starts: int
    seed: int

    def to(self, device) -> ScoredRuns:
        """Unchanged, because the scorer moves one block of windows at a time to the device."""
        return self


def draw_starts(lengths: np.ndarray, margin: int, span: int, count: int,
                seed: int) -> tuple[np.ndarray, np.ndarray]:
    """`count` different starts, drawn uniformly from all samples with `margin` samples before and `span` samples after
    them in their trajectory.

    lengths: (R,), number of samples of each trajectory. Returns trajectory (N,) and sample (N,) of each start, in
    order; all possible starts if there are fewer than `count`. Raises ValueError if there is none.
    """
    if count < 1 or margin < 0 or span < 1:
        raise ValueError(f"{count} starts with {margin} samples before and {span} samples after them; "
                         "expected at least 1, 0 and 1")
    lengths = np.asarray(lengths)
    admissible = np.maximum(lengths - margin - span, 0)
    total = int(admissible.sum())
    if total == 0:
        raise ValueError(f"the longest of {len(lengths)} trajectories has {lengths.max()} samples; a start "
                         f"needs {margin} before and {span} after it, {margin + span + 1} in all; "
                         "take shorter horizons, or longer runs")
    drawn = np.sort(np.random.default_rng(seed).choice(total, size=min(count, total), replace=False))
    ends = np.cumsum(admissible)
    owner = np.searchsorted(ends, drawn, side="right")
    return owner, drawn - (ends - admissible)[owner] + margin


def starts_over(lengths: np.ndarray, horizon: float, timestep: float, *, margin: int, count: int,
                seed: int) -> tuple[np.ndarray, np.ndarray, int]:
    """`draw_starts` with the horizon (s) after every start. It also returns the number of samples in the horizon.

    timestep: sampling time, s. Raises ValueError if the horizon is shorter than a sample or longer than all
    trajectories.
    """
    span = samples_within(horizon, timestep)
    if span < 1:
        raise ValueError(f"the horizon of {horizon:g} s is shorter than the sampling time of the data, {timestep:g} s; "
                         "take a longer horizon")
    return *draw_starts(lengths, margin, span, count, seed), span


def samples_within(horizon: float, timestep: float) -> int:
    """Number of whole timesteps in a horizon, both in s. Raises ValueError unless the horizon is positive."""
    if not (math.isfinite(horizon) and horizon > 0):
        raise ValueError(f"a horizon of {horizon} s; expected a positive number of seconds")
    ratio = horizon / timestep
    nearest = round(ratio)
    return nearest if abs(ratio - nearest) <= TOLERANCE * ratio else math.floor(ratio)
