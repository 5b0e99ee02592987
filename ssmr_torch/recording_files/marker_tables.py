"""Tables of motion capture: rows of numbers below a header of a system's own."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ssmr_torch.recording_files.table import Table
from ssmr_torch.recording_files.text_columns import Lines, columns_of

TIME = "Time"  # name of the column in s that a reader makes where the file states only a rate


class Axis(NamedTuple):
    """name: of the column. quantity: "" for a position, else what it is."""

    name: str
    quantity: str = ""


def marker_table(lines: list[str], names: list[str], units: dict[str, str], delimiter: str, file: str, format: str,
                 rate: float | None, open_end: bool = False, run: str = "", part: str = "") -> Table:
    """The table of these lines; rate: Hz. Decimal commas are read where commas do not delimit.

    Raises ValueError for rows of another length than the names.
    """
    decimal = "," if delimiter != "," and any("," in line for line in lines) else "."
    columns, notes = columns_of(Lines(names, lines, delimiter, decimal, open_end), file)
    units = {name: unit for name, unit in units.items() if name in columns}
    return Table(columns, run, units, 1 / rate if rate else None, format, tuple(notes), part)


def with_time(columns: dict[str, np.ndarray], units: dict[str, str], seconds: np.ndarray) -> dict[str, np.ndarray]:
    """The columns and a column of time (T,) s, which is entered in the units."""
    units[TIME] = "s"
    return {TIME: seconds, **columns}


def without_subject(names: list[str]) -> list[str]:
    """Names of markers without the subject before them, where they stay different: "tip" of "arm:tip"."""
    short = [name.rpartition(":")[2] for name in names]
    return short if len(set(short)) == len(set(names)) else names
