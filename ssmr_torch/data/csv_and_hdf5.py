"""Named columns of numbers from CSV and HDF5 files; raw, in their own units."""

from __future__ import annotations

import csv
from pathlib import Path

import h5py
import numpy as np

HDF5_SUFFIXES = (".h5", ".hdf5", ".hdf")
EMPTY = ("", "nan", "na", "null")


def read_columns(path: str | Path) -> dict[str, np.ndarray]:
    """Columns by name, (T,) each, from a CSV file with one header row or the datasets of an HDF5 file.

    An HDF5 dataset "y" of shape (T, p) gives the columns y_0 … y_{p-1}. Empty cells become NaN.
    Raises FileNotFoundError, or ValueError when the file is empty, ragged or holds text where numbers belong.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"no file {path}; check the folder and the name")
    if path.stat().st_size == 0:
        raise ValueError(f"{path.name} is empty; expected a header and rows of numbers")
    return _read_hdf5(path) if path.suffix.lower() in HDF5_SUFFIXES else _read_csv(path)


def pick(columns: dict[str, np.ndarray], names, path: str | Path) -> np.ndarray:
    """The named columns side by side, (T, n). Raises ValueError naming what is missing and what there is."""
    missing = [name for name in names if name not in columns]
    if missing:
        raise ValueError(f"{Path(path).name} has no numeric column {missing}; it has {list(columns)}")
    lengths = {name: len(columns[name]) for name in names}
    if len(set(lengths.values())) > 1:
        raise ValueError(f"{Path(path).name}: columns of different length, {lengths}; expected one row per "
                         "sample")
    length = len(next(iter(columns.values())))
    return np.stack([columns[name] for name in names], axis=1) if names else np.empty((length, 0))


def open_hdf5(path: Path) -> h5py.File:
    """The file, open for reading. Raises ValueError when it is truncated or damaged."""
    try:
        return h5py.File(path, "r")
    except OSError as error:
        raise ValueError(f"{path.name} cannot be read ({error}); copy or record it again") from error


def _read_csv(path: Path) -> dict[str, np.ndarray]:
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError(f"{path.name} is not a text file ({error.reason}); expected CSV") from error
    lines = text.splitlines()
    header = lines[0] if lines else ""
    rows = csv.reader(lines, delimiter=max(",;\t", key=header.count))
    names = [name.strip() for name in next(rows, [])]
    if not names or any(_is_number(name) for name in names):
        raise ValueError(f"{path.name}: the first row is {header[:60]!r}; expected the names of the columns")
    if len(set(names)) < len(names):
        raise ValueError(f"{path.name}: the header names a column twice, {names}; give each its own name")
    table = [row for row in rows if row]
    if not table:
        raise ValueError(f"{path.name} has a header but no rows; expected one row per sample")
    for index, row in enumerate(table):
        if len(row) != len(names):
            raise ValueError(f"{path.name}: row {index} (from 0) has {len(row)} cells, the header "
                             f"{len(names)}")
    try:
        values = np.array(table, dtype=np.float64)
    except ValueError:
        values = np.array([[_number(cell, path, row, name) for cell, name in zip(cells, names)]
                           for row, cells in enumerate(table)])
    return dict(zip(names, values.T))


def _read_hdf5(path: Path) -> dict[str, np.ndarray]:
    if not h5py.is_hdf5(path):
        raise ValueError(f"{path.name} is not an HDF5 file; copy or record it again, or name a CSV file .csv")
    columns: dict[str, np.ndarray] = {}

    def collect(name, item):
        if not isinstance(item, h5py.Dataset) or item.dtype.kind not in "fiub" or item.ndim not in (1, 2):
            return
        values = item[()].astype(np.float64)
        columns.update({name: values} if values.ndim == 1
                       else {f"{name}_{index}": column for index, column in enumerate(values.T)})

    with open_hdf5(path) as file:
        file.visititems(collect)
    if not columns:
        raise ValueError(f"{path.name} holds no numeric dataset; expected one per column, (T,) or (T, p)")
    return columns


def _number(cell: str, path: Path, row: int, name: str) -> float:
    if cell.strip().lower() in EMPTY:
        return np.nan
    if not _is_number(cell):
        raise ValueError(f"{path.name}: row {row} (from 0), column {name!r} holds {cell!r}; expected a "
                         "number")
    return float(cell)


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True
