"""Where a recording is not one run: jumps that no dynamics explains, and holes in time."""

from __future__ import annotations

import numpy as np

GUARD = 6           # samples around a jump that are touched by it
LONGEST_BLIP = 3    # samples that a camera may see wrongly before it returns to the robot


def find_seams(observation: np.ndarray, speed_ratio: float = 5.0, gap_ratio: float = 20.0,
               extent_ratio: float = 0.1, window: int = 50) -> np.ndarray:
    """Rows at which another run begins although the recording goes on.

    A massive body moves on with its velocity, so the two straight lines through the samples on either side of
    the boundary between rows k-1 and k must meet:

        gap_k = ‖ y_k - y_{k-1} - (d_{k-1} + d_{k+1}) / 2 ‖,   d_j = y_j - y_{j-1}.

    Row k is a seam when gap_k exceeds `speed_ratio` times the largest step and `gap_ratio` times the largest
    other gap of the `window` samples on either side and `extent_ratio` times the diagonal of the workspace,
    and remains when up to three samples next to it are ignored (a wrong sample of a camera jumps, too, but
    returns; so does the slip of a lost marker, which is small). The largest seam is found first; windows end
    at seams.

    Not found: smaller jumps, seams within six samples of the ends or of each other, and those where the
    position is continuous and only the velocity jumps, since a step of the input and stick-slip look the
    same. Declare those.

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
    """gap_k of `find_seams`, the smallest over which samples next to the boundary are ignored; (T,).

    The first and last six entries are zero.
    """
    y = observation
    k = np.arange(GUARD, len(y) - GUARD)
    gap = np.full(len(k), np.inf)
    # One more than the blip: the slope next to it is wrong as well.
    ignored = range(1, LONGEST_BLIP + 2)
    for before, after in [(0, 0), *((n, 0) for n in ignored), *((0, n) for n in ignored)]:
        left, right = k - 1 - before, k + after
        slope = (y[left] - y[left - 1] + y[right + 1] - y[right]) / 2
        jump = y[right] - y[left] - (1 + before + after) * slope
        gap = np.minimum(gap, np.linalg.norm(jump, axis=1))
    return np.r_[np.zeros(GUARD), gap, np.zeros(GUARD)]


def find_time_gaps(time: np.ndarray, longest: float = 3.0) -> np.ndarray:
    """Rows before which more than `longest` median sampling intervals passed: samples were lost there."""
    steps = np.diff(time)
    return np.flatnonzero(steps > longest * np.median(steps)) + 1


def count_blips(observation: np.ndarray, ratio: float = 5.0) -> int:
    """Single samples that jump away by more than `ratio` times the local step and come back (camera
    errors)."""
    y = np.asarray(observation, dtype=np.float64)
    if len(y) < 5:
        return 0
    away = np.linalg.norm(y[2:-2] - (y[1:-3] + y[3:-1]) / 2, axis=1)
    around = np.maximum.reduce([np.linalg.norm(late - early, axis=1) for early, late in (
        (y[:-4], y[1:-3]), (y[1:-3], y[3:-1]), (y[3:-1], y[4:]))])
    floor = 5e-3 * np.linalg.norm(np.ptp(y, axis=0))
    return int(np.sum(away > np.maximum(ratio * around, floor)))


def count_frozen(observation: np.ndarray, window: int = 5) -> int:
    """Samples that repeat a measured value exactly while the robot moves on (the camera lost the marker).

    Rounded values repeat as well, at rest and where they turn. So over the `window` samples before and after,
    the value must move the same way, each time by more than two of its smallest steps and half its median step
    a sample.
    """
    rows = np.arange(len(observation))
    frozen = np.zeros(len(rows), dtype=bool)
    for y in np.transpose(observation):
        steps = np.abs(np.diff(y))
        changes = np.flatnonzero(steps) + 1
        if not len(changes):
            continue
        slowest = max(2 * steps[steps > 0].min(), np.median(steps) / 2)
        first, last = np.r_[0, changes], np.r_[changes - 1, rows[-1]]
        before = y[first] - y[np.maximum(first - window, 0)]
        after = y[np.minimum(last + window, rows[-1])] - y[last]
        moving = (before * after > 0) & (np.minimum(np.abs(before), np.abs(after)) > window * slowest)
        frozen |= np.repeat(moving, last - first + 1) & np.r_[False, steps == 0]
    return int(frozen.sum())


def check_seams(found, known, source: str) -> None:
    """Raises ValueError when the seams found in a well-known file are not where they are known to be."""
    if list(found) != list(known):
        raise ValueError(f"{source}: seams found before rows {[int(k) for k in found]}, expected before rows "
                         f"{list(known)}; this is not the published file, read it with a card (data=custom)")


def _neighbours(k: int, seams: list[int], length: int, window: int) -> np.ndarray:
    start = max([0] + [s + GUARD for s in seams if s <= k] + [k - window])
    stop = min([length] + [s - GUARD for s in seams if s > k] + [k + window + 1])
    rows = np.arange(max(start, 1), stop)
    if k < start or k >= stop:
        return rows[:0]
    return rows[np.abs(rows - k) > GUARD]
