"""docs/numbers/NAME.json: the numbers of one table of the documentation, and the command that measured them."""

from __future__ import annotations

import json
import math
import re
import textwrap
from dataclasses import asdict, dataclass, fields
from pathlib import Path

from ssmr_torch.data_sheet import number
from ssmr_torch.result_files import save_text

FOLDER = Path("docs", "numbers")
NAME = re.compile(r"[a-z0-9_]+")
EMPTY = "–"
CARRIED = "not measured again since"
WIDTH = 130  # characters of a line of a printed text


@dataclass(frozen=True)
class Numbers:
    """One table, or one printed text, with its origin.

    command: the commands that make the numbers, in their order. version, date, seed: of the measurement; date as
    YYYY-MM-DD. columns and rows: the table; a cell is a number, a text, a list of either, or null for nothing.
    text: lines of a printed text, in place of a table. carried: the numbers were taken over from an earlier version of
    the pages, and were not measured again since. note: one sentence for the caption.
    Raises ValueError where the command is missing, where a row has another length than the columns, or where there is
    neither a table nor a text.
    """

    command: list[str]
    version: str
    date: str
    seed: int | None = None
    carried: bool = False
    note: str = ""
    columns: list[str] | None = None
    rows: list[list] | None = None
    text: list[str] | None = None

    def __post_init__(self):
        if isinstance(self.command, str) or not self.command or not all(self.command):
            raise ValueError(f"command is {self.command!r}; expected a list of the commands that measured the numbers")
        if not re.fullmatch(r"\d{4}-\d\d-\d\d", self.date):
            raise ValueError(f"date is {self.date!r}; expected the day of the measurement, YYYY-MM-DD")
        if (self.rows is None) == (self.text is None):
            raise ValueError("expected either columns and rows, or text; got both or neither")
        for row in self.rows or ():
            if len(row) != len(self.columns or ()):
                raise ValueError(f"the row {row[:1]} has {len(row)} cells; there are {len(self.columns or ())} columns")

    def markdown(self) -> str:
        """The table, or the text indented and wrapped, and a caption with the commands, the version and the date."""
        if self.text is not None:
            body = [part for line in self.text
                    for part in textwrap.wrap(line, WIDTH, initial_indent="    ", subsequent_indent="      ")]
        else:
            lines = [self.columns, ["---"] * len(self.columns), *([cell(value) for value in row] for row in self.rows)]
            body = [f"| {' | '.join(line)} |" for line in lines]
        return "\n".join([*body, "", self.caption])

    @property
    def caption(self) -> str:
        commands = ", then ".join(f"`{command}`" for command in self.command)
        note = f"{self.note} " if self.note else ""
        seed = "" if self.seed is None else f", seed {self.seed}"
        carried = f"; {CARRIED}" if self.carried else ""
        return f"*{note}Measured by {commands}: version {self.version}, {self.date}{seed}{carried}.*"


def cell(value) -> str:
    """How a page shows a cell: a number with three significant digits, a count as it is, a list with slashes."""
    if value is None or value == "":
        return EMPTY
    if isinstance(value, list):
        return " / ".join(map(cell, value))
    return number(value) if isinstance(value, float) else str(value)


def read(path: Path) -> Numbers:
    """The numbers of a file. Raises ValueError, with the file's name, where it is not as `Numbers` expects."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        unknown = sorted(set(found) - {field.name for field in fields(Numbers)})
        if unknown:
            raise ValueError(f"unknown keys {', '.join(unknown)}")
        return Numbers(**found)
    except (ValueError, TypeError) as error:
        raise ValueError(f"{path}: {error}") from error


def read_all(root: Path) -> dict[str, Numbers]:
    """All stores below root/docs/numbers by name. Raises ValueError where there is no such folder."""
    folder = root / FOLDER
    if not folder.is_dir():
        raise ValueError(f"{folder} does not exist: start the command in the folder that holds README.md and docs/")
    return {path.stem: read(path) for path in sorted(folder.glob("*.json"))}


def write(path: Path, numbers: Numbers) -> None:
    """One line per key and per row, so that a change is easy to read; written aside, then renamed."""
    if not NAME.fullmatch(path.stem):
        raise ValueError(f"name={path.stem}: expected small letters, digits and underscores")
    parts = []
    for key, value in asdict(numbers).items():
        value = rounded(value)
        if isinstance(value, list) and value and key in ("rows", "text", "command"):
            lines = ",\n  ".join(json.dumps(each, ensure_ascii=False) for each in value)
            parts.append(f' "{key}": [\n  {lines}\n ]')
        elif value is not None and value != "":
            parts.append(f' "{key}": {json.dumps(value, ensure_ascii=False)}')
    save_text(path, "{\n" + ",\n".join(parts) + "\n}\n")


def rounded(value):
    """Five significant digits, because a page shows three; JSON has no infinite number, so that becomes a text."""
    if isinstance(value, list):
        return [rounded(each) for each in value]
    if isinstance(value, float):
        return float(f"{value:.5g}") if math.isfinite(value) else number(value)
    return value
