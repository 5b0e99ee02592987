"""Frame numbers as a clock, and columns that count frames although the card does not say so."""

from __future__ import annotations

import numpy as np

from ssmr_torch.recording_clocks.time_units import counts_frames
from ssmr_torch.recording_files.note import Note, rows_said
from ssmr_torch.recording_files.table import Table

SUB_FRAME = "Sub Frame"  # the column with which motion capture counts samples within a frame
NAMES = ("frame", "sample", "index", "idx", "count", "seq", "#", "nr")


def frames(table: Table, column: str, file: str) -> np.ndarray:
    """(T,) frame numbers, whole ones plus the share of the sub-frame; NaN where a cell is empty.

    Raises ValueError for numbers that are not whole.
    """
    numbers = table.numbers([column], file)[:, 0]
    broken = np.flatnonzero(np.isfinite(numbers) & (np.mod(numbers, 1) != 0))
    if len(broken):
        raise ValueError(f"{file}: column {column!r} holds {numbers[broken[0]]:g} in row {broken[0]} (from 0); frame "
                         "numbers are whole, times belong under columns.time")
    if SUB_FRAME in table.columns and column != SUB_FRAME:
        within = table.numbers([SUB_FRAME], file)[:, 0]
        if np.nanmax(within, initial=0) > np.nanmin(within, initial=0):
            numbers = numbers + (within - within.min()) / (within.max() - within.min() + 1)
    return numbers


def uncounted(table: Table, name: str, used: tuple[str, ...]) -> list[Note]:
    """A note where a column that nobody reads counts frames of which some are absent, in a run without a clock."""
    for column, values in table.columns.items():
        if column in used or values.dtype.kind not in "iuf" or not np.isfinite(values.astype(np.float64)).all():
            continue
        steps = np.diff(values.astype(np.float64))
        lost = np.flatnonzero(steps > 1) + 1
        if len(lost) and len(steps) > 3 and (steps >= 1).all() and counts_frames(values):
            return [Note(name, "absent frames", f"column {column!r} counts frames, of which "
                         f"{int((steps[lost - 1] - 1).sum())} are absent, before {rows_said(lost)}; read it as "
                         f"columns.frame: {column} with a rate, in place of sampling_time", "kept", tuple(lost))]
    return []


def suspected(name: str, column: str, stamps: np.ndarray, unit: str) -> list[Note]:
    """A note where stamps in ms or less count 0, 1, 2, … as frames do, or a column called frame has whole steps."""
    steps = np.diff(stamps[np.isfinite(stamps)].astype(np.float64))
    named = any(column.lower().startswith(each) for each in NAMES)
    if not len(steps) or np.mod(steps, 1).any():
        return []
    if not (counts_frames(stamps) and stamps[0] in (0, 1)) and not named:
        return []
    return [Note(name, "frame numbers", f"{column} holds whole numbers in steps of {np.median(steps):g}, read in "
                 f"{unit}: frames? Then give columns.frame: {column} and their rate in Hz, as rate: 100", "kept")]
