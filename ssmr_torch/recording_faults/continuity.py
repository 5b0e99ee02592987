"""Where a motion jumps: the statistic behind the search for outliers, lost and exchanged markers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from ssmr_torch.recording_clocks.gaps import find_time_gaps
from ssmr_torch.recording_faults.recording import Recording

CERTAIN = 8.0       # times the gap that 90 % of the rows stay below; sound recordings stay below 5.5 times
MATTERS = 0.01      # of the reach, below which a jump is too small to matter
WINDOW = 50         # rows on either side from which the usual gap is taken
STEPS = 3.0         # smallest steps of rounded values, below which a jump is rounding
FEWEST = 12         # rows below which nothing can be judged
AROUND = 3          # rows on either side that a jump is judged by


def gaps(time: np.ndarray, y: np.ndarray) -> np.ndarray:
    """(T, p), signed: by how much y jumps between rows k - 1 and k.

    Row k is predicted from the rows before it, and row k - 1 from the rows after it, each by a straight line through
    two rows and by a parabola through three, of which the better counts. The jump is the smaller of the two misses if
    both go the same way, else zero. A kink of the motion, as an input step makes it, is no jump: seen from one side it
    is not there. Rows without `AROUND` rows on either side get zero.
    """
    found = np.zeros_like(y)
    k = np.arange(AROUND, len(y) - AROUND + 1)
    if not len(k):
        return found
    before = _missed(time, y, k, k - 1, -1)
    after = -_missed(time, y, k - 1, k, 1)
    smaller = np.where(np.abs(before) < np.abs(after), before, after)
    found[k] = np.where(before * after > 0, smaller, 0.0)
    return found


def _missed(time: np.ndarray, y: np.ndarray, rows: np.ndarray, nearest: np.ndarray, step: int) -> np.ndarray:
    """y[rows] less its prediction from the rows nearest, nearest + step and nearest + 2 step."""
    (ta, tb, tc), (a, b, c) = ([x[nearest + n * step] for n in range(3)] for x in (time, y))
    near, next_ = (time[rows] - ta)[:, None], (time[rows] - tb)[:, None]
    slope, slope_before = (a - b) / (ta - tb)[:, None], (b - c) / (tb - tc)[:, None]
    line = y[rows] - (a + slope * near)
    parabola = line - (slope - slope_before) / (ta - tc)[:, None] * near * next_
    return np.where(np.abs(line) < np.abs(parabola), line, parabola)


def limits(y: np.ndarray, found: np.ndarray, reach: float) -> np.ndarray:
    """(T, p): the gap above which a row counts as a jump.

    It is the largest of `CERTAIN` times the 90 % quantile of the gaps, over the run and over `WINDOW` rows on either
    side; of `STEPS` smallest steps of the values; and of `MATTERS` times the reach.
    """
    size = np.abs(found)
    usual = np.broadcast_to(np.quantile(size, 0.9, axis=0), size.shape)
    if len(size) > 2 * WINDOW + 1:
        local = np.quantile(sliding_window_view(size, 2 * WINDOW + 1, axis=0), 0.9, axis=-1)
        usual = np.maximum(usual, np.pad(local, ((WINDOW, WINDOW), (0, 0)), mode="edge"))
    return np.maximum(np.maximum(CERTAIN * usual, STEPS * smallest_step(y)), MATTERS * reach)


def smallest_step(y: np.ndarray) -> np.ndarray:
    """(p,), smallest difference of two rows that is not zero; that of rounding, if y is rounded."""
    steps = np.abs(np.diff(y, axis=0))
    steps[steps < 1e-9 * np.abs(y).max(initial=0.0)] = np.inf  # the last bit of a product with the unit
    least = steps.min(axis=0, initial=np.inf)
    return np.where(np.isfinite(least), least, 0.0)


def extent(y: np.ndarray) -> float:
    """Largest range of any column, without the outermost hundredths."""
    low, high = np.quantile(y, (0.01, 0.99), axis=0)
    return float((high - low).max())


def usual_reach(recordings: Sequence[Recording]) -> float:
    """m, the median over the runs of how far they move; one bad run does not change it."""
    moved = [extent(each.observation[good]) for each in recordings
             if (good := np.isfinite(each.observation).all(axis=1)).any()]
    return float(np.median(moved)) if moved else 0.0


def pieces(recording: Recording) -> list[slice]:
    """Stretches without a known seam, an earlier cut or a gap in time; continuity is judged within each."""
    time = recording.time
    steps = np.diff(time)
    if not np.isfinite(time).all() or (steps <= 0).any():
        return []  # such a clock is refused later
    edges = set(find_time_gaps(time))
    known = () if isinstance(recording.seams, str) else recording.seams
    edges |= set(np.searchsorted(recording.rows, [*known, *recording.cuts]).tolist())
    edges = sorted({0, len(time), *map(int, edges)})
    return [slice(first, stop) for first, stop in zip(edges, edges[1:]) if stop - first >= FEWEST]
