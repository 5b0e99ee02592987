"""Named columns of numbers from CSV, HDF5 and Parquet files; raw, in their own units."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np

from ssmr_torch.extras import require
from ssmr_torch.hdf5_file import open_hdf5
from ssmr_torch.recording_files.csv_reader import read_csv

__all__ = ["open_hdf5", "pick", "read_columns"]

HDF5_SUFFIXES = (".h5", ".hdf5", ".hdf")
PARQUET_SUFFIXES = (".parquet", ".pq")


def read_columns(path: str | Path) -> dict[str, np.ndarray]:
    """Columns by name, (T,) each, from a CSV file with one header row (`csv_reader.read_csv`), the datasets of an HDF5
    file, or the columns of numbers of a Parquet file.

    An HDF5 dataset "y" of shape (T, p) gives the columns y_0 … y_{p-1}. Empty cells become NaN.
    Raises FileNotFoundError, or ValueError when the file is empty, ragged or holds text where numbers belong.
    ModuleNotFoundError for a Parquet file without the extra parquet.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"no file {path}; check the folder and the name")
    if path.stat().st_size == 0:
        raise ValueError(f"{path.name} is empty; expected a header and rows of numbers")
    if path.suffix.lower() in HDF5_SUFFIXES:
        return _read_hdf5(path)
    return _read_parquet(path) if path.suffix.lower() in PARQUET_SUFFIXES else read_csv(path)


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


def _read_parquet(path: Path) -> dict[str, np.ndarray]:
    import pandas

    require("pyarrow")
    try:
        frame = pandas.read_parquet(path)
    except (OSError, ValueError) as error:
        raise ValueError(f"{path.name} cannot be read ({error}); copy or record it again, or name a CSV file "
                         ".csv") from error
    numbers = frame.select_dtypes(["number", "bool"])
    if numbers.empty:
        raise ValueError(f"{path.name} holds no rows of numbers; its columns are {list(frame.columns)}")
    return {str(name): column.to_numpy(dtype=np.float64, na_value=np.nan) for name, column in numbers.items()}
