"""Lost markers: zeros, -1, 9999 and other values that stand for "not seen"."""

from __future__ import annotations

import numpy as np

from ssmr_torch.recording_faults.continuity import CERTAIN, extent
from ssmr_torch.recording_faults.markers import markers
from ssmr_torch.recording_faults.recording import Recording
from ssmr_torch.recording_faults.treatment import treated

MATTERS = 0.03      # of the reach, by which such a value must miss the motion around it
RECURS = 3          # rows with one value, from which it can stand for "not seen" in one column alone
OUTSIDE = 0.5       # of the range of the other values, by which it must lie outside of them


def lost_markers(recording: Recording, rule: str, reach: float) -> Recording:
    """The recording without values that stand for "not seen".

    Such a value is the same in all coordinates of a marker (0, -1, 9999, …), or recurs exactly in one column far
    outside all others; and it misses the straight line between the rows around it. At rest at zero it does not.
    """
    y = recording.observation
    bad = np.zeros(y.shape, dtype=bool)
    for columns in markers(y.shape[1], recording.output_names):
        if len(columns) > 1:
            same = (y[:, columns] == y[:, columns[:1]]).all(axis=1)
            bad[:, columns] |= _missing_the_line(recording.time, y[:, columns], same, reach)[:, None]
    for column in range(y.shape[1]):
        bad[:, column] |= _far_and_equal(y[:, column], reach)
    if not bad.any() or bad.any(axis=1).all():
        return recording
    row, column = np.argwhere(bad)[0]
    names = recording.columns(bad.any(axis=0))
    verb = "are" if " and " in names else "is"
    return treated(recording, bad, "lost_markers", rule, f"{names or 'the position'} {verb} {1e3 * y[row, column]:.6g} "
                   "mm exactly, a value for 'not seen',")


def _missing_the_line(time, y, same: np.ndarray, reach: float) -> np.ndarray:
    """(T,), which of the rows `same` miss the straight line between the other rows around them."""
    others = np.flatnonzero(~same)
    if not same.any() or len(others) < 3:
        return np.zeros_like(same)
    clock = time if np.isfinite(time).all() and (np.diff(time) > 0).all() else np.arange(len(y), dtype=float)
    line = np.stack([np.interp(clock, clock[others], column[others]) for column in y.T], axis=1)
    a, b, c = (y[others[step:len(others) - 2 + step]] for step in range(3))
    usual = np.quantile(np.abs(b - (a + c) / 2), 0.9, axis=0)
    far = (np.abs(y - line) > np.maximum(CERTAIN * usual, MATTERS * reach)).any(axis=1)
    return same & far


def _far_and_equal(y: np.ndarray, reach: float) -> np.ndarray:
    """(T,), rows of one column with a value that recurs exactly and lies far outside all others."""
    values, place, count = np.unique(y, return_inverse=True, return_counts=True)
    bad = np.zeros(len(y), dtype=bool)
    for which in np.argsort(-count)[:5]:
        if count[which] < RECURS:
            break
        others = y[(place != which) & ~bad]
        if len(others) < 3:
            continue
        span = max(extent(others[:, None]), MATTERS * reach)
        beyond = OUTSIDE * span + 5 * MATTERS * reach
        low, high = np.quantile(others, (0.01, 0.99))
        if not low - beyond <= values[which] <= high + beyond:
            bad |= place == which
    return bad
