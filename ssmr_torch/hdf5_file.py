"""Opening HDF5 files of others: nothing outside the file is read, and no dataset is larger than its file can explain.

A link in an HDF5 file may lead to another file, and a dataset of a kilobyte on disk may claim a terabyte in memory.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import h5py
import numpy as np

from ssmr_torch.checksum import Damaged
from ssmr_torch.result_files import written_aside

# A dataset that zlib compressed as far as it can takes a thousandth; recordings stay far below this.
COMPRESSION = 200
FREE = 64 * 2 ** 20  # bytes in memory that any file may fill
IN_MEMORY = 2 ** 28  # bytes
DEEPEST = 32  # groups within groups


def open_hdf5(path: str | Path) -> h5py.File:
    """The file, open for reading, after every link and dataset in it was checked.

    Raises FileNotFoundError, `checksum.Damaged`, which is a ValueError, for a file that is truncated or damaged, and
    ValueError, with the name of the link or dataset, for external and user-defined links, external storage and virtual
    datasets, for a group that contains itself, and for a dataset of more than `COMPRESSION` times the file's size
    (`FREE` bytes are always allowed).
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"no file {path}; check the folder and the name")
    try:
        file = h5py.File(path, "r")
    except OSError as error:
        raise Damaged(f"{path.name} cannot be read ({error}); copy or record it again") from error
    try:
        _check(file, path)
    except (RuntimeError, OSError, KeyError, TypeError, OverflowError) as error:
        file.close()
        raise Damaged(f"{path.name} is damaged ({error}); copy or record it again") from error
    except BaseException:
        file.close()
        raise
    return file


@contextmanager
def new_hdf5(path: str | Path, size: int, sealed: bool = False) -> Iterator[h5py.File]:
    """A file to be written, of about `size` bytes, which appears at the end; sealed as in `written_aside`.

    Raises OSError where the disk is full.

    HDF5 itself ends the process there, with a segmentation fault. A file of up to `IN_MEMORY` bytes is therefore made
    in memory and written at once; for a larger one, the space is asked for first.
    """
    with written_aside(path, sealed=sealed) as aside:
        if size <= IN_MEMORY:
            with h5py.File(aside, "w", driver="core", backing_store=False) as file:
                yield file
                file.flush()
                image = file.id.get_file_image()
            aside.write_bytes(image)
            return
        with open(aside, "wb") as place:
            if hasattr(os, "posix_fallocate"):
                os.posix_fallocate(place.fileno(), 0, size)
        with h5py.File(aside, "w") as file:
            yield file


def card_of(file: h5py.File, path: str | Path) -> dict:
    """The attribute "card" of a file of this package. Raises `checksum.Damaged` where it is no JSON object."""
    try:
        card = json.loads(file.attrs["card"])
    except (KeyError, TypeError, ValueError, OSError, RuntimeError) as error:  # RuntimeError: also one that is too deep
        raise Damaged(f"{path} is damaged: its card cannot be read ({error}); copy or write it again") from error
    if not isinstance(card, dict):
        raise Damaged(f"{path} is damaged: its card is {str(card)[:40]!r}; copy or write it again")
    return card


def text(group: h5py.Group, name: str) -> str:
    """An attribute that is text. Raises ValueError for another one, KeyError where it is missing."""
    value = group.attrs[name]
    if not isinstance(value, str):
        raise ValueError(f"the attribute {name} of {group.name} is {value!r:.40}; expected text")
    return value


def numbers(group: h5py.Group, name: str, shape: tuple[int | None, ...]) -> np.ndarray:
    """A dataset of finite numbers, float64, of this shape; None: any length.

    Raises ValueError, with the name, for another shape or type and for numbers that are not finite.
    """
    given = group[name]
    fits = isinstance(given, h5py.Dataset) and given.dtype.kind in "fiub" and given.ndim == len(shape)
    if not (fits and all(asked in (None, found) for asked, found in zip(shape, given.shape))):
        raise ValueError(f"{name} has the shape {getattr(given, 'shape', None)} and the type "
                         f"{getattr(given, 'dtype', type(given).__name__)}; expected numbers of the shape {shape}")
    values = np.asarray(given[()], dtype=np.float64)
    if not np.isfinite(values).all():
        raise ValueError(f"{name} holds {int((~np.isfinite(values)).sum())} numbers that are not finite")
    return values


def _check(file: h5py.File, path: Path) -> None:
    """Visit each link once, before anything behind it is read."""
    allowed = COMPRESSION * path.stat().st_size + FREE
    groups, sizes = {b"": _address(file["/"].id)}, {}

    def visit(name: bytes, link) -> None:
        _refuse_outside(name, link, path)
        found = None if link.type == h5py.h5l.TYPE_SOFT else h5py.h5o.open(file.id, name)
        if isinstance(found, h5py.h5g.GroupID):
            _refuse_circle(groups, name, _address(found), path)
        elif isinstance(found, h5py.h5d.DatasetID) and (address := _address(found)) not in sizes:
            sizes[address] = _size(h5py.Dataset(found), name.decode("utf-8", "replace"), path, allowed)
            sizes["all"] = sizes.get("all", 0) + sizes[address]
            if sizes["all"] > 4 * allowed:
                raise ValueError(f"{path.name}: its datasets take {sizes['all']:.3g} bytes in memory, but the file has "
                                 f"{path.stat().st_size:.3g}; expected at most {4 * allowed:.3g}; write it again")

    def first_error(name: bytes, link) -> Exception | None:
        try:
            visit(name, link)  # h5py loses an exception that leaves its visitor; what it returns ends the visit
        except Exception as error:
            return error
        return None

    error = file.id.links.visit(first_error, info=True)
    if error is not None:
        raise error


def _refuse_outside(name: bytes, link, path: Path) -> None:
    shown = name.decode("utf-8", "replace")
    if link.type not in (h5py.h5l.TYPE_HARD, h5py.h5l.TYPE_SOFT):
        raise ValueError(f"{path.name}: {shown!r} is a link to another file, which is not followed; copy its content "
                         "into this file (h5repack, or h5py)")
    if name.count(b"/") >= DEEPEST:
        raise ValueError(f"{path.name}: {shown[:60]!r} lies more than {DEEPEST} groups deep; expected a file with few "
                         "groups")


def _address(found) -> tuple:
    about = h5py.h5o.get_info(found)
    return about.fileno, about.addr


def _refuse_circle(groups: dict, name: bytes, address: tuple, path: Path) -> None:
    above, _, _ = name.rpartition(b"/")
    ancestors = [above[:end] for end in range(len(above) + 1) if end in (0, len(above)) or above[end:end + 1] == b"/"]
    if address in [groups.get(ancestor) for ancestor in ancestors]:
        raise ValueError(f"{path.name}: the group {name.decode('utf-8', 'replace')!r} contains itself; write the file "
                         "again without this link")
    groups[name] = address


def _size(dataset: h5py.Dataset, name: str, path: Path, allowed: int) -> int:
    """Bytes of a dataset in memory, at least those of one chunk. Raises ValueError where the file cannot explain it."""
    if dataset.is_virtual or dataset.external:
        raise ValueError(f"{path.name}: the dataset {name!r} lies in other files, which are not read; copy its values "
                         "into this file")
    rows = 1
    for length in dataset.chunks or ():
        rows *= int(length)
    size = max(int(dataset.size or 0), rows) * max(dataset.dtype.itemsize, 1)
    if size > allowed:
        raise ValueError(f"{path.name}: the dataset {name!r} {dataset.shape} takes {size:.3g} bytes in memory, but the "
                         f"file has {path.stat().st_size:.3g}; expected at most {allowed:.3g}; write it again")
    return size
