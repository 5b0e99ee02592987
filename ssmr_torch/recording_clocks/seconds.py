"""The clock of a run: its column of time as seconds, and the rows in the order of time."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ssmr_torch.recording_files.note import Note
from ssmr_torch.recording_files.table import Table


class Clock(NamedTuple):
    """time: (T,) s. rows: (T,) rows of the table, from 0, in the order of time. notes: what was found and done."""

    time: np.ndarray
    rows: np.ndarray
    notes: tuple[Note, ...]


def clock_of(table: Table, name: str, file: str, column: str | None, scale: float, interval: float | None) -> Clock:
    """Time in s of each sample of the run `name`.

    column: name of the column of time, which counts in `scale` s; None: the samples are `interval` s apart.
    Raises ValueError for a clock that cannot be used, with the remedy.
    """
    rows = np.arange(table.length)
    if column is None:
        return Clock(interval * rows, rows, ())
    return Clock(scale * table.numbers([column], file)[:, 0], rows, ())
