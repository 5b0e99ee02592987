"""Files of results as text, JSON and CSV: each is written aside and then renamed, so that none is ever half written."""

from __future__ import annotations

import csv
import io
import json
import os
import secrets
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ssmr_torch import checksum


def save_text(path: Path, text: str) -> Path:
    """Write a text file in UTF-8; missing folders are made."""
    return save_bytes(path, text.encode())


def save_bytes(path: Path, content: bytes, sealed: bool = False) -> Path:
    """Write a file; missing folders are made. sealed: as in `written_aside`."""
    with written_aside(path, sealed) as aside:
        aside.write_bytes(content)
    return Path(path)


@contextmanager
def written_aside(path: str | Path, sealed: bool = False) -> Iterator[Path]:
    """A new path beside `path`. What was written there replaces `path` at the end; after an error it is removed.

    sealed: a checksum is appended first, see `checksum`. No other process and no neighbour has the name of the new
    path, so that of two that write the same file one wins whole.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    aside = path.with_name(f".{path.name[:100]}.{secrets.token_hex(6)}.part")
    try:
        yield aside
        if sealed:
            end = checksum.ending(aside)
            with open(aside, "ab") as file:
                file.write(end)
        os.replace(aside, path)
    finally:
        aside.unlink(missing_ok=True)


def save_json(path: Path, content: Mapping, sealed: bool = True) -> Path:
    """Write plain values; infinite and undefined numbers become null. Read it with `read_json`.

    sealed: the entry "checksum" is added. False: for a file that a person is to edit.
    """
    finite = json.loads(json.dumps(content), parse_constant=lambda _: None)
    return save_text(path, checksum.sealed_json(finite) if sealed else json.dumps(finite, indent=2) + "\n")


def read_json(path: str | Path) -> Any:
    """What `save_json` wrote, without its checksum. Raises ValueError for a damaged file, see `checksum.parsed`."""
    content = checksum.parsed(path)
    if isinstance(content, dict):
        content.pop(checksum.KEY, None)
    return content


def save_csv(path: Path, rows: Sequence[Mapping]) -> Path:
    """Write rows as a table; its columns are those of all rows, in the order in which they first appear."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(dict.fromkeys(column for row in rows for column in row)))
    writer.writeheader()
    writer.writerows(rows)
    return save_text(path, text.getvalue())
