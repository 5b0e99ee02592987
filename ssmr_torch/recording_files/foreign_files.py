"""Files that are told by their first bytes, and those that no reader takes, each with the remedy."""

from __future__ import annotations

import zipfile
from pathlib import Path

SHEET = "a spreadsheet; save it as CSV"
PACKED = "compressed; unpack it first"
# First bytes → what the file is, and what to do.
REFUSED = {
    b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1": SHEET, b"\x1f\x8b": PACKED, b"BZh": PACKED, b"\xfd7zXZ\0": PACKED,
    b"7z\xbc\xaf\x27\x1c": PACKED, b"Rar!": PACKED, b"\x28\xb5\x2f\xfd": PACKED,
    b"ARROW1": "an Arrow (Feather) file; write it as Parquet", b"TDSm": "an NI TDMS file; export it as CSV",
    b"MDF     ": "an MDF file; export it as CSV", b"%PDF": "a PDF; export the numbers as CSV",
    b"\x89PNG": "not a text file but a picture (it holds zero bytes); expected CSV or another format of recordings",
    b"\x80\x02": "a pickle, which could run foreign code; save it as NPZ or CSV",
    b"\x80\x03": "a pickle, which could run foreign code; save it as NPZ or CSV",
    b"\x80\x04": "a pickle, which could run foreign code; save it as NPZ or CSV",
    b"\x80\x05": "a pickle, which could run foreign code; save it as NPZ or CSV",
}
HDF5_NAMES = (".h5", ".hdf5", ".hdf", ".nc")
ROSBAGS = {".db3": b"SQLite format 3\0", ".mcap": b"\x89MCAP0\r\n", ".bag": b"#ROSBAG V2.0"}
PAGES = (b"<!doctype html", b"<html", b"<?xml")
PARQUET_NAMES = (".parquet", ".pq")


def refuse(head: bytes, path: Path) -> None:
    """Raises ValueError, with the remedy, for a file that no reader takes."""
    said = next((said for mark, said in REFUSED.items() if head.startswith(mark)), None)
    if head.startswith(b"PK") and not is_npz(path):
        said = SHEET if _holds(path, "xl/", "content.xml") else \
            "a ZIP archive, or a damaged one; unpack it first, or copy it again"
    if head.lstrip(b"\xef\xbb\xbf \t\r\n").lower().startswith(PAGES):
        said = "a page of the web or XML, not a recording; download or export the file again"
    if said:
        raise ValueError(f"{path.name} is {said}")
    if path.suffix.lower() in HDF5_NAMES and not is_hdf5(path) and not head.startswith(b"CDF"):
        raise ValueError(f"{path.name} is not an HDF5 file; copy or record it again, or name a CSV file .csv")
    if head.startswith(b"CDF"):
        raise ValueError(f"{path.name} is a NetCDF 3 file; write it as NetCDF 4 or HDF5: nccopy -k nc4 OLD NEW")
    if path.suffix.lower() in PARQUET_NAMES and not head.startswith(b"PAR1"):
        raise ValueError(f"{path.name} cannot be read as Parquet; copy or record it again, or name a CSV file .csv")


def is_hdf5(path: Path) -> bool:
    import h5py

    return path.is_file() and bool(h5py.is_hdf5(path))


def is_npz(path: Path) -> bool:
    """Whether a file is an archive of NumPy arrays."""
    return bool(names := _members(path)) and all(name.endswith(".npy") for name in names)


def is_c3d(head: bytes) -> bool:
    """Whether these are the first bytes of a C3D file: a pointer to the parameters, and the key 0x50."""
    return len(head) > 512 and head[1] == 0x50 and 2 <= head[0] <= 8 and b"\0" in head[:512]


def _holds(path: Path, *beginnings: str) -> bool:
    return any(name.startswith(beginnings) for name in _members(path))


def _members(path: Path) -> list[str]:
    if not path.is_file() or not zipfile.is_zipfile(path):
        return []
    try:
        with zipfile.ZipFile(path) as archive:
            return archive.namelist()
    except (zipfile.BadZipFile, UnicodeError, NotImplementedError):
        return []
