"""Fills gaps in the window of an estimator: values for measurements that were dropped or out of range."""

from __future__ import annotations

import numpy as np


def mend(observations: np.ndarray, gaps: np.ndarray | None, good: np.ndarray) -> np.ndarray | None:
    """Fill, in place, the gaps that end with the newest sample. Returns the gaps that are still open after it.

    observations: (T, p), oldest first, m. gaps: (p,) samples since the last good value of each output; None where all
    are zero, also in the result. good: (p,) whether the newest value of each output is present and in range.

    A gap of g samples between the values y_a and y_b is filled by the parabola through y_a, y_b and the value g samples
    before y_a; by a straight line where this value is no longer stored; by y_b where the gap is longer than the window.
    """
    gaps = np.zeros(len(good), dtype=int) if gaps is None else gaps
    for output in np.flatnonzero(good & (gaps > 0)):
        rows, gap = observations[:, output], gaps[output]
        if gap + 2 > len(rows):
            rows[:] = rows[-1]
            continue
        s, last = np.arange(1, gap + 1) / (gap + 1), rows[-2 - gap]
        rows[-1 - gap:-1] = last + s * (rows[-1] - last)
        if 2 * gap + 3 <= len(rows):
            rows[-1 - gap:-1] -= 0.5 * s * (1.0 - s) * (rows[-1] - 2.0 * last + rows[-3 - 2 * gap])
    gaps = np.where(good, 0, np.minimum(gaps + 1, len(observations)))
    return gaps if gaps.any() else None
