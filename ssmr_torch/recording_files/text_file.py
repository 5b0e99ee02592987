"""The text of a file in whatever encoding a measurement system wrote it."""

from __future__ import annotations

import codecs
from functools import lru_cache
from pathlib import Path

MARKS = ((codecs.BOM_UTF32_LE, "utf-32-le"), (codecs.BOM_UTF32_BE, "utf-32-be"), (codecs.BOM_UTF8, "utf-8"),
         (codecs.BOM_UTF16_LE, "utf-16-le"), (codecs.BOM_UTF16_BE, "utf-16-be"))
# Zero bytes among the first four characters of text without a mark.
ZEROS = {(1, 1, 1): "utf-32-be", (0, 1, 1): "utf-32-le", (1, 0, 1): "utf-16-be", (0, 1, 0): "utf-16-le"}


def text_of(path: Path) -> str:
    """The text: UTF-8, UTF-16 or UTF-32 with or without a byte order mark, else Windows-1252, else Latin-1.

    A last character that was cut is left out. Raises ValueError for a file that is not text.
    """
    stamp = path.stat()
    return _text_of(path, stamp.st_mtime_ns, stamp.st_size)


@lru_cache(maxsize=1)  # each format looks at the text of the same file
def _text_of(path: Path, modified: int, size: int) -> str:
    data = path.read_bytes()
    mark, encoding = next(((mark, name) for mark, name in MARKS if data.startswith(mark)), (b"", None))
    data = data[len(mark):]
    encoding = encoding or ZEROS.get(tuple(int(byte == 0) for byte in data[:3]))
    for name in (encoding,) if encoding else ("utf-8", "cp1252", "latin-1"):
        width = {"utf-16": 2, "utf-32": 4}.get(name[:6], 1)
        whole = data[:len(data) - len(data) % width]
        try:
            text = codecs.getincrementaldecoder(name)().decode(whole)  # not final: a cut character is left out
        except UnicodeDecodeError as error:
            reason = error.reason
            continue
        if "\0" not in text:
            return text
        reason = "it holds zero bytes"
    raise ValueError(f"{path.name} is not a text file ({reason}); expected CSV or another known format of recordings")


def forget() -> None:
    """Let go of the text that was read last."""
    _text_of.cache_clear()
