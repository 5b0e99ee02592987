"""Outliers: rows that leave the motion and return to it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ssmr_torch.recording_faults.continuity import FEWEST, WINDOW, gaps, limits, pieces
from ssmr_torch.recording_faults.recording import Recording
from ssmr_torch.recording_faults.treatment import BRIDGED, treated
from ssmr_torch.recording_files.note import rows_said

ALIKE = 0.2         # share by which the jumps into and out of a long stretch may differ
LONGEST = 0.25      # of the rows of a run that such a stretch may have
AWAY = 0.3          # of the deviation, that the gap across a stretch may have
NEAR = 6            # rows between two jumps of one stretch of disorder
DISORDER = 4        # jumps that make one
ISOLATED = 0.5      # of the jumps at both ends of a long stretch, below which all others around must stay
LARGE = 0.1         # of the reach, that these jumps must have
FAST, FAR = 4.0, 0.3    # times the 95 % quantile of the steps, and of the reach, that no robot moves in one row
LASTING, LASTS = 2.0, 0.05  # times the limit of a jump, and of the reach, from which one without return is cut


def outliers(recording: Recording, rule: str, reach: float) -> Recording:
    """The recording with rows bridged or cut that leave the motion and return to it.

    Three kinds are found, from the jumps of `continuity.gaps`: up to five rows across which the motion before and after
    meets; longer stretches with equal jumps at both ends; and disorder, many jumps close together. At a single jump
    without return, of 5 % of the reach or more, the run is cut: another one was joined, or the camera was moved.
    """
    bad, lasting = np.zeros(recording.observation.shape, dtype=bool), {}
    for piece in pieces(recording):
        bad[piece], jumps = _left(recording.time[piece], recording.observation[piece], reach)
        lasting |= {int(recording.rows[piece.start + row]): size for row, size in jumps.items()}
    if lasting and rule != "keep" and recording.seams == "auto":
        recording = _cut(recording, lasting, rule)
    if not bad.any():
        return recording
    farthest = _farthest(recording, bad)
    return treated(recording, bad, "outliers", rule,
                   f"the position leaves the motion around it by up to {1e3 * farthest:.3g} mm")


def _cut(recording: Recording, lasting: dict[int, float], rule: str) -> Recording:
    """The recording cut where it jumps for good."""
    rows, largest = sorted(lasting), 1e3 * max(lasting.values())
    text = f"the position jumps by {largest:.3g} mm before {rows_said(rows)} and does not return"
    if rule == "refuse":
        raise ValueError(f"{recording.name}: {text}; cut the file there, or set faults.outliers: bridge")
    return replace(recording, cuts=tuple(sorted({*recording.cuts, *rows}))).noted(
        "jumps", f"{text}; the run is cut there (seams: {{{recording.name}: []}} keeps it whole)", "cut", rows)


def _left(time: np.ndarray, y: np.ndarray, reach: float) -> tuple[np.ndarray, dict[int, float]]:
    """(T, p), which values left the motion, and the sizes of jumps without return by row."""
    found = gaps(time, y)
    limit = limits(y, found, reach)
    steps = np.abs(np.diff(y, axis=0, prepend=y[:1]))
    fast = steps > np.maximum(FAST * np.quantile(steps, 0.95, axis=0), FAR * reach)
    jumps = np.flatnonzero(((np.abs(found) > limit) | fast).any(axis=1))
    wild = fast.any(axis=1) | (np.abs(found) > np.maximum(limit, np.quantile(steps, 0.98, axis=0))).any(axis=1)
    bad, lasting = np.zeros(y.shape, dtype=bool), {}
    place = 0
    while place < len(jumps):
        first, later = jumps[place], jumps[place + 1:]
        stop = (_short(time, y, found, limit, first, later) or _disorder(wild, first, later)
                or _long(found, limit, reach, first, later))
        if stop is not None:
            columns = (np.abs(found[[first, stop]]) > limit[[first, stop]]).any(axis=0)
            bad[first:stop] |= columns if columns.any() else True
            place = int(np.searchsorted(jumps, stop, side="right"))
            continue
        size = float(np.linalg.norm(found[first]))
        if (np.abs(found[first]) > LASTING * limit[first]).any() and size > LASTS * reach:
            lasting[int(first)] = size
        place += 1
    return bad | _ends(time, y, limit, bad.any(axis=1)), lasting


def _short(time, y, found, limit, first: int, later: np.ndarray) -> int | None:
    """The row at which a motion goes on that was left at `first` for up to `BRIDGED` rows, or None."""
    for stop in later[later <= first + BRIDGED]:
        columns = (np.abs(found[[first, stop]]) > limit[[first, stop]]).any(axis=0)
        across, away = _across(time, y, first, stop, columns)
        if columns.any() and away > across and across <= max(AWAY * away, np.linalg.norm(limit[first, columns])):
            return int(stop)
    return None


def _disorder(wild: np.ndarray, first: int, later: np.ndarray) -> int | None:
    """The end of many jumps close together, or None; they must be larger than the steps of a fast motion."""
    close = first
    for count, jump in enumerate(later, start=2):
        if not wild[close] or jump - close > NEAR:
            break
        close = jump
        if count >= DISORDER and (count == len(later) + 1 or later[count - 1] - jump > NEAR):
            return int(close)
    return None


def _long(found, limit, reach: float, first: int, later: np.ndarray) -> int | None:
    """The end of a longer stretch with equal and opposite jumps at both ends, or None.

    A robot that moves by quick steps has many jumps; therefore none around may be half as large as these two.
    """
    columns, size = np.abs(found[first]) > limit[first], float(np.linalg.norm(found[first]))
    if not columns.any() or size < LARGE * reach:
        return None
    for stop in later[(later > first + BRIDGED) & (later <= first + LONGEST * len(found))]:
        if np.linalg.norm(found[first] + found[stop]) <= ALIKE * np.linalg.norm(found[first, columns]):
            around = np.linalg.norm(found[max(0, first - WINDOW):stop + WINDOW + 1], axis=1)
            own = np.array([first, stop]) - max(0, first - WINDOW)
            beside = np.abs(np.arange(len(around))[:, None] - own).min(axis=1) > 1
            return int(stop) if around[beside].max(initial=0.0) < ISOLATED * size else None
    return None


def _across(time, y, first: int, stop: int, columns: np.ndarray) -> tuple[float, float]:
    """How far the motion before `first` and after `stop` miss each other, and how far the rows between are from it."""
    rows = np.r_[first - 2, first - 1, stop, stop + 1]
    if rows[0] < 0 or rows[-1] >= len(y):
        return np.inf, 0.0
    (ta, tb, tc, td), (a, b, c, d) = time[rows], y[rows][:, columns]
    left, right = (b - a) / (tb - ta), (d - c) / (td - tc)
    miss = c - b - (tc - tb) * (left + right) / 2
    share = (time[first:stop] - tb) / (tc - tb)
    line = b + share[:, None] * (c - b)
    away = np.linalg.norm(y[first:stop][:, columns] - line, axis=1)
    return float(np.linalg.norm(miss)), float(away.min())


def _ends(time: np.ndarray, y: np.ndarray, limit: np.ndarray, known: np.ndarray) -> np.ndarray:
    """(T, p), outliers among the first and last two rows, where only one side is known: they must be farther than any
    ordinary step. known: (T,), bad rows, next to which nothing is judged.
    """
    bad = np.zeros(y.shape, dtype=bool)
    if len(y) < 2 * FEWEST:
        return bad
    largest = np.quantile(np.abs(np.diff(y, axis=0)), 0.98, axis=0)
    for reverse in (False, True):
        t, z = (time[::-1], y[::-1]) if reverse else (time, y)
        if known[-6:].any() if reverse else known[:6].any():
            continue
        for row in (1, 0):
            ahead = np.arange(row + 1, row + 4)
            slope = (z[ahead[0]] - z[ahead[2]]) / (t[ahead[0]] - t[ahead[2]])
            miss = np.abs(z[row] - z[ahead[0]] - slope * (t[row] - t[ahead[0]]))
            off = miss > np.maximum(4 * largest, 2 * limit[3 if not reverse else -4])
            if off.any():
                bad[len(y) - 1 - row if reverse else row] = off
                if row == 1:
                    bad[len(y) - 1 if reverse else 0] = off
                break
    return bad


def _farthest(recording: Recording, bad: np.ndarray) -> float:
    """m, the largest distance of a bad value from the nearest good one of its column."""
    worst = 0.0
    for column in np.flatnonzero(bad.any(axis=0)):
        good, off = np.flatnonzero(~bad[:, column]), np.flatnonzero(bad[:, column])
        near = good[np.clip(np.searchsorted(good, off), 0, len(good) - 1)] if len(good) else off
        y = recording.observation[:, column]
        worst = max(worst, float(np.abs(y[off] - y[near]).max()))
    return worst
