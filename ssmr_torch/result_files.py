"""Files of results as text, JSON and CSV: each is written aside and then renamed, so that none is ever half written."""

from __future__ import annotations

import csv
import io
import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path


def save_text(path: Path, text: str) -> Path:
    """Write a text file in UTF-8; missing folders are made."""
    return save_bytes(path, text.encode())


def save_bytes(path: Path, content: bytes) -> Path:
    """Write a file; missing folders are made."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    aside = path.with_name(path.name + ".part")
    aside.write_bytes(content)
    os.replace(aside, path)
    return path


def save_json(path: Path, content: Mapping) -> Path:
    """Write plain values; infinite and undefined numbers become null."""
    finite = json.loads(json.dumps(content), parse_constant=lambda _: None)
    return save_text(path, json.dumps(finite, indent=2) + "\n")


def save_csv(path: Path, rows: Sequence[Mapping]) -> Path:
    """Write rows as a table; its columns are those of all rows, in the order in which they first appear."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(dict.fromkeys(column for row in rows for column in row)))
    writer.writeheader()
    writer.writerows(rows)
    return save_text(path, text.getvalue())
