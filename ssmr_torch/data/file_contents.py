"""`contents`: what is in files of recordings, before anyone says what it means."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ssmr_torch import data_sheet as sheet
from ssmr_torch.data.column_roles import Roles, roles
from ssmr_torch.data.named_files import found_files, names_of_files
from ssmr_torch.data_sheet import DataSheet
from ssmr_torch.recording_files.reading import read_tables
from ssmr_torch.recording_files.table import Table

PART = " · "         # between the name of a run and that of its table
LISTED = 40          # columns of a table that are listed


@dataclass(frozen=True, eq=False)
class Contents(DataSheet):
    """Files of recordings and what they hold.

    files: as given. tables: by the name of the run, and of the table where a run has several. of_file: file by the same
    names. unreadable: what is wrong with a file that no reader takes.
    """

    files: tuple[Path, ...]
    tables: dict[str, Table]
    of_file: dict[str, Path]
    unreadable: dict[str, str]

    @property
    def runs(self) -> dict[str, list[Table]]:
        """The tables of each run, that with most of the positions first."""
        found: dict[str, list[Table]] = {}
        for label, table in self.tables.items():
            found.setdefault(label.partition(PART)[0], []).append(table)
        return {name: sorted(tables, key=_positions, reverse=True) for name, tables in found.items()}

    def data_sheet(self) -> tuple[str, dict]:
        title = f"{len(self.files)} files, {len(self.runs)} runs"
        entries: dict = {label: _entry(table, self.of_file[label]) for label, table in self.tables.items()}
        return title, entries | {name: f"cannot be read: {why}" for name, why in self.unreadable.items()}


def contents(files: Sequence[str | Path], folder: Path | None = None) -> Contents:
    """What is in these files, or in those that patterns such as "*.csv" match; relative to `folder` (the current one).

    A file that cannot be read is listed with the reason. Raises FileNotFoundError for a name that nothing matches, and
    ValueError when no file can be read.
    """
    folder = Path.cwd() if folder is None else folder
    paths = found_files(folder / "card.yaml", [str(name) for name in files])
    tables, of_file, unreadable = {}, {}, {}
    for path, stem in names_of_files(paths, folder).items():
        try:
            read = read_tables(path)
        except (ValueError, ModuleNotFoundError) as error:
            unreadable[path.name] = str(error)
            continue
        for table in read:
            label = f"{stem}:{table.run}" if table.run else stem
            label += f"{PART}{table.part}" if table.part else ""
            tables[label], of_file[label] = table, path
    if not tables:
        raise ValueError("; ".join(unreadable.values()))
    return Contents(tuple(paths), tables, of_file, unreadable)


def _positions(table: Table) -> int:
    return len(roles(table).observation)


def _entry(table: Table, path: Path) -> dict:
    found = roles(table)
    entries = {"format": f"{table.format}, {path.name}", "samples": f"{table.length}, {_rate(table, found)}"}
    listed = dict(list(table.columns.items())[:LISTED])
    entries["columns"] = {name: _column(column, table.units.get(name)) for name, column in listed.items()}
    if len(table.columns) > LISTED:
        entries["columns"][f"and {len(table.columns) - LISTED} more"] = "…"
    entries |= {f"left out ({note.kind})" if note.done == "dropped" else note.kind: note.said for note in table.notes}
    odd = _odd(table, found)
    return entries | ({"look at": sheet.listed(odd)} if odd else {})


def _rate(table: Table, found: Roles) -> str:
    if found.seconds is None or table.length < 3:
        return f"{sheet.period(table.interval)} as the file says" if table.interval else "no clock was found"
    steps = np.diff(found.seconds[np.isfinite(found.seconds)])
    return (f"{sheet.period(float(f'{np.median(steps):.4g}'))} by the column {found.time!r}, intervals "
            f"{1e3 * steps.min():.4g} to {1e3 * steps.max():.4g} ms")


def _column(column: np.ndarray, unit: str | None) -> str:
    unit = f" {unit}" if unit else ""
    if column.dtype.kind == "O":
        return f"text, {str(column[0])!r} …"
    finite = column[np.isfinite(column)]
    missing = f", {len(column) - len(finite)} cells missing" if len(finite) < len(column) else ""
    if not len(finite):
        return "no numbers"
    if finite.min() == finite.max():
        return f"always {finite[0]:.6g}{unit}{missing}"
    digits = ".6g" if column.dtype.kind == "f" else "d"
    return f"{finite.min():{digits}} … {finite.max():{digits}}{unit}{missing}"


def _odd(table: Table, found: Roles) -> list[str]:
    """What a person should look at before a fit."""
    odd = []
    for name in found.observation:
        column = table.columns[name]
        zeros = int((column == 0).sum())
        if np.nanmin(column) == np.nanmax(column):
            odd.append(f"{name} never moves")
        elif 0 < zeros < len(column) and np.nanmin(np.abs(column[column != 0])) > 0.2 * np.nanmax(np.abs(column)):
            odd.append(f"{name} is exactly 0 in {zeros} rows")
    if found.seconds is not None and (np.diff(found.seconds) <= 0).any():
        odd.append(f"time does not rise in row {int(np.argmax(np.diff(found.seconds) <= 0)) + 1}")
    return odd
