"""`Table`: one run as a file holds it, before units, clocks and faults are judged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ssmr_torch.recording_files.note import Note


@dataclass(frozen=True, eq=False)
class Table:
    """Columns of one run, in the units of the file.

    run: name of the run within the file; "" where the file holds one run. columns: (T,) each, by name: float64, int64
    (so that stamps in ns stay exact), or object for text such as stamps with a date; an empty cell is NaN.
    units: unit by column, where the file says it. interval: s, sampling interval that the file states; None: it does
    not. format: name of the file's format. notes: what the reader found or left out.
    Raises ValueError when the columns differ in length.
    """

    columns: dict[str, np.ndarray]
    run: str = ""
    units: dict[str, str] = field(default_factory=dict)
    interval: float | None = None
    format: str = "CSV"
    notes: tuple[Note, ...] = ()

    def __post_init__(self):
        lengths = {name: len(column) for name, column in self.columns.items()}
        if len(set(lengths.values())) > 1:
            raise ValueError(f"columns of different length, {lengths}; expected one row per sample")

    @property
    def length(self) -> int:
        return len(next(iter(self.columns.values()), ()))

    def numbers(self, names: Sequence[str], file: str) -> np.ndarray:
        """The named columns side by side, (T, n) float64. Raises ValueError naming what is missing and what there is.
        """
        numeric = [name for name, column in self.columns.items() if column.dtype.kind in "fiub"]
        missing = [name for name in names if name not in numeric]
        if missing:
            raise ValueError(f"{file} has no numeric column {missing}; it has {numeric}")
        return np.stack([self.columns[name].astype(np.float64) for name in names], axis=1) if names \
            else np.empty((self.length, 0))
