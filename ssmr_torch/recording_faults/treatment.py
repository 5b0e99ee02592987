"""What is done with bad values: bridged where they are few in a row, cut out where they are many, refused, or kept."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline

from ssmr_torch.recording_faults.recording import Recording
from ssmr_torch.recording_files.note import rows_said

BRIDGED = 5         # rows in a row that are filled from the motion around them
AROUND = 6          # rows on either side that the filling is taken from
FEWEST = 2          # of them that must be there on each side
SHOWN = 24          # rows on either side of the first bad one that are kept for the picture


def treated(recording: Recording, bad: np.ndarray, fault: str, rule: str, what: str) -> Recording:
    """The recording with its bad values bridged, cut out or kept by the rule, and one note that says so.

    bad: (T, p), whether a value is bad; rows that were kept before are not said again. what: the
    fault in words, after which the rows and the remedy are said.
    Raises ValueError for the rule "refuse", and when nothing is left of the run.
    """
    known = [row for note in recording.notes if note.done == "kept" for row in note.rows]
    bad = bad & ~np.isin(recording.rows, known)[:, None]
    rows = np.flatnonzero(bad.any(axis=1))
    if not len(rows):
        return recording
    said = f"{what} in {rows_said(recording.rows[rows])}"
    if rule == "refuse":
        raise ValueError(f"{recording.name}: {said}; repair them, or set faults.{fault}: "
                         f"{'bridge' if fault not in ('unwritten_rows', 'exchanged_markers') else 'cut'}")
    picture = _picture(recording, bad, int(rows[0]))
    if rule == "keep":
        return recording.noted(fault, f"{said}; kept, as faults.{fault} says", "kept", recording.rows[rows], **picture)
    filled, open_rows = bridged(recording, bad, BRIDGED) if rule == "bridge" else (recording, bad.any(axis=1))
    long = np.flatnonzero(open_rows)
    if not len(long):
        done, doing = "bridged", "filled from the motion around"
    elif len(long) == len(rows):
        done, doing = "cut", "cut out"
    else:
        done, doing = "cut", f"{len(long)} rows cut out, {len(rows) - len(long)} filled from the motion around"
    noted = filled.noted(fault, f"{said}; {doing} (faults.{fault}: keep leaves them)", done, recording.rows[rows],
                         **picture)
    return noted.without(open_rows) if len(long) else noted


def bridged(recording: Recording, bad: np.ndarray, most: int) -> tuple[Recording, np.ndarray]:
    """The recording with bad values filled where at most `most` rows in a row are bad, and (T,) which rows stay bad.

    Each column is filled by a cubic spline through up to `AROUND` good rows on either side; at the ends nothing is.
    """
    y, left = recording.observation.copy(), np.zeros(len(bad), dtype=bool)
    for column in range(bad.shape[1]):
        good = np.flatnonzero(~bad[:, column])
        for first, last in _stretches(np.flatnonzero(bad[:, column])):
            before, after = good[good < first][-AROUND:], good[good > last][:AROUND]
            near = np.r_[before[before >= first - 2 * AROUND], after[after <= last + 2 * AROUND]]
            if last - first >= most or (near < first).sum() < FEWEST or (near > last).sum() < FEWEST:
                left[first:last + 1] = True
                continue
            rows = np.arange(first, last + 1)
            y[rows, column] = CubicSpline(recording.time[near], recording.observation[near, column])(
                recording.time[rows])
    return replace(recording, observation=y), left


def _stretches(rows: np.ndarray) -> list[tuple[int, int]]:
    """(first, last) of each stretch of consecutive rows."""
    if not len(rows):
        return []
    breaks = np.flatnonzero(np.diff(rows) > 1)
    return list(zip(rows[np.r_[0, breaks + 1]].tolist(), rows[np.r_[breaks, len(rows) - 1]].tolist()))


def _picture(recording: Recording, bad: np.ndarray, first: int) -> dict:
    """The column of the first bad value, as it was recorded around it."""
    column = int(bad[first].argmax())
    rows = np.arange(max(0, first - SHOWN), min(len(bad), first + SHOWN))
    values = [float(f"{value:.5g}") if np.isfinite(value) else None for value in recording.observation[rows, column]]
    return {"column": column, "first_row": int(recording.rows[rows[0]]), "recorded_m": values}
