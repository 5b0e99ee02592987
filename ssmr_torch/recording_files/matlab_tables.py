"""Tables from MATLAB files, version 5 and 7.3: variables, structs, struct arrays, cell arrays of runs."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np

from ssmr_torch.hdf5_file import open_hdf5
from ssmr_torch.recording_files.foreign_files import is_hdf5
from ssmr_torch.recording_files.matlab_5 import is_matlab_object, load_matlab_5
from ssmr_torch.recording_files.nested_arrays import Leaf, leaf, tables_of
from ssmr_torch.recording_files.table import Table

FORMAT = "MATLAB"
CELLS = ("t", "y", "u", "x")  # names of the arrays in a row of cells {time, observations, inputs, …}
DEEPEST = 8
OPAQUE = ("table", "timetable", "datetime", "duration", "string", "categorical", "timeseries", "containers.Map",
          "MCOS")
REMEDY = ("holds {} {!r}, which only MATLAB can read; there, write {}: for a timetable or table T "
          "writetable(timetable2table(T), 'run.csv') or writetable(T, 'run.csv'), for others save their numbers as "
          "arrays")


class Opaque:
    """A value that only MATLAB can read."""

    def __init__(self, kind: str):
        self.kind = kind


def read(path: Path) -> list[Table]:
    """The runs in a MATLAB file.

    Variables t, y, u, or fields of a struct, are one run; an array of structs, a cell array of structs, and a cell
    array whose rows are {t, y, …} are runs 1, 2, …; y of p×T or T×p gives y_0 … y_{p-1}.
    Raises ValueError for a file that is damaged, and for tables, timetables and other objects, with the command of
    MATLAB that converts them.
    """
    content = _of_hdf5(path) if is_hdf5(path) else _of_version_5(path)
    tree = {name: child for name, value in content.items() if (child := _node(value)) is not None}
    opaque = {name: value.kind for name, value in content.items() if isinstance(value, Opaque)}
    if opaque and not any(isinstance(each, Leaf | dict | list) for each in tree.values()):
        name, kind = next((name[:40], kind) for name, kind in opaque.items())
        raise ValueError(f"{path.name} {REMEDY.format(f'the {kind}' if kind != 'MCOS' else 'the object', name, 'it')}")
    return tables_of(tree, FORMAT, path.name)


def _node(value, depth: int = 0):
    """A value of MATLAB as a leaf, a group, a list of groups, or None."""
    if isinstance(value, dict):
        found = {name: child for name, each in value.items()
                 if depth < DEEPEST and (child := _node(each, depth + 1)) is not None}
        return found or None
    if isinstance(value, list):
        return _runs(value, depth)
    return None if isinstance(value, Opaque) or not isinstance(value, np.ndarray) else leaf(value)


def _runs(cells: list, depth: int):
    """A list of groups, from structs, rows of cells or arrays; None for cells of text or single numbers."""
    if cells and all(isinstance(each, str) for each in cells):
        return leaf(np.array(cells, dtype=object))
    groups = []
    for each in cells:
        if isinstance(each, list):  # a row of cells
            each = {CELLS[place] if place < len(CELLS) else f"column {place + 1}": part
                    for place, part in enumerate(each)}
        found = _node(each, depth + 1)
        if isinstance(found, Leaf):
            found = {"column": found}
        if isinstance(found, dict):
            groups.append(found)
    return groups or None


def _of_version_5(path: Path) -> dict:
    return {"object" if name == "None" else name: _simple(value) for name, value in load_matlab_5(path).items()}


def _simple(value):
    """Structs as dicts, struct arrays and cells as lists, everything else as it is."""
    if is_matlab_object(value):
        kinds = [str(each) for each in np.ravel(value.view(np.ndarray))[0]] if value.size and value.dtype.names else []
        return Opaque(next((kind for kind in kinds if kind in OPAQUE), "MCOS"))
    if not isinstance(value, np.ndarray):
        return value
    if value.dtype.names:
        structs = [{name: _simple(each[name]) for name in value.dtype.names} for each in value.flat]
        return structs[0] if len(structs) == 1 else structs
    if value.dtype == object:
        cells = np.empty(value.shape, dtype=object)
        for place, each in np.ndenumerate(value):
            cells[place] = _simple(each)
        return _rows_of_cells(cells)
    if value.dtype.kind == "U" and value.size == 1:
        return str(value.item())
    return value.squeeze() if value.ndim > 1 else value


def _rows_of_cells(cells: np.ndarray) -> list:
    """Cells as a list; of a table of cells, the rows that hold the parts of a run."""
    if cells.ndim == 2 and min(cells.shape) > 1:
        lengths = [[_rows(each) for each in line] for line in cells]
        if all(len({n for n in line if n}) <= 1 for line in zip(*lengths)) and not all(
                len({n for n in line if n}) <= 1 for line in lengths):
            cells = cells.T  # each column is a run
        return [list(line) for line in cells]
    flat = list(cells.flat)
    if 2 <= len(flat) <= len(CELLS) and all(isinstance(each, np.ndarray) for each in flat) and flat[0].ndim == 1 \
            and all(flat[0].size in each.shape for each in flat) and flat[1].ndim == 2:
        return [flat]        # one run, {t, y, …}
    return flat


def _rows(value) -> int:
    return max(np.shape(value), default=0)


def _of_hdf5(path: Path) -> dict:
    with open_hdf5(path) as file:
        try:
            return {name: _value(file[name], file) for name in file if not name.startswith("#")
                    and isinstance(file.get(name, getlink=True), h5py.HardLink)}
        except (OSError, RuntimeError, KeyError) as error:
            raise ValueError(f"{path.name} cannot be read ({error}); save it again") from error


def _value(item, file: h5py.File, depth: int = 0):
    """A value of a MATLAB 7.3 file as `_simple` gives it; MATLAB stores columns first, so arrays are transposed."""
    kind = item.attrs.get("MATLAB_class", b"")
    kind = kind.decode() if isinstance(kind, bytes) else str(kind)
    if depth > DEEPEST or kind in OPAQUE or "MATLAB_object_decode" in item.attrs:
        return Opaque(kind if kind in OPAQUE else "MCOS")
    if isinstance(item, h5py.Group):
        fields = {name: item[name] for name in item}
        arrays = {name: each for name, each in fields.items() if isinstance(each, h5py.Dataset)
                  and h5py.check_ref_dtype(each.dtype) is not None and "MATLAB_class" not in each.attrs}
        if arrays:  # an array of structs holds a reference for each element in every field
            columns = {name: [_value(file[ref], file, depth + 1) for ref in np.ravel(each[()].T)]
                       for name, each in arrays.items()}
            return [dict(zip(columns, values)) for values in zip(*columns.values())]
        return {name: _value(each, file, depth + 1) for name, each in fields.items()}
    if item.attrs.get("MATLAB_empty", 0):
        return np.empty(0)
    if h5py.check_ref_dtype(item.dtype) is not None:
        references = item[()].T
        cells = np.empty(references.shape, dtype=object)
        for place, reference in np.ndenumerate(references):
            cells[place] = _value(file[reference], file, depth + 1)
        return _rows_of_cells(cells)
    values = item[()]
    if kind == "char":
        return "".join(map(chr, np.ravel(values)))
    return np.asarray(values).T.squeeze()
