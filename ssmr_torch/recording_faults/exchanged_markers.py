"""Exchanged markers: rows, or a whole run, in which markers have each other's positions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from typing import NamedTuple

import numpy as np

from ssmr_torch.recording_faults.continuity import AROUND, gaps, limits, pieces
from ssmr_torch.recording_faults.markers import marker_name, markers
from ssmr_torch.recording_faults.recording import Recording
from ssmr_torch.recording_faults.treatment import treated
from ssmr_torch.recording_files.note import rows_said

TRIED = 12          # jumps after the first one that may end an exchange
LIKELIER = 10.0     # times that a whole run must fit the others better when its markers are exchanged
FITS = 4.0          # times the others' own spread that it may have then


class Exchange(NamedTuple):
    """order: (p,), columns in the order that gives every marker its own positions back. markers: the columns of each
    marker that takes part."""

    order: np.ndarray
    markers: tuple[np.ndarray, ...]

    @property
    def columns(self) -> np.ndarray:
        return np.concatenate(self.markers)

    def back(self, y: np.ndarray, rows=slice(None)) -> np.ndarray:
        """The positions with the markers exchanged back in these rows."""
        moved = y.copy()
        moved[rows] = y[rows][:, self.order]
        return moved

    def said(self, names: Sequence[str]) -> str:
        return f"the markers {' and '.join(marker_name(each, names) for each in self.markers)} are exchanged"


def exchanges(columns: int, names: Sequence[str] = ()) -> list[Exchange]:
    """All exchanges of two markers, and of three in a circle."""
    groups = markers(columns, names)
    found = []
    for count in (2, 3):
        for chosen in combinations(groups, count):
            for turn in range(1, count):
                order = np.arange(columns)
                for place, group in enumerate(chosen):
                    order[group] = chosen[(place + turn) % count]
                found.append(Exchange(order, chosen))
    return found


def exchanged_markers(recording: Recording, rule: str, reach: float, usual: np.ndarray) -> Recording:
    """The recording with the rows cut, or exchanged back, in which markers have each other's positions.

    Such rows begin and end with a jump of these markers, and there is none once they are exchanged back. Where an
    exchange has one end only, `usual` (p,), the usual position of the markers, tells which side is wrong, else the
    shorter side is.
    """
    found: dict[int, tuple[Exchange, np.ndarray]] = {}
    possible = exchanges(recording.observation.shape[1], recording.output_names)
    for piece in pieces(recording) if possible else ():
        for which, rows in _exchanged(recording.time[piece], recording.observation[piece], possible, reach, usual):
            bad = found.setdefault(which, (possible[which], np.zeros(len(recording.time), dtype=bool)))[1]
            bad[piece] |= rows
    for exchange, bad in found.values():
        rows = recording.rows[bad]
        if rule == "correct":
            recording = replace(recording, observation=exchange.back(recording.observation, bad)).noted(
                "exchanged_markers", f"{exchange.said(recording.output_names)} in {rows_said(rows)}; exchanged back, "
                "as faults.exchanged_markers says", "corrected", rows)
    if rule == "correct" or not found:
        return recording
    values = np.zeros(recording.observation.shape, dtype=bool)
    for exchange, bad in found.values():
        values[np.ix_(bad, exchange.columns)] = True
    return treated(recording, values, "exchanged_markers", rule,
                   "; ".join(exchange.said(recording.output_names) for exchange, _ in found.values()))


def _exchanged(time, y, possible: list[Exchange], reach: float, usual: np.ndarray) -> list[tuple[int, np.ndarray]]:
    """(number of the exchange, rows (T,)) of each stretch."""
    found = gaps(time, y)
    limit = limits(y, found, reach)
    jumped = np.abs(found) > limit
    jumps = np.flatnonzero(jumped.any(axis=1))
    stretches, place = [], 0
    while place < len(jumps):
        first, match = jumps[place], None
        for which, exchange in enumerate(possible):
            if not all(jumped[first, marker].any() for marker in exchange.markers):
                continue
            ends = [*jumps[place + 1:place + 1 + TRIED], len(y)]
            stop = next((end for end in ends if _continuous(time, y, first, end, exchange, limit)), None)
            if stop is not None and (match is None or stop < match[1]):
                match = (which, stop)
        if match is None:
            place += 1
            continue
        rows = np.zeros(len(y), dtype=bool)
        rows[first:match[1]] = True
        if match[1] == len(y) and _before_is_wrong(y, rows, possible[match[0]], usual):
            rows = ~rows
        stretches.append((match[0], rows))
        place = int(np.searchsorted(jumps, match[1], side="right"))
    return stretches


def _continuous(time, y, first: int, stop: int, exchange: Exchange, limit: np.ndarray) -> bool:
    """Whether the motion of the markers has no jump at either end once the rows between are exchanged back."""
    start, end = max(0, first - 2 * AROUND), min(len(y), stop + 2 * AROUND)
    back = gaps(time[start:end], exchange.back(y[start:end], slice(first - start, stop - start)))
    edges = [edge for edge in (first, stop) if edge < len(y)]
    columns = exchange.columns
    return all((np.abs(back[edge - start, columns]) <= limit[edge, columns]).all() for edge in edges)


def _before_is_wrong(y, after: np.ndarray, exchange: Exchange, usual: np.ndarray) -> bool:
    """Whether, of a run that is exchanged from one row on, rather the rows before are the wrong ones."""
    one, other = np.median(y[~after], axis=0), np.median(y[after], axis=0)
    columns, order = exchange.columns, exchange.order
    apart = np.linalg.norm(usual[columns] - usual[order][columns])
    if apart > 0.1 * np.linalg.norm((one - other)[columns]):
        wrong_after = np.linalg.norm((one - usual)[columns]) + np.linalg.norm((other[order] - usual)[columns])
        wrong_before = np.linalg.norm((one[order] - usual)[columns]) + np.linalg.norm((other - usual)[columns])
        return wrong_before < wrong_after
    return bool(after.sum() > (~after).sum())


def exchanged_runs(recordings: Sequence[Recording], rest: np.ndarray, rule: str) -> list[Recording]:
    """The recordings with the markers of whole runs exchanged back ("correct"), or said ("keep").

    The covariance C of the run's displacements is compared with the mean Σ of those of the other runs, all divided by
    their traces: tr(Σ⁻¹ C) / p is about one. A run counts as exchanged if that is ten times as large as it is after an
    exchange.
    Raises ValueError for the other rules, because all rows of the run are wrong.
    """
    possible = exchanges(len(rest), recordings[0].output_names) if len(recordings) > 2 else []
    if not possible:
        return list(recordings)
    spreads = [_spread(each, each.observation, rest) for each in recordings]
    found = []
    for place, each in enumerate(recordings):
        others = np.mean([spread for number, spread in enumerate(spreads) if number != place], axis=0)
        found.append(_whole(each, rest, np.linalg.inv(others + 1e-5 * np.eye(len(rest))), possible, rule))
    return found


def _spread(recording: Recording, observation: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """(p, p), the covariance of the displacements, divided by its trace."""
    moved = observation - (0.0 if recording.centred else rest)
    return moved.T @ moved / max(float(np.sum(moved ** 2)), 1e-300)


def _whole(recording: Recording, rest, inverse: np.ndarray, possible: list[Exchange], rule: str) -> Recording:
    def unlike(observation: np.ndarray) -> float:
        return float(np.sum(inverse * _spread(recording, observation, rest))) / len(rest)

    given = unlike(recording.observation)
    if given <= LIKELIER:
        return recording
    tried = [(unlike(exchange.back(recording.observation)), exchange) for exchange in possible]
    back, exchange = min(tried, key=lambda each: each[0])
    if given <= LIKELIER * back or back >= FITS:
        return recording
    what = f"{exchange.said(recording.output_names)} in the whole run"
    if rule == "correct":
        return replace(recording, observation=exchange.back(recording.observation)).noted(
            "exchanged_markers", f"{what}; exchanged back, as faults.exchanged_markers says", "corrected")
    if rule == "keep":
        return recording.noted("exchanged_markers", f"{what}; kept, as faults.exchanged_markers says", "kept")
    raise ValueError(f"{recording.name}: {what}; exchange their columns in the file, or set faults.exchanged_markers: "
                     "correct to do so while reading")
