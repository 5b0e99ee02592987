"""Rows with empty cells: filled where few, else the run is cut there, or refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ssmr_torch.recording_faults.recording import Recording
from ssmr_torch.recording_faults.treatment import BRIDGED, bridged
from ssmr_torch.recording_files.note import rows_said

SPLIT_FROM = 2      # absent rows that resampling bridges as well, so that "split" cuts only at more of them


def missing_rows(recording: Recording, rule: str) -> Recording:
    """The recording without values that are not finite, by the rule "split" or "bridge"; "refuse" leaves them to the
    checks of the assembly.

    Up to two empty rows are filled like rows that are absent ("bridge": up to five); at more of them the run is cut.
    An empty input is that of the row before, because inputs are held.
    """
    bad = ~np.isfinite(recording.observation)
    lost = ~np.isfinite(recording.time)
    empty = ~np.isfinite(recording.input).all(axis=1)
    rows = np.flatnonzero(bad.any(axis=1) | lost | empty)
    if rule == "refuse" or not len(rows):
        return recording
    if len(rows) == len(lost):
        raise ValueError(f"{recording.name}: no row is finite; check the observation columns")
    most = BRIDGED if rule == "bridge" else SPLIT_FROM
    steady = np.isfinite(recording.time).all() and (np.diff(recording.time) > 0).all()
    filled, left = bridged(recording, bad, most) if steady else (recording, bad.any(axis=1))
    left = left | lost | _long(empty, most)
    held = np.maximum.accumulate(np.where(empty, 0, np.arange(len(empty))))
    filled = replace(filled, input=np.where(empty[:, None] & ~left[:, None], recording.input[held], recording.input))
    cut = int(left.sum())
    doing = f"{cut} rows cut out, {len(rows) - cut} filled" if 0 < cut < len(rows) else "cut out" if cut else "filled"
    noted = filled.noted("missing_rows", f"empty cells in {rows_said(recording.rows[rows])}; {doing} (missing: "
                         f"{rule})", "cut" if cut else "bridged", recording.rows[rows])
    return noted.without(left) if cut else noted


def _long(empty: np.ndarray, most: int) -> np.ndarray:
    """Rows in stretches of more than `most`, and the first rows, before which no input is known."""
    edges = np.flatnonzero(np.diff(np.r_[False, empty, False].astype(int)))
    found = np.zeros(len(empty), dtype=bool)
    for first, stop in zip(edges[::2], edges[1::2]):
        found[first:stop] = stop - first > most or first == 0
    return found
