"""A slow camera in a fast log: positions that change at every second, fifth, … row only."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline

from ssmr_torch.recording_faults.continuity import smallest_step
from ssmr_torch.recording_faults.recording import Recording

SHARE = 0.8         # of the changes that must follow a row without change
FEWEST = 10         # changes from which a rate can be told
ROUNDING = 2.5      # smallest steps; smaller changes can be rounding


def slow_cameras(recordings: Sequence[Recording], rule: str) -> list[Recording]:
    """The recordings, with one row for each picture of a slow camera ("thin"), with the rows between filled by a cubic
    spline ("bridge"), or with a note ("keep").

    A column is slow if its changes follow rows without change. Its true rate is that of the changes.
    Raises ValueError with the rates for the rule "refuse".
    """
    found = {each.name: _slow(each) for each in recordings}
    slow = [each for each in recordings if found[each.name] is not None]
    if slow and rule == "refuse":
        rate, _ = found[slow[0].name]
        runs = f", as in {len(slow)} runs" if len(slow) > 1 else ""
        raise ValueError(f"{_said(slow[0], *found[slow[0].name])}{runs}; set faults.slow_camera: bridge to fill the "
                         f"rows between its values, or thin to keep one row for each (or record at {rate:.3g} Hz)")
    return [each if found[each.name] is None else _treated(each, *found[each.name], rule) for each in recordings]


def _said(recording: Recording, rate: float, columns: np.ndarray) -> str:
    names = recording.columns(columns) or "the position"
    logged = 1 / np.median(np.diff(recording.time))
    return (f"{recording.name}: {names} {'change' if ' and ' in names else 'changes'} at {rate:.3g} Hz only, in a log "
            f"of {logged:.3g} Hz")


def _slow(recording: Recording) -> tuple[float, np.ndarray] | None:
    """True rate, Hz, and which columns (p,) are slow; None if none is."""
    y = recording.observation
    if len(y) < 2 * FEWEST or not np.isfinite(y).all():
        return None
    steps, least = np.abs(np.diff(y, axis=0)), smallest_step(y)
    slow, intervals = np.zeros(y.shape[1], dtype=bool), []
    for column in range(y.shape[1]):
        changes = np.flatnonzero(steps[:, column] > ROUNDING * least[column]) + 1
        changes = changes[changes >= 2]
        if len(changes) < FEWEST:
            continue
        slow[column] = np.mean(steps[changes - 2, column] == 0) >= SHARE
        if slow[column]:
            between = np.diff(recording.time[changes])
            intervals.append(np.mean(between[between < 1.7 * np.median(between)]))
    return (1 / float(np.median(intervals)), slow) if slow.any() else None


def _treated(recording: Recording, rate: float, columns: np.ndarray, rule: str) -> Recording:
    said = _said(recording, rate, columns).removeprefix(f"{recording.name}: ")
    if rule == "keep":
        return recording.noted("slow_camera", f"{said}; kept, as faults.slow_camera says", "kept", rate_hz=rate)
    kept = _pictures(recording.time, recording.observation[:, columns], 1 / rate)
    return (_thinned if rule == "thin" else _filled)(recording, said, rate, columns, kept)


def _thinned(recording: Recording, said: str, rate: float, columns: np.ndarray, kept: np.ndarray) -> Recording:
    width = np.diff(np.r_[recording.time, 2 * recording.time[-1] - recording.time[-2]])[:, None]
    mean = np.add.reduceat(recording.input * width, kept) / np.add.reduceat(width, kept)
    thin = replace(recording, time=recording.time[kept], observation=recording.observation[kept], input=mean,
                   rows=recording.rows[kept])
    return thin.noted("slow_camera", f"{said}; {len(kept)} of {len(recording.time)} rows are kept, one for each value, "
                      "with the mean of the inputs between", "cut", rate_hz=rate)


def _filled(recording: Recording, said: str, rate: float, columns: np.ndarray, kept: np.ndarray) -> Recording:
    rows = np.arange(kept[0], kept[-1] + 1)
    y = recording.observation.copy()
    y[np.ix_(rows, columns)] = CubicSpline(recording.time[kept], y[kept][:, columns])(recording.time[rows])
    whole = replace(recording, time=recording.time[rows], observation=y[rows], input=recording.input[rows],
                    rows=recording.rows[rows])
    return whole.noted("slow_camera", f"{said}; the rows between are filled from {len(kept)} values by a cubic spline",
                       "bridged", rate_hz=rate)


def _pictures(time: np.ndarray, y: np.ndarray, interval: float) -> np.ndarray:
    """Rows with a new value; where none comes, at rest, one row for each interval."""
    changes = np.flatnonzero((np.diff(y, axis=0) != 0).any(axis=1)) + 1
    before = int(round((time[changes[0]] - time[0]) / interval))
    due = time[changes[0]] - interval * np.arange(before, 0, -1)
    kept = [*np.clip(np.searchsorted(time, due - 0.25 * interval), 0, None).tolist(), int(changes[0])]
    for row in [*changes[1:], len(time)]:
        end = time[row] if row < len(time) else 2 * time[-1] - time[-2]
        missing = int(np.floor((end - time[kept[-1]]) / interval + 0.3)) - 1
        if missing > 0:
            due = time[kept[-1]] + interval * np.arange(1, missing + 1)
            kept += [int(k) for k in np.searchsorted(time, due - 0.25 * interval) if kept[-1] < k < row]
        if row < len(time) and row > kept[-1]:
            kept.append(int(row))
    return np.unique(kept)
