"""Exchanged markers: rows, or a whole run, in which two markers have each other's positions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from ssmr_torch.recording_faults.continuity import AROUND, gaps, limits, pieces
from ssmr_torch.recording_faults.markers import marker_name, markers
from ssmr_torch.recording_faults.recording import Recording
from ssmr_torch.recording_faults.treatment import treated

TRIED = 12          # jumps after the first one that may end an exchange
LIKELIER = 10.0     # times that a whole run must fit the others better when its markers are exchanged
FITS = 4.0          # times the others' own spread that it may have then


def exchanged_markers(recording: Recording, rule: str, reach: float, usual: np.ndarray) -> Recording:
    """The recording with the rows cut, or exchanged back, in which two markers have each other's positions.

    Such rows begin and end with a jump of both markers, and there is none once they are exchanged back. Where an
    exchange has one end only, `usual` (p,), the usual position of the markers, tells which side is wrong, else the
    shorter side is.
    """
    groups = markers(recording.observation.shape[1], recording.output_names)
    for i, j in combinations(groups, 2):
        if len(i) != len(j):
            continue
        bad = np.zeros(len(recording.time), dtype=bool)
        for piece in pieces(recording):
            bad[piece] = _exchanged(recording.time[piece], recording.observation[piece], i, j, reach, usual)
        if bad.any():
            recording = _treated(recording, bad, i, j, rule)
    return recording


def _treated(recording: Recording, bad: np.ndarray, i, j, rule: str) -> Recording:
    what = (f"the markers {marker_name(i, recording.output_names)} and {marker_name(j, recording.output_names)} are "
            "exchanged")
    if rule != "correct":
        values = np.zeros(recording.observation.shape, dtype=bool)
        values[np.ix_(bad, np.r_[i, j])] = True
        return treated(recording, values, "exchanged_markers", rule, what)
    from ssmr_torch.recording_files.note import rows_said

    rows = recording.rows[np.flatnonzero(bad)]
    return replace(recording, observation=_swapped(recording.observation, bad, i, j)).noted(
        "exchanged_markers", f"{what} in {rows_said(rows)}; exchanged back, as faults.exchanged_markers says",
        "corrected", rows)


def _swapped(y: np.ndarray, rows, i: np.ndarray, j: np.ndarray) -> np.ndarray:
    back = y.copy()
    back[np.ix_(rows, i)], back[np.ix_(rows, j)] = y[np.ix_(rows, j)], y[np.ix_(rows, i)]
    return back


def _exchanged(time, y, i, j, reach: float, usual: np.ndarray) -> np.ndarray:
    """(T,), rows in which the markers i and j are exchanged."""
    found = gaps(time, y)
    limit = limits(y, found, reach)
    jumped = np.abs(found) > limit
    jumps = np.flatnonzero(jumped[:, i].any(axis=1) & jumped[:, j].any(axis=1))
    bad = np.zeros(len(y), dtype=bool)
    place = 0
    while place < len(jumps):
        first = jumps[place]
        ends = [*jumps[place + 1:place + 1 + TRIED], len(y)]
        stop = next((end for end in ends if _continuous(time, y, first, end, i, j, limit)), None)
        if stop is None:
            place += 1
            continue
        bad[first:stop] = True
        place = int(np.searchsorted(jumps, stop, side="right"))
    if bad[-1] and _first_side(y, bad, i, j, usual):
        return ~bad
    return bad


def _continuous(time, y, first: int, stop: int, i, j, limit: np.ndarray) -> bool:
    """Whether the motion of both markers has no jump at either end once the rows between are exchanged back."""
    columns = np.r_[i, j]
    start, end = max(0, first - 2 * AROUND), min(len(y), stop + 2 * AROUND)
    rows = np.zeros(end - start, dtype=bool)
    rows[first - start:stop - start] = True
    back = gaps(time[start:end], _swapped(y[start:end], rows, i, j))
    edges = [edge for edge in (first, stop) if edge < len(y)]
    return all((np.abs(back[edge - start, columns]) <= limit[edge, columns]).all() for edge in edges)


def _first_side(y, bad: np.ndarray, i, j, usual: np.ndarray) -> bool:
    """Whether, of a run that is exchanged from one row on, rather the rows before are the wrong ones."""
    before, after = np.median(y[~bad], axis=0), np.median(y[bad], axis=0)
    columns, other = np.r_[i, j], np.r_[j, i]
    apart = np.linalg.norm(usual[i] - usual[j])
    if apart > 0.1 * np.linalg.norm(before[columns] - after[columns]):
        wrong = np.linalg.norm(before[columns] - usual[columns]) + np.linalg.norm(after[other] - usual[columns])
        right = np.linalg.norm(before[other] - usual[columns]) + np.linalg.norm(after[columns] - usual[columns])
        return right < wrong
    return bool(bad.sum() > (~bad).sum())


def exchanged_runs(recordings: Sequence[Recording], rest: np.ndarray, rule: str) -> list[Recording]:
    """The recordings with the markers of whole runs exchanged back ("correct"), or said ("keep").

    The covariance C of the run's displacements is compared with the mean Σ of those of the other runs, all divided by
    their traces: tr(Σ⁻¹ C) / p is about one. A run counts as exchanged if that is ten times as large as it is after an
    exchange.
    Raises ValueError for the other rules, because all rows of the run are wrong.
    """
    if len(recordings) < 3:
        return list(recordings)
    groups = markers(recordings[0].observation.shape[1], recordings[0].output_names)
    pairs = [pair for pair in combinations(groups, 2) if len(pair[0]) == len(pair[1])]
    spreads = [_spread(each, each.observation, rest) for each in recordings] if pairs else []
    return [_whole(recording, rest, spreads, place, pairs, rule) for place, recording in enumerate(recordings)]


def _spread(recording: Recording, observation: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """(p, p), the covariance of the displacements, divided by its trace."""
    moved = observation - (0.0 if recording.centred else rest)
    return moved.T @ moved / max(float(np.sum(moved ** 2)), 1e-300)


def _whole(recording: Recording, rest: np.ndarray, spreads: list[np.ndarray], place: int, pairs, rule: str) -> Recording:
    if not pairs:
        return recording
    size = len(rest)
    inverse = np.linalg.inv(np.mean([each for number, each in enumerate(spreads) if number != place], axis=0)
                            + 1e-5 * np.eye(size))
    given = float(np.sum(inverse * spreads[place])) / size
    if given <= LIKELIER:
        return recording
    rows = np.ones(len(recording.time), dtype=bool)
    for i, j in pairs:
        exchanged = _swapped(recording.observation, rows, i, j)
        back = float(np.sum(inverse * _spread(recording, exchanged, rest))) / size
        if given > LIKELIER * back and back < FITS:
            return _exchanged_back(recording, exchanged, " and ".join(
                marker_name(group, recording.output_names) for group in (i, j)), rule)
    return recording


def _exchanged_back(recording: Recording, exchanged: np.ndarray, names: str, rule: str) -> Recording:
    what = f"the markers {names} are exchanged in the whole run"
    if rule == "correct":
        return replace(recording, observation=exchanged).noted(
            "exchanged_markers", f"{what}; exchanged back, as faults.exchanged_markers says", "corrected")
    if rule == "keep":
        return recording.noted("exchanged_markers", f"{what}; kept, as faults.exchanged_markers says", "kept")
    raise ValueError(f"{recording.name}: {what}; exchange their columns in the file, or set faults.exchanged_markers: "
                     "correct to do so while reading")
