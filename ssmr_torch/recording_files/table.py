"""`Table`: one run as a file holds it, before units, clocks and faults are judged."""

from __future__ import annotations

import difflib
import re
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ssmr_torch.recording_files.cells import number, numbers, why_no_number
from ssmr_torch.recording_files.note import Note
from ssmr_torch.recording_files.units_said import split_unit

SHOWN = 20  # names of columns that a message lists at most


@dataclass(frozen=True, eq=False)
class Table:
    """Columns of one run, in the units of the file.

    run: name of the run within the file; "" where the file holds one run. part: name of this table where several of
    one run have clocks of their own, such as the topics of a rosbag. columns: (T,) each, by name: float64, int64
    (so that stamps in ns stay exact), or object for text such as stamps with a date; an empty cell is NaN.
    units: unit by column, where the file says it (`units_said`). interval: s, sampling interval that the file states;
    None: it does not. format: name of the file's format. notes: what the reader found or left out.
    Raises ValueError when the columns differ in length.
    """

    columns: dict[str, np.ndarray]
    run: str = ""
    units: dict[str, str] = field(default_factory=dict)
    interval: float | None = None
    format: str = "CSV"
    notes: tuple[Note, ...] = ()
    part: str = ""

    def __post_init__(self):
        lengths = {name: len(column) for name, column in self.columns.items()}
        if len(set(lengths.values())) > 1:
            raise ValueError(f"columns of different length, {lengths}; expected one row per sample")

    @property
    def length(self) -> int:
        return len(next(iter(self.columns.values()), ()))

    def find(self, name: str) -> str | None:
        """The column that a name means: the one of this name, else the only one whose bare name it is, such as "x" of
        "x [mm]", "tip_X" of "subject:tip_X" and "t" of "r1/t"; None without one.
        """
        if name in self.columns:
            return name
        for simpler in (_bare, lambda each: _bare(each).removesuffix("_0")):
            found = [column for column in self.columns if simpler(column) == simpler(name)]
            if len(found) == 1:
                return found[0]
        return None

    def numbers(self, names: Sequence[str], file: str) -> np.ndarray:
        """The named columns side by side, (T, n) float64.

        Raises ValueError naming what is missing and what there is, or the cell that is no number.
        """
        found = {name: self.find(name) for name in names}
        missing = [name for name, column in found.items() if column is None]
        if missing:
            raise ValueError(f"{file} has no numeric column {missing}; it has {self._listed(missing)}")
        return np.stack([self._number(column, file) for column in found.values()], axis=1) if names \
            else np.empty((self.length, 0))

    def _number(self, name: str, file: str) -> np.ndarray:
        column = self.columns[name]
        if column.dtype.kind in "fiub":
            return column.astype(np.float64)
        read = numbers(column)
        if read.dtype.kind == "f":
            return read
        row, cell = next((row, cell) for row, cell in enumerate(column) if cell == cell and number(str(cell)) is None)
        raise ValueError(f"{file}: row {row} (from 0), column {name!r} holds {str(cell)!r}; expected a number"
                         f"{why_no_number(str(cell))}")

    def _listed(self, missing: Sequence[str]) -> str:
        """The columns there are, with what is nearest to a missing one."""
        names = [name for name, column in self.columns.items() if column.dtype.kind in "fiub"]
        listed = f"{names[:SHOWN]}".removesuffix("]") + (f", … {len(names)} in all]" if len(names) > SHOWN else "]")
        twice = [name for name in names if name.startswith(f"{missing[0]} (")]
        if len(twice) > 1:
            return f"{listed}: the header names a column twice, so write {twice[0]!r} or {twice[1]!r}"
        words = [name for name in missing if name in self.columns]
        if words:
            return f"{listed}; {words} holds words"
        nearest = difflib.get_close_matches(missing[0], self.columns, n=1, cutoff=0.5)
        return f"{listed}; did you mean {nearest[0]!r}?" if nearest else listed


def _bare(name: str) -> str:
    """A column's name without its unit, and without the run, group or subject before it."""
    return re.split(r"[/:]", split_unit(name)[0])[-1].strip()
