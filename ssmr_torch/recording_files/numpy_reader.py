"""Tables from NumPy's NPZ and NPY files."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ssmr_torch.recording_files.nested_arrays import leaf, tables_of
from ssmr_torch.recording_files.table import Table

ARRAY = "column"     # name of the columns of an NPY file of (T, k) numbers: column_0, …


def read(path: Path) -> list[Table]:
    """The runs in an NPZ file (arrays by name; "r1/t" is t of the run r1) or NPY file (fields, or columns column_0, …).

    Raises ValueError for a damaged file and for arrays of objects, which could run foreign code when they are read.
    """
    try:
        loaded = np.load(path, allow_pickle=False)
        arrays = {name: loaded[name] for name in loaded.files} if hasattr(loaded, "files") else {ARRAY: loaded}
    except Exception as error:  # NumPy raises what it stumbles upon
        remedy = "arrays of objects are not read, so save each column or run as an array of numbers" \
            if "allow_pickle" in str(error) else "copy or record it again"
        raise ValueError(f"{path.name} cannot be read ({str(error)[:100]}); {remedy}") from error
    tree: dict = {}
    for name, values in arrays.items():
        found = leaf(values)
        *groups, last = name.split("/")
        place = tree
        for group in groups:
            place = place.setdefault(group, {})
        if found is not None and isinstance(place, dict):
            place |= {last: found} if name != ARRAY or not isinstance(found, dict) else found
    return tables_of(tree, "NumPy", path.name)
