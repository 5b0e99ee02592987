"""Reads MATLAB files in the layouts of SSMLearn and of soft-robot Koopman control; values keep the units of the file.
"""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np

from ssmr_torch.hdf5_file import open_hdf5
from ssmr_torch.recording_files.matlab_5 import load_matlab_5

CELL_NAMES = ("oData", "xData")


def read_ssmlearn_cells(path: str | Path,
                        names: tuple[str, ...] = CELL_NAMES) -> list[tuple[np.ndarray, np.ndarray]]:
    """Trajectories in a cell array of rows {time, observation, …}, the array or its cells transposed or not.

    It reads MATLAB 5 and 7.3 files. It takes the first variable of `names` that exists, and ignores further columns.
    Returns (time (T,), observation (T, p)) for each trajectory.
    Raises FileNotFoundError, or ValueError for a file of another kind or layout.
    """
    path = _existing(path)
    with _Variables(path) as variables:
        name = next((n for n in names if n in variables.names), None)
        if name is None:
            raise ValueError(f"{path.name} contains {sorted(variables.names)}; expected a cell array named "
                             f"{' or '.join(names)}")
        cells = variables.cells(name)
    if cells.ndim != 2 or min(cells.shape) < 1 or max(cells.shape) < 2:
        raise ValueError(f"{path.name}: {name} is a cell array {cells.shape}; expected rows "
                         "{time, observation}")
    fitting = [table for table in (cells, cells.T)
               if table.shape[1] >= 2 and all(_is_vector(row[0]) and _fits(row) for row in table)]
    # Two scalar trajectories fit both orientations, but only time always increases.
    fitting.sort(key=lambda table: sum(np.any(np.diff(np.ravel(row[0])) <= 0) for row in table))
    if fitting:
        return [_oriented(row[0], row[1]) for row in fitting[0]]
    shapes = [np.shape(cell) for cell in cells.flat[:4]]
    raise ValueError(f"{path.name}: {name} {cells.shape} contains arrays {shapes}…; "
                     "expected rows {time 1×T, observation p×T}")


def read_koopman_struct(path: str | Path) -> dict[str, np.ndarray]:
    """The fields t (T,), y (T, p), u (T, m) of a run, and the other numeric fields unchanged.

    The fields are at the top level or in one struct; y and u may be p×T or T×p. It reads MATLAB 5 and 7.3 files.
    Raises FileNotFoundError, or ValueError if a field is missing, not numeric, or has another length than t.
    """
    path = _existing(path)
    with _Variables(path) as variables:
        fields = variables.fields(("t", "y", "u"))
    missing = [name for name in ("t", "y", "u") if name not in fields]
    if missing:
        raise ValueError(f"{path.name} contains the fields {sorted(fields)}; {missing} missing, expected t, y "
                         "and u")
    time = fields["t"]
    if not _is_vector(time):
        raise ValueError(f"{path.name}: t has shape {time.shape}; expected one row or column of times")
    for name in ("y", "u"):
        if time.size not in fields[name].shape or fields[name].ndim != 2:
            raise ValueError(f"{path.name}: {name} has shape {fields[name].shape}, but t has {time.size} "
                             "samples; "
                             f"expected {name} with {time.size} rows or columns")
        fields[name] = _oriented(time, fields[name])[1]
    return fields | {"t": time.ravel()}


def read_vector(path: str | Path, name: str) -> np.ndarray:
    """One numeric variable, flattened (n,). Raises FileNotFoundError, or ValueError if it does not exist."""
    path = _existing(path)
    with _Variables(path) as variables:
        fields = variables.fields((name,))
    if name not in fields:
        raise ValueError(f"{path.name} has no numeric variable {name!r}; it has {sorted(fields)}")
    return fields[name].ravel()


class _Variables:
    """The named variables of a MATLAB file in either of the two file formats."""

    def __init__(self, path: Path):
        self.path, self.file, self.content = path, None, {}
        if h5py.is_hdf5(path):
            self.file = open_hdf5(path)
            self.names = {name for name in self.file if not name.startswith("#")}
            return
        self.content = load_matlab_5(path)
        self.names = set(self.content)

    def __enter__(self) -> _Variables:
        return self

    def __exit__(self, *_):
        if self.file is not None:
            self.file.close()

    def cells(self, name: str) -> np.ndarray:
        """The cell array in MATLAB's orientation, as an object array of numeric arrays."""
        if self.file is None:
            value, is_cell = self.content[name], getattr(self.content[name], "dtype", None) == np.dtype(object)
        else:
            value = self.file[name]
            is_cell = isinstance(value, h5py.Dataset) and h5py.check_ref_dtype(value.dtype) is not None
        if not is_cell:
            raise ValueError(f"{self.path.name}: {name} is not a cell array; expected rows "
                             "{time, observation}")
        if self.file is None:
            return value
        # MATLAB stores columns first, so all arrays in its HDF5 files are transposed.
        references = value[()].T
        cells = np.empty(references.shape, dtype=object)
        for index, reference in np.ndenumerate(references):
            cells[index] = self.file[reference][()].T
        return cells

    def fields(self, wanted: tuple[str, ...]) -> dict[str, np.ndarray]:
        """Numeric arrays by name, from the top level or from the first struct that has a wanted field."""
        if self.file is not None:
            structs = [g for n, g in self.file.items() if isinstance(g, h5py.Group) and n[0] != "#"]
            tables = [{n: d[()].T for n, d in g.items()
                       if isinstance(d, h5py.Dataset) and d.dtype.kind in "fiub"}
                      for g in (self.file, *structs)]
        else:
            structs = [v for v in self.content.values()
                       if isinstance(v, np.ndarray) and v.dtype.names and v.size == 1]
            tables = [self.content] + [{n: s[n].item() for n in s.dtype.names} for s in structs]
        table = next((t for t in tables if any(name in t for name in wanted)), tables[0])
        return {name: np.asarray(value, dtype=np.float64) for name, value in table.items()
                if isinstance(value, np.ndarray) and value.dtype.kind in "fiub"}


def _existing(path: str | Path) -> Path:
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"there is no file {path}; give the path of a MATLAB file")
    if path.stat().st_size == 0:
        raise ValueError(f"{path.name} is empty; expected a MATLAB file")
    return path


def _is_vector(array) -> bool:
    array = np.asarray(array)
    return array.dtype.kind in "fiu" and sum(extent > 1 for extent in array.shape) == 1


def _fits(row) -> bool:
    observation = np.asarray(row[1])
    return observation.dtype.kind in "fiu" and observation.ndim == 2 and np.size(row[0]) in observation.shape


def _oriented(time, observation) -> tuple[np.ndarray, np.ndarray]:
    time, observation = np.asarray(time, dtype=np.float64).ravel(), np.asarray(observation, dtype=np.float64)
    # A square array is read in SSMLearn's layout: one column per sample.
    return time, observation.T if observation.shape[1] == len(time) else observation
