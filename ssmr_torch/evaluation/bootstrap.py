"""How sure a mean of few runs is. Arrays in, numbers out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

RESAMPLES = 10_000
VALUES_PER_BLOCK = 1 << 22


class Interval(NamedTuple):
    """mean, and the ends of its interval; NaN where there is none."""

    mean: float
    low: float
    high: float


def mean_interval(values: Sequence[float], confidence: float = 0.95, seed: int = 0,
                  resamples: int = RESAMPLES) -> Interval:
    """Mean of n values and its bootstrap percentile interval, from the means of n values drawn with replacement.

    One value has no interval; an infinite one (a failed run) makes the mean infinite, without an interval. seed fixes
    the draws. Of few values the interval is too short: those of 3, 5 and 10 normal ones hold the true mean in 76, 85
    and 91 % of the cases. Raises ValueError without values, for NaN, or a confidence outside of 0 to 1.
    """
    values = np.asarray(values, dtype=np.float64)
    if values.ndim != 1 or not len(values) or np.isnan(values).any() or not 0 < confidence < 1:
        raise ValueError(f"values of shape {values.shape}, {np.isnan(values).sum()} of them NaN, at a confidence of "
                         f"{confidence}; expected (n,), n >= 1, none NaN, and a confidence between 0 and 1")
    if len(values) == 1 or not np.isfinite(values).all():
        return Interval(float(values.mean()), np.nan, np.nan)
    rng, rows = np.random.default_rng(seed), max(1, VALUES_PER_BLOCK // len(values))
    sizes = [min(rows, resamples - first) for first in range(0, resamples, rows)]
    means = np.concatenate([values[rng.integers(len(values), size=(size, len(values)))].mean(axis=1)
                            for size in sizes])
    low, high = np.quantile(means, [(1 - confidence) / 2, (1 + confidence) / 2])
    return Interval(float(values.mean()), float(low), float(high))
