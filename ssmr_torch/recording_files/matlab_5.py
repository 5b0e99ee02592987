"""MATLAB files of version 5, whose structure is checked before SciPy reads them.

SciPy's reader trusts the types and sizes in the file; a damaged one can end the process. The format is that of
MathWorks, "MAT-File Format" (2019).
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from math import prod
from pathlib import Path
from typing import NamedTuple

import numpy as np

HEADER = 128
# Types of data elements → bytes of one value.
SIZES = {1: 1, 2: 1, 3: 2, 4: 2, 5: 4, 6: 4, 7: 4, 9: 8, 12: 8, 13: 8, 16: 1, 17: 2, 18: 4}
MATRIX, COMPRESSED = 14, 15
CELL, STRUCT, OBJECT, CHAR, SPARSE, FUNCTION, OPAQUE = 1, 2, 3, 4, 5, 16, 17
NUMBERS = range(6, 16)
COMPLEX = 0x800
DEEPEST = 20
LARGEST = 200        # times the bytes of the file, and 64 MiB, that an element may have when it is unpacked
FREE = 64 * 2**20


class _Element(NamedTuple):
    kind: int
    data: memoryview


class _Damaged(Exception):
    """What is wrong with the structure of a file."""


def load_matlab_5(path: Path) -> dict[str, object]:
    """The variables by name, as `scipy.io.loadmat` gives them.

    Raises ValueError for a damaged file and for one of another version.
    """
    import scipy.io

    content = path.read_bytes()
    try:
        _check(content)
        loaded = scipy.io.loadmat(path)
    except (_Damaged, struct.error) as error:
        raise ValueError(f"{path.name} is not a MATLAB file that can be read ({error}); expected version 5 or 7.3: "
                         "copy it again, or save it again as save('run.mat', '-v7.3')") from error
    except Exception as error:  # scipy raises what it stumbles upon
        raise ValueError(f"{path.name} is not a MATLAB file that can be read ({type(error).__name__}: "
                         f"{str(error)[:100]}); expected version 5 or 7.3") from error
    return {name: value for name, value in loaded.items() if not name.startswith("__")}


def _check(content: bytes) -> None:
    """Raises _Damaged unless every element fits into the one that holds it and has a known type."""
    order = {b"IM": "<", b"MI": ">"}.get(content[126:128])
    if len(content) < HEADER + 8 or order is None:
        raise _Damaged("its header is incomplete" if order or len(content) < HEADER else "it is of another version")
    allowed = LARGEST * len(content) + FREE
    for element in _elements(memoryview(content)[HEADER:], order):
        if element.kind == COMPRESSED:
            unpacked = _unpacked(element.data, allowed)
            (element,) = list(_elements(memoryview(unpacked), order))[:1] or [_Element(0, element.data)]
        if element.kind != MATRIX:
            raise _Damaged(f"an element has the type {element.kind}")
        _check_matrix(element.data, order, 0)


def _unpacked(data: memoryview, allowed: int) -> bytes:
    try:
        unpacked = zlib.decompressobj().decompress(data, allowed + 1)
    except zlib.error as error:
        raise _Damaged(str(error)) from error
    if len(unpacked) > allowed:
        raise _Damaged(f"an element has more than {allowed} bytes when it is unpacked")
    return unpacked


def _elements(data: memoryview, order: str) -> Iterator[_Element]:
    """The elements one after another; small ones keep their data in the tag."""
    place = 0
    while place + 8 <= len(data):
        first, size = struct.unpack_from(f"{order}II", data, place)
        if first >> 16:
            kind, size, start, step = first & 0xFFFF, first >> 16, place + 4, 8
            if size > 4:
                raise _Damaged(f"a small element has {size} bytes")
        else:
            kind, start = first, place + 8
            step = 8 + size + (-size % 8 if kind != COMPRESSED else 0)
        if start + size > len(data):
            raise _Damaged(f"it ends {start + size - len(data)} bytes too early")
        yield _Element(kind, data[start:start + size])
        place += step


def _check_matrix(data: memoryview, order: str, depth: int) -> None:
    if not len(data):
        return               # an empty cell
    if depth > DEEPEST:
        raise _Damaged(f"its values lie more than {DEEPEST} deep in each other")
    parts = list(_elements(data, order))
    if len(parts) < 2 or parts[0].kind != 6 or len(parts[0].data) != 8:
        raise _Damaged("an array has no flags")
    flags = struct.unpack(f"{order}I", parts[0].data[:4])[0]
    kind = flags & 0xFF
    if kind == OPAQUE:
        return               # objects, which are refused
    if len(parts) < 3 or parts[1].kind != 5 or len(parts[1].data) % 4 or len(parts[1].data) < 8:
        raise _Damaged("an array has no dimensions")
    shape = struct.unpack(f"{order}{len(parts[1].data) // 4}i", parts[1].data)
    if min(shape) < 0 or parts[2].kind not in (1, 2, 16):
        raise _Damaged(f"an array has the dimensions {str(shape)[:40]}")
    _check_content(kind, bool(flags & COMPLEX), prod(shape), parts[3:], order, depth)


def _check_content(kind: int, complex_: bool, count: int, parts: list[_Element], order: str, depth: int) -> None:
    """What follows the name of an array of this class, with so many values."""
    if kind in (STRUCT, OBJECT):
        parts = parts[kind == OBJECT:]
        if len(parts) < 2 or parts[0].kind != 5 or len(parts[0].data) != 4 or parts[1].kind != 1:
            raise _Damaged("a struct has no fields")
        width = struct.unpack(f"{order}i", parts[0].data)[0]
        if width <= 0 or len(parts[1].data) % width:
            raise _Damaged(f"the names of a struct's fields have {width} letters")
        count, parts = count * (len(parts[1].data) // width), parts[2:]
    if kind in (CELL, STRUCT, OBJECT):
        if len(parts) < count or any(part.kind != MATRIX for part in parts[:count]):
            raise _Damaged(f"{len(parts)} of {count} values are there")
        for part in parts:
            _check_matrix(part.data, order, depth + 1)
    elif kind in NUMBERS or kind == CHAR:
        needed = 1 + complex_
        if len(parts) < needed and count:
            raise _Damaged("an array has no values")
        for part in parts[:needed]:
            size = SIZES.get(part.kind)
            if size is None or (kind != CHAR and len(part.data) != size * count):
                raise _Damaged(f"an array of {count} values has {len(part.data)} bytes of the type {part.kind}")
            if kind == CHAR and (part.kind not in (1, 2, 4, 16, 17, 18) or len(part.data) > 4 * count + 8):
                raise _Damaged(f"a text of {count} letters has {len(part.data)} bytes of the type {part.kind}")
    elif kind == SPARSE:  # row indices, column starts, values
        if [part.kind for part in parts[:2]] != [5, 5] or len(parts) < 3 or any(
                len(part.data) % SIZES.get(part.kind, len(part.data) + 1) for part in parts[:3]):
            raise _Damaged("a sparse matrix has no indices")
    elif kind != FUNCTION:
        raise _Damaged(f"an array is of the class {kind}")


def is_matlab_object(value: object) -> bool:
    """Whether a value of `load_matlab_5` is one that only MATLAB can read."""
    return isinstance(value, np.ndarray) and type(value).__name__ in ("MatlabOpaque", "MatlabFunction")
