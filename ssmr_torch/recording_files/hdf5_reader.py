"""Tables from HDF5 files: datasets, groups of them, compound tables."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np

from ssmr_torch.hdf5_file import open_hdf5
from ssmr_torch.recording_files.nested_arrays import leaf, tables_of
from ssmr_torch.recording_files.table import Table

FORMAT = "HDF5"
DEEPEST = 8          # levels of groups that are read
ABSENT = ("_FillValue", "missing_value")


def read(path: Path) -> list[Table]:
    """The runs in an HDF5 (or NetCDF 4) file, see `nested_arrays.tables_of`.

    The attributes scale_factor, add_offset and _FillValue are applied, as NetCDF defines them; units is read. Links to
    other files are refused (`hdf5_file.open_hdf5`).
    Raises ValueError for a damaged file and for one without an array of numbers.
    """
    with open_hdf5(path) as file:
        try:
            return tables_of(_tree(file), FORMAT, path.name)
        except (OSError, RuntimeError) as error:
            raise ValueError(f"{path.name} cannot be read ({error}); copy or record it again") from error


def _tree(group: h5py.Group, depth: int = 0) -> dict:
    found = {}
    for name in group:
        if not isinstance(group.get(name, getlink=True), h5py.HardLink):
            continue
        item = group[name]
        if isinstance(item, h5py.Group):
            child = _tree(item, depth + 1) if depth < DEEPEST else {}
        else:
            child = _array(item) if isinstance(item, h5py.Dataset) and item.shape and item.size else None
        if child is not None and child != {}:
            found[name] = child
    return found


def _array(dataset: h5py.Dataset):
    if h5py.check_string_dtype(dataset.dtype) is not None:
        return leaf(dataset.asstr(errors="replace")[()])
    if dataset.dtype.kind not in "fiubV" or h5py.check_ref_dtype(dataset.dtype) is not None:
        return None
    return leaf(_scaled(dataset[()], dataset.attrs), _text(dataset.attrs.get("units", dataset.attrs.get("unit", ""))))


def _scaled(values: np.ndarray, attributes) -> np.ndarray:
    """scale_factor · values + add_offset, NaN where the file says that a value is absent."""
    absent = [attributes[name] for name in ABSENT if name in attributes]
    scale, offset = (float(np.ravel(attributes.get(name, value))[0])
                     for name, value in (("scale_factor", 1.0), ("add_offset", 0.0)))
    if values.dtype.names or (not absent and scale == 1.0 and offset == 0.0):
        return values
    scaled = scale * values.astype(np.float64) + offset
    for value in absent:
        scaled[values == np.ravel(value)[0]] = np.nan
    return scaled


def _text(said: object) -> str:
    said = np.ravel(said)[0] if np.ndim(said) else said
    return said.decode("utf-8", "replace") if isinstance(said, bytes) else str(said)
