"""Containers of arrays: HDF5, MATLAB, NumPy, Parquet; and files of other kinds, or with code in them."""

from __future__ import annotations

import os
import pickle
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

import h5py
import numpy as np
import scipy.io

from ssmr_torch.faults.made_recordings import small_recordings
from ssmr_torch.faults.tool_trials import FileTrial

RUN = small_recordings().runs["m"]
T, Y, U = RUN.time, RUN.y, RUN.u
X = (("(.*[:/._])?(p|y|pos)_?0|x", Y[:, 0]),)
HDF5, MATLAB, NUMPY, OTHER = "HDF5", "MATLAB", "NumPy and Parquet", "files of another kind"
MARK = "ran.txt"


def _placed(fill: Callable[[BinaryIO, Path], None], name: str) -> Callable[[Path], Path]:
    """A function of a folder that writes this file there, aside and then renamed."""
    def write(folder: Path) -> Path:
        aside = folder / f"{name}.part"
        with aside.open("wb+") as file:
            fill(file, folder)
        os.replace(aside, folder / name)
        return folder / name

    return write


def _hdf5(fill, name: str = "m.h5"):
    def filled(stream: BinaryIO, folder: Path) -> None:
        with h5py.File(stream, "w") as file:
            fill(file, folder)

    return _placed(filled, name)


def _plain(file, folder, **more) -> None:
    for key, value in {"t": T, "p": Y, "c": U, **more}.items():
        file[key] = value


def _with_text(file, folder) -> None:
    _plain(file, folder, note=np.array([b"ok"] * 20), operator="someone")
    file.attrs["rig"] = "A"


def _compound(file, folder) -> None:
    table = np.empty(20, dtype=[("t", "f8"), ("x", "f4"), ("label", "S4")])
    table["t"], table["x"], table["label"] = T, Y[:, 0], b"tip"
    file["log/table"] = table


def _scaled(file, folder) -> None:
    _plain(file, folder)
    del file["p"]
    file["p"] = np.round((Y - 100.0) / 0.1).astype("i2")
    file["p"].attrs["scale_factor"], file["p"].attrs["add_offset"] = 0.1, 100.0


def _with_filler(file, folder) -> None:
    values = np.round(10 * Y).astype("i2")
    values[4] = -32768
    file["t"], file["c"], file["p"] = T, U, values
    file["p"].attrs["scale_factor"], file["p"].attrs["_FillValue"] = 0.1, np.int16(-32768)


def _across(file, folder) -> None:
    """Time along the second axis."""
    file["t"], file["p"], file["c"] = T[None], Y.T, U.T


def _deep(file, folder) -> None:
    for run in ("day1/r1", "day1/r2", "day2/r1"):
        for key, value in (("t", T), ("p", Y), ("c", U)):
            file[f"{run}/{key}"] = value


def _elsewhere(file, folder) -> None:
    _plain(file, folder)
    del file["p"]
    with h5py.File(folder / "other.h5", "w") as other:
        other["p"] = Y
    file["p"] = h5py.ExternalLink("other.h5", "/p")


def _round_and_round(file, folder) -> None:
    file["a"] = h5py.SoftLink("/b")
    file["b"] = h5py.SoftLink("/a")


def _bomb(file, folder) -> None:
    file.create_dataset("p", (10**10, 3), "f8", chunks=(10**5, 3), compression="gzip")
    file["t"] = T


def _mat(content, name: str = "m.mat"):
    return _placed(lambda stream, folder: scipy.io.savemat(stream, content), name)


def _struct(field: str = "y") -> dict:
    return {"t": T[:, None], field: Y, "u": U}


def _struct_array(count: int = 2) -> np.ndarray:
    runs = np.empty((1, count), dtype=[("t", object), ("y", object), ("u", object)])
    for k in range(count):
        runs[0, k] = (T[:, None], Y + k, U)
    return runs


def _cells() -> np.ndarray:
    found = np.empty((1, 2), dtype=object)
    found[0, :] = [_struct(), _struct()]
    return found


def _numpy(**arrays):
    return _placed(lambda stream, folder: np.savez(stream, **arrays), "m.npz")


class _Code:
    """Something that writes a file when it is unpickled."""

    def __init__(self, folder: Path):
        self.folder = folder

    def __reduce__(self):
        return os.system, (f"echo ran > '{self.folder / MARK}'",)


def _object_array(stream: BinaryIO, folder: Path) -> None:
    np.savez(stream, t=T, y=np.array([_Code(folder)], dtype=object))


def _pickle(name: str):
    return _placed(lambda stream, folder: stream.write(pickle.dumps(_Code(folder))), name)


def _bytes(name: str, content: bytes):
    return _placed(lambda stream, folder: stream.write(content), name)


def _spreadsheet(name: str):
    def fill(stream: BinaryIO, folder: Path) -> None:
        with zipfile.ZipFile(stream, "w") as file:
            file.writestr("[Content_Types].xml", "<Types/>")
            file.writestr("xl/workbook.xml", "<workbook/>")

    return _placed(fill, name)


def _parquet(**columns):
    def fill(stream: BinaryIO, folder: Path) -> None:
        import pandas

        pandas.DataFrame(columns).to_parquet(stream)

    return _placed(fill, "m.parquet")


def _cut(stream: BinaryIO, folder: Path) -> None:
    scipy.io.savemat(stream, _struct())
    stream.truncate(stream.tell() - 200)


def harmless(folder: Path) -> bool:
    return not (folder / MARK).exists()


STAMPS = 1_700_000_000_000_000_000 + 10_000_000 * np.arange(20)
TRIALS = [
    FileTrial(HDF5, "texts and attributes beside the arrays", _hdf5(_with_text), X, runs=1),
    FileTrial(HDF5, "a compound table with a column of text", _hdf5(_compound), ((".*x", Y[:, 0]),), runs=1),
    FileTrial(HDF5, "integers with scale_factor and add_offset", _hdf5(_scaled), X),
    FileTrial(HDF5, "a fill value in row 4", _hdf5(_with_filler),
              (("p_0", np.where(np.arange(20) == 4, np.nan, Y[:, 0])),)),
    FileTrial(HDF5, "time along the second axis", _hdf5(_across), X, refused=("length|shape|rows",)),
    FileTrial(HDF5, "three runs in groups of groups", _hdf5(_deep), X, runs=3),
    FileTrial(HDF5, "named .csv", _hdf5(_plain, "m.csv"), X),
    FileTrial(HDF5, "an array in another file", _hdf5(_elsewhere), refused=("link",), only=True),
    FileTrial(HDF5, "links in a circle", _hdf5(_round_and_round), refused=("m.h5",), only=True),
    FileTrial(HDF5, "an array of 240 GB that was never written", _hdf5(_bomb), refused=("m.h5",), only=True),
    FileTrial(MATLAB, "t, y, u", _mat(_struct()), X, runs=1),
    FileTrial(MATLAB, "a struct", _mat({"run": _struct()}), X, runs=1),
    FileTrial(MATLAB, "an array of structs", _mat({"runs": _struct_array()}), X, runs=2),
    FileTrial(MATLAB, "cells with structs", _mat({"runs": _cells()}), X, runs=2),
    FileTrial(MATLAB, "time along the second axis", _mat({"t": T[None], "y": Y.T, "u": U.T}), X),
    FileTrial(MATLAB, "text and a scalar beside", _mat({**_struct(), "note": "rig 3", "Ts": 0.01}), X, runs=1),
    FileTrial(MATLAB, "version 7.3, named .mat", _hdf5(lambda file, folder: _plain(file, folder, y=Y), "m.mat"), X),
    FileTrial(MATLAB, "cut", _placed(_cut, "m.mat"), refused=("m.mat",), only=True),
    FileTrial(NUMPY, "t, y, u", _numpy(t=T, y=Y, u=U), X, runs=1),
    FileTrial(NUMPY, "an array of Python objects", _placed(_object_array, "m.npz"), refused=("object|pickle",),
              only=True, harmless=harmless),
    FileTrial(NUMPY, "a pickle named .npy", _pickle("m.npy"), refused=("m.npy",), only=True, harmless=harmless),
    FileTrial(NUMPY, "a pickle named .csv", _pickle("m.csv"), refused=("m.csv",), only=True, harmless=harmless),
    FileTrial(NUMPY, "Parquet with integer stamps and text", _parquet(t=STAMPS, x=Y[:, 0], who=["a"] * 20), X),
    FileTrial(NUMPY, "Parquet with a column of nothing", _parquet(x=Y[:, 0], gap=[None] * 20), X),
    FileTrial(OTHER, "a spreadsheet", _spreadsheet("m.xlsx"), refused=("CSV",), only=True),
    FileTrial(OTHER, "a spreadsheet named .csv", _spreadsheet("m.csv"), refused=("CSV",), only=True),
    FileTrial(OTHER, "a picture named .csv", _bytes("m.csv", b"\x89PNG\r\n\x1a\n" + bytes(range(256)) * 4),
              refused=("m.csv",), only=True),
    FileTrial(OTHER, "nothing in it", _bytes("m.csv", b""), refused=("empty",), only=True),
    FileTrial(OTHER, "random bytes named .mat", _bytes("m.mat", np.random.default_rng(0).bytes(4000)),
              refused=("m.mat",), only=True),
    FileTrial(OTHER, "HTML of a login page", _bytes("m.csv", b"<!DOCTYPE html>\n<html><body>log in</body></html>\n"),
              refused=("m.csv",), only=True),
]

