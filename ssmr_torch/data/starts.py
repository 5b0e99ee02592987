"""From which samples of recorded runs a model is scored, and on which runs."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ssmr_torch.periods import TOLERANCE


@dataclass(frozen=True, eq=False)
class ScoredRuns:
    """What a model in training is scored on, over `horizon` s from `starts` samples that `seed` draws.

    runs: as measured, what predictions are compared with. seen: the same with noise, where the windows that
    predictions start from carry any.
    """

    runs: tuple
    seen: tuple
    horizon: float
    starts: int
    seed: int

    def to(self, device) -> ScoredRuns:
        """Itself: the scorer moves one block of windows after the other."""
        return self


def draw_starts(lengths: np.ndarray, margin: int, span: int, count: int,
                seed: int) -> tuple[np.ndarray, np.ndarray]:
    """`count` different starts, uniform over all samples with `margin` before and `span` after in their
    trajectory.

    lengths: (R,) samples per trajectory. Returns trajectory and sample (N,) of each start, in order; all
    admissible ones where there are fewer than `count`. Raises ValueError when there is none.
    """
    if count < 1 or margin < 0 or span < 1:
        raise ValueError(f"{count} starts with {margin} samples before and {span} after; "
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
    """`draw_starts` of which each has the horizon (s) after it, and the samples in that.

    timestep: sampling time, s. Raises ValueError where the horizon holds no sample, or no trajectory the horizon.
    """
    span = samples_within(horizon, timestep)
    if span < 1:
        raise ValueError(f"the horizon of {horizon:g} s is shorter than a sample: the data are {timestep:g} s apart; "
                         "take longer horizons")
    return *draw_starts(lengths, margin, span, count, seed), span


def samples_within(horizon: float, timestep: float) -> int:
    """Whole timesteps in a horizon, both in s. Raises ValueError for a horizon that is no positive number."""
    if not (math.isfinite(horizon) and horizon > 0):
        raise ValueError(f"a horizon of {horizon} s; expected a positive number of seconds")
    ratio = horizon / timestep
    nearest = round(ratio)
    return nearest if abs(ratio - nearest) <= TOLERANCE * ratio else math.floor(ratio)
