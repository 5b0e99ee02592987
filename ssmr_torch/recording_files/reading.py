"""`read_tables`: the runs in a file of any known format, told by its content, not by its name."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

from ssmr_torch.recording_files import foreign_files, motive, qualisys, vicon
from ssmr_torch.recording_files.table import Table
from ssmr_torch.recording_files.text_file import forget, text_of

HEAD = 4096  # bytes, or characters of text, by which a format is told


class Format(NamedTuple):
    """name: of the format. recognises: whether its first bytes, or characters, and its path are of this format. module:
    of this room, whose `read(path) -> list[Table]` reads it; it is imported when such a file is read.
    """

    name: str
    recognises: Callable[[bytes, Path], bool]
    module: str

    def read(self, path: Path) -> list[Table]:
        return import_module(f"ssmr_torch.recording_files.{self.module}").read(path)


def _begins(*marks: bytes) -> Callable[[bytes, Path], bool]:
    return lambda head, path: head.startswith(marks)


def _text(recognises: Callable[[str], bool]) -> Callable[[bytes, Path], bool]:
    return lambda head, path: recognises(text_of(path)[:HEAD])


# In this order: bytes that only one format begins with, then what only its text tells, then any text.
FORMATS = (
    Format("rosbag2", lambda head, path: path.is_dir(), "rosbag_reader"),
    Format("MATLAB 7.3", lambda head, path: b"MATLAB 7.3" in head[:128] and foreign_files.is_hdf5(path),
           "matlab_tables"),
    Format("HDF5", lambda head, path: foreign_files.is_hdf5(path), "hdf5_reader"),
    Format("MATLAB 5", _begins(b"MATLAB 5.0", b"MATLAB 7.0"), "matlab_tables"),
    Format("Parquet", _begins(b"PAR1"), "parquet_reader"),
    Format("NumPy", lambda head, path: head.startswith(b"\x93NUMPY") or foreign_files.is_npz(path), "numpy_reader"),
    Format("rosbag", _begins(*foreign_files.ROSBAGS.values()), "rosbag_reader"),
    Format("C3D", lambda head, path: foreign_files.is_c3d(head), "c3d_reader"),
    Format("Motive CSV", _text(motive.recognises), "motive"),
    Format("Qualisys TSV", _text(qualisys.recognises), "qualisys"),
    Format("Vicon CSV", _text(vicon.recognises), "vicon"),
    Format("CSV", lambda head, path: True, "csv_reader"),
)


def read_tables(path: str | Path) -> list[Table]:
    """The runs in a file, one `Table` each; several where parts of a run have clocks of their own.

    Raises FileNotFoundError, or ValueError that names the format and what to do when the file cannot be read;
    ModuleNotFoundError, with the command that installs it, where a format needs a package that is missing.
    """
    path = Path(path)
    if not path.exists():
        raise FileNotFoundError(f"no file {path}; check the folder and the name")
    if path.is_dir() and not (path / "metadata.yaml").is_file():
        raise ValueError(f"{path.name} is a folder; expected a file, a folder of rosbag2 with its metadata.yaml, or a "
                         "pattern such as '*.csv'")
    head = b""
    if not path.is_dir() and not path.is_file():
        raise ValueError(f"{path} is no file but a device or a pipe; record to a file first")
    if path.is_file():
        if path.stat().st_size == 0:
            raise ValueError(f"{path.name} is empty; expected a header and rows of numbers")
        with path.open("rb") as file:
            head = file.read(HEAD)
        foreign_files.refuse(head, path)
    try:
        return next(each for each in FORMATS if each.recognises(head, path)).read(path)
    finally:
        forget()
