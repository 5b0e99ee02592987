"""Finds the boundaries of runs in a recording: seams, jumps that no dynamics explains."""

from __future__ import annotations

import numpy as np

GUARD = 6           # number of samples around a jump that it affects
LONGEST_BLIP = 3    # largest number of wrong camera samples in a row


def find_seams(observation: np.ndarray, speed_ratio: float = 5.0, gap_ratio: float = 20.0,
               extent_ratio: float = 0.1, window: int = 50) -> np.ndarray:
    """Rows at which another run begins within a recording (seams).

    A body with mass keeps its velocity. The two straight lines through the samples on either side of the boundary
    between rows k-1 and k must therefore meet:

        gap_k = ‖ y_k - y_{k-1} - (d_{k-1} + d_{k+1}) / 2 ‖,   d_j = y_j - y_{j-1}.

    Row k is a seam if gap_k exceeds `speed_ratio` times the largest step and `gap_ratio` times the largest other gap in
    the `window` samples on either side, and also `extent_ratio` times the diagonal of the workspace. It must also do so
    if up to three samples next to it are ignored, because a wrong camera sample jumps as well but returns, and so does
    the small slip of a lost marker. The largest seam is found first; windows end at seams.

    It does not find smaller jumps, seams within six samples of the ends or of each other, and seams at which only the
    velocity jumps, because a step of the input and stick-slip look the same. Declare such seams.

    observation: (T, p), any unit. Returns sorted row numbers from 0, (n,).
    """
    y = np.asarray(observation, dtype=np.float64)
    if len(y) <= 2 * GUARD:
        return np.empty(0, dtype=int)
    speed = np.r_[0.0, np.linalg.norm(np.diff(y, axis=0), axis=1)]
    gap = persistent_gap(y)
    floor = max(extent_ratio * np.linalg.norm(np.ptp(y, axis=0)), speed_ratio * np.median(speed))
    seams: list[int] = []
    for k in np.argsort(gap)[::-1]:
        if gap[k] <= floor:
            break
        quiet = _neighbours(k, seams, len(y), window)
        if len(quiet) and gap[k] > speed_ratio * speed[quiet].max() and gap[k] > gap_ratio * gap[quiet].max():
            seams.append(int(k))
    return np.array(sorted(seams), dtype=int)


def persistent_gap(observation: np.ndarray) -> np.ndarray:
    """gap_k of `find_seams`, (T,): the smallest gap over all choices of ignored samples next to the boundary.
    The first and last six entries are zero.
    """
    y = observation
    k = np.arange(GUARD, len(y) - GUARD)
    gap = np.full(len(k), np.inf)
    # one more than LONGEST_BLIP, because the slope next to wrong samples is wrong as well
    ignored = range(1, LONGEST_BLIP + 2)
    for before, after in [(0, 0), *((n, 0) for n in ignored), *((0, n) for n in ignored)]:
        left, right = k - 1 - before, k + after
        slope = (y[left] - y[left - 1] + y[right + 1] - y[right]) / 2
        jump = y[right] - y[left] - (1 + before + after) * slope
        gap = np.minimum(gap, np.linalg.norm(jump, axis=1))
    return np.r_[np.zeros(GUARD), gap, np.zeros(GUARD)]


def check_seams(found, known, source: str) -> None:
    """Raises ValueError if the seams found in a published file differ from its known seams."""
    if list(found) != list(known):
        raise ValueError(f"{source}: seams were found before rows {[int(k) for k in found]}, but expected before rows "
                         f"{list(known)}. This is not the published file; read it with a recording card (data=custom)")


def _neighbours(k: int, seams: list[int], length: int, window: int) -> np.ndarray:
    start = max([0] + [s + GUARD for s in seams if s <= k] + [k - window])
    stop = min([length] + [s - GUARD for s in seams if s > k] + [k + window + 1])
    rows = np.arange(max(start, 1), stop)
    if k < start or k >= stop:
        return rows[:0]
    return rows[np.abs(rows - k) > GUARD]
