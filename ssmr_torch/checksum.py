"""Checksums of the files that this package writes, so that a file in which one bit changed is never read.

Binary files end with a line that holds the SHA-256 of all bytes before it; HDF5, ZIP and their readers ignore what
follows their own end. A JSON file holds it in its entry "checksum". Files of versions up to 0.11 have none; they are
read, and a line in the log says so.
"""

from __future__ import annotations

import hashlib
import json
import logging
import math
from difflib import SequenceMatcher
from pathlib import Path

MARK = b"\nssmr_torch sha256 "
LENGTH = len(MARK) + 64 + 1
KEY = "checksum"
ANNOUNCED = "# The last line is a checksum, so that edits and damage are told from what was written.\n"
COMMENT = "# sha256 of all lines above: "
LARGEST_JSON = 64 * 2 ** 20  # bytes
DEEPEST_JSON = 64
_UNKNOWN = "0" * 64

log = logging.getLogger(__name__)


class Damaged(ValueError):
    """A file whose bytes are not those that were written."""


def ending(path: str | Path) -> bytes:
    """The line that a file without one must end with, see `result_files.written_aside`."""
    return MARK + _digest(path, Path(path).stat().st_size).encode() + b"\n"


def noted(path: str | Path) -> str | None:
    """The checksum that a file carries, unchecked; None where it carries none."""
    size = Path(path).stat().st_size
    with open(path, "rb") as file:
        file.seek(max(size - LENGTH, 0))
        end = file.read(LENGTH)
    text = end[len(MARK):-1].decode("ascii", "replace")
    right = end.startswith(MARK) and end.endswith(b"\n") and len(end) == LENGTH
    return text if right and all(digit in "0123456789abcdef" for digit in text) else None


def check(path: str | Path) -> str | None:
    """The checksum of a file whose bytes agree with it; None where it carries none, see `refuse_unsealed`.

    Raises `Damaged` where they differ.
    """
    given = noted(path)
    if given is not None and _digest(path, Path(path).stat().st_size - LENGTH) != given:
        raise Damaged(f"{path} is damaged: its bytes differ from its checksum; copy or write it again")
    return given


def refuse_unsealed(path: str | Path, sealed: bool, format: object, *before: str) -> None:
    """What to do with a file that says which format it has: the formats `before` have no checksum, each later one has.

    Raises `Damaged` where the checksum is missing; logs one line for a file that needs none and has none.
    """
    if not sealed and format not in before:
        raise Damaged(f"{path} is damaged: its format {format!r} has a checksum, which is missing; copy or write it "
                      "again")
    if not sealed:
        log.warning("%s carries no checksum (%s); damage to it may go unseen until it is written again", path, format)


def sealed_json(content: dict, indent: int | None = 2) -> str:
    """The content as JSON text whose last entry is the checksum of that text. Raises ValueError for NaN."""
    rest = {key: value for key, value in content.items() if key != KEY}
    text = json.dumps(rest | {KEY: _UNKNOWN}, indent=indent, allow_nan=False) + "\n"
    found = hashlib.sha256(text.encode()).hexdigest()
    before, _, after = text.rpartition(_UNKNOWN)
    return before + found + after


def commented(text: str) -> str:
    """The text between two comments, for a file that a person may edit; the last is its checksum, see `edited`."""
    text = ANNOUNCED + text
    return f"{text}{COMMENT}{hashlib.sha256(text.encode()).hexdigest()}\n"


def edited(text: str) -> bool:
    """Whether a text of `commented` is another one now."""
    before, mark, given = text.rpartition(COMMENT)
    if not mark:
        return text.startswith(ANNOUNCED[:20])
    return hashlib.sha256(before.encode()).hexdigest() + "\n" != given


def parsed(path: str | Path) -> object:
    """What a JSON file holds; an entry "checksum" at its top was checked.

    Raises ValueError for a file that is too large, too deep or no JSON, or that holds a number which is not finite;
    `Damaged`, which is one, where its text differs from its checksum.
    """
    path = Path(path)
    if path.stat().st_size > LARGEST_JSON:
        raise ValueError(f"{path} has {path.stat().st_size} bytes; expected at most {LARGEST_JSON}")
    raw = path.read_bytes()
    try:
        content = json.loads(raw, parse_constant=_refuse_constant, parse_float=_finite)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path} is not valid JSON ({error or 'too deep'}); write it again") from error
    if not _shallow(content):
        raise ValueError(f"{path} holds more than {DEEPEST_JSON} values within one another; write it again")
    given = content.get(KEY) if isinstance(content, dict) else None
    if given is None and isinstance(content, dict) and _almost(content):
        raise Damaged(f"{path} is damaged: its last entry is almost a checksum; write it again")
    if given is not None and not (isinstance(given, str) and _agrees(raw, given)):
        raise Damaged(f"{path} is damaged or was edited: its text differs from its checksum; write it again")
    return content


def _shallow(content: object) -> bool:
    level = [content]
    for _ in range(DEEPEST_JSON):
        level = [part for each in level if isinstance(each, (dict, list))
                 for part in (each.values() if isinstance(each, dict) else each)]
        if not level:
            return True
    return False


def _almost(content: dict) -> bool:
    """Whether the last entry is a checksum whose name was damaged."""
    last = next(reversed(content), "")
    return isinstance(content.get(last), str) and len(content[last]) == 64 and \
        SequenceMatcher(None, last, KEY).ratio() > 0.7


def _agrees(raw: bytes, given: str) -> bool:
    before, found, after = raw.rpartition(given.encode())
    return bool(found) and len(given) == 64 and hashlib.sha256(
        before + _UNKNOWN.encode() + after).hexdigest() == given


def _refuse_constant(text: str):
    raise ValueError(f"it holds {text}")


def _finite(text: str) -> float:
    number = float(text)
    if not math.isfinite(number):
        raise ValueError(f"it holds the number {text[:20]}")
    return number


def _digest(path: str | Path, length: int) -> str:
    """SHA-256 of the first bytes of a file, which is read piece by piece."""
    found = hashlib.sha256()
    with open(path, "rb") as file:
        while length > 0 and (piece := file.read(min(length, 2 ** 20))):
            found.update(piece)
            length -= len(piece)
    return found.hexdigest()
