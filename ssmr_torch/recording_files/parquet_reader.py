"""Tables from Parquet files."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ssmr_torch.extras import require
from ssmr_torch.recording_files.table import Table
from ssmr_torch.recording_files.units_said import units_in_names

FORMAT = "Parquet"


def read(path: Path) -> list[Table]:
    """The table of a Parquet file; dates become int64 ns.

    Raises ValueError when the file is damaged or holds no rows of numbers; ModuleNotFoundError without the extra
    parquet.
    """
    import pandas

    require("pyarrow")
    try:
        frame = pandas.read_parquet(path)
    except (OSError, ValueError) as error:
        raise ValueError(f"{path.name} cannot be read ({error}); copy or record it again, or name a CSV file "
                         ".csv") from error
    if frame.index.name and frame.index.name not in frame.columns:
        frame = frame.reset_index()
    columns, units = {}, {}
    for label, series in frame.items():
        name = "_".join(map(str, label)) if isinstance(label, tuple) else str(label)
        new, unit = _column(series)
        columns |= {name if new.ndim == 1 else f"{name}_{k}": each for k, each in enumerate(np.atleast_2d(new.T))}
        units |= {name: unit} if unit else {}
    if not any(column.dtype.kind in "fiub" for column in columns.values()) or not len(frame):
        raise ValueError(f"{path.name} holds no rows of numbers; its columns are {list(columns)}")
    return [Table(columns, "", {**units_in_names(columns), **units}, None, FORMAT)]


def _column(series) -> tuple[np.ndarray, str]:
    """A column of a frame (T,), or (T, k) of lists of equal length, and its unit."""
    import pandas

    if pandas.api.types.is_datetime64_any_dtype(series.dtype):
        if series.isna().any():
            return series.astype(str).to_numpy(dtype=object), ""
        return series.dt.as_unit("ns").astype(np.int64).to_numpy(), "ns"
    if pandas.api.types.is_numeric_dtype(series.dtype):
        whole = series.dtype.kind in "iu" and not series.isna().any()
        return series.to_numpy(dtype=np.int64) if whole else series.to_numpy(dtype=np.float64, na_value=np.nan), ""
    values = series.to_numpy(dtype=object)
    lists = len(values) and all(isinstance(value, np.ndarray | list) for value in values)
    if lists and len(set(map(len, values))) == 1:
        try:
            return np.array([np.asarray(value, dtype=np.float64) for value in values]), ""
        except (TypeError, ValueError):
            return values, ""
    return values, ""
