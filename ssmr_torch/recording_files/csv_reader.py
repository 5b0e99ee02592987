"""Tables from delimited text in any dialect: the CSV files of measurement systems, spreadsheets and ROS."""

from __future__ import annotations

import logging
import re
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from ssmr_torch.recording_files.cells import is_number, number
from ssmr_torch.recording_files.table import Table
from ssmr_torch.recording_files.text_columns import BLANK, Lines, columns_of, split_row
from ssmr_torch.recording_files.text_file import text_of
from ssmr_torch.recording_files.union_of_stamps import by_signal
from ssmr_torch.recording_files.units_said import says_units, unit_called, units_in_names

logger = logging.getLogger(__name__)

DELIMITERS = (";", "\t", "|", ",", BLANK)  # the comma late: it may be the decimal sign
# "sep=;" of Excel, and lines that begin with #, % or //, but for cells of Excel such as #N/A
COMMENT = re.compile(r'\s*"?\s*(?:%|//|sep=|#(?!N/A|DIV/0!|VALUE!|REF!|NUM!|NAME\?|NULL!))', re.IGNORECASE)
SAMPLE = 40          # first rows by which delimiters and the header are found
QUOTED = re.compile(r'"\s*[+-]?\d+,\d')  # a number with a decimal comma, between commas
TWICE = "{} ({})"    # name of a column whose name stands twice


def read(path: Path) -> list[Table]:
    """The table of a text file with a row of names.

    Commas, semicolons, tabs, bars or blanks between cells; decimal points, or commas where no cell has a point; quoted
    cells; UTF-8, UTF-16, UTF-32 or Windows-1252; lines of comments (#, %, //), `sep=`, empty lines, repeated headers
    and footers anywhere; lines above the names; the last comment as the row of names where numbers follow at once; a
    row of units under the names, or units in the names, `x [mm]`. Numbers are those that `float` would give, to the
    last bit. Rows are counted from 0, without what is left out. Signals that have rows of their own are tables of their
    own (`union_of_stamps`).
    Raises ValueError for a file that is no text, has no names or no rows, or a row of another length, saying where.
    """
    sheet = _sheet(path)
    columns, notes = columns_of(sheet.lines, path.name)
    return by_signal(Table(columns, units={**units_in_names(columns), **sheet.units}, notes=tuple(notes)))


@dataclass(frozen=True)
class _Sheet:
    lines: Lines
    units: dict[str, str]


def _sheet(path: Path) -> _Sheet:
    text = text_of(path)
    every = text.splitlines()
    lines = [line for line in every if line.strip()]
    rows = [line for line in lines if not COMMENT.match(line)]
    delimiter = _delimiter(rows)
    decimal = _decimal(rows[1:], delimiter)
    rows = _with_names_of_comments(lines, rows, delimiter, decimal)
    top, names, said, start = _header(rows, delimiter, decimal, path.name)
    if top:
        logger.info("%s: %d lines above the names are left out: %r, …", path.name, top, rows[0][:60])
    if decimal == ",":
        logger.info("%s: commas are read as decimal signs", path.name)
    if said:
        logger.info("%s: the row below the names, %r, is taken for units and left out", path.name, rows[start - 1])
    names = _each_once(names)
    units = {name: unit for name, cell in zip(names, said) if (unit := unit_called(cell))}
    open_end = bool(text) and text[-1] not in "\r\n" and len(every) > 2
    lines = Lines(names, rows[start:], delimiter, decimal, open_end, rows[top:start])
    return _Sheet(lines, units)


def _with_names_of_comments(lines: list[str], rows: list[str], delimiter: str, decimal: str) -> list[str]:
    """The rows, with the comment before the first of them as the names where it has as many cells, none a number."""
    place = next((k for k, line in enumerate(lines) if rows and line is rows[0]), 0)
    if not place or not any(is_number(cell, decimal) for cell in split_row(rows[0], delimiter)):
        return rows
    named = lines[place - 1].lstrip(' #%/"' if lines[place - 1].lstrip()[:1] == '"' else " #%/")
    cells = split_row(named, delimiter)
    if len(cells) != len(split_row(rows[0], delimiter)) or any(is_number(cell, decimal) for cell in cells):
        return rows
    return [named, *rows]


def _header(rows: list[str], delimiter: str, decimal: str, file: str) -> tuple[int, list[str], list[str], int]:
    """Lines above the names, the names, the cells of the row of units (none: []), and the first row of samples."""
    cells = [split_row(row, delimiter) for row in rows[:SAMPLE]]
    # The unit "1" is a number, but a row of units holds others as well.
    counted = [any(is_number(cell, decimal) for cell in row) and not says_units(row) for row in cells]
    width = _width([row for row, has in zip(cells, counted) if has])
    first = next((k for k in range(len(cells)) if counted[k] and all(counted[k:k + 3]) and len(cells[k]) == width),
                 next((k for k in range(1, len(cells)) if counted[k]), min(len(cells), 1)))
    last = next((k for k in reversed(range(first)) if not counted[k] and len(cells[k]) > 1), None)
    if last is None and first and not counted[0]:
        last = 0
    if last is None or not any(cell.strip() for cell in cells[last]):
        said = rows[0][:60] if rows else ""
        raise ValueError(f"{file}: the first row is {said!r}; expected the names of the columns")
    top = last
    while top and not counted[top - 1] and len(cells[top - 1]) >= len(cells[last]) > 1:
        top -= 1
    block = cells[top:last + 1]
    if first == len(cells) or (last + 1 == first == len(cells)):
        first = last + 1
    grouped = len(block) > 1 and _filled(block[0]) < _filled(block[1])
    units = next((row for row in block[1:] if says_units(row)), block[1] if len(block) == 2 and not grouped else [])
    names = [row for row in block if row is not units]
    joined = [name.strip() for name in names[0]] if len(names) == 1 else _joined(names)
    return top, joined, units, last + 1


def _joined(rows: list[list[str]]) -> list[str]:
    """Names of several rows: "tip_X" of "tip" above "X"; a blank cell repeats the one to its left."""
    if len(set(rows[0])) == len(rows[0]) and all(cell.strip() for cell in rows[0]):
        return [cell.strip() for cell in rows[0]]
    above, parts = "", []
    for place, below in enumerate(rows[1]):
        above = rows[0][place].strip() or above if place < len(rows[0]) else above
        parts.append("_".join(filter(None, (above, below.strip()))))
    return parts


def _filled(cells: list[str]) -> int:
    return sum(bool(cell.strip()) for cell in cells)


def _each_once(names: list[str]) -> list[str]:
    """The names; those that stand twice get their number, so that neither is taken for the other."""
    counts, seen = Counter(filter(None, names)), Counter()
    once = []
    for name in names:
        seen[name] += 1
        once.append(TWICE.format(name, seen[name]) if counts[name] > 1 else name)
    return once


def _width(rows: list[list[str]]) -> int:
    counts = Counter(map(len, rows))
    return max(counts, key=lambda width: (counts[width], width)) if counts else 0


def _delimiter(rows: list[str]) -> str:
    """The one that cuts most rows into equally many cells, and most of these cells into numbers."""
    sample = [*rows[:SAMPLE], *rows[max(SAMPLE, len(rows) - 10):]]
    best, found = (0.0, 0.0), None
    for delimiter in DELIMITERS:
        cut = [split_row(row, delimiter) for row in sample]
        cut = [row for row in cut if any(is_number(cell, ",") or is_number(cell) for cell in row)]
        width = _width(cut)
        if width < 2:
            continue
        same = [cell for row in cut if len(row) == width for cell in row]
        known = sum(number(cell) is not None or number(cell, ",") is not None for cell in same)
        score = (len(same) / width / len(sample), known / len(same))
        if score > best:
            best, found = score, delimiter
    header = rows[0] if rows else ""
    return found or max(reversed(DELIMITERS[:-1]), key=header.count)


def _decimal(rows: list[str], delimiter: str) -> str:
    body = "\n".join(rows)
    if not (QUOTED.search(body) if delimiter == "," else "," in body):
        return "."
    between = r'[\s"]' if delimiter in ("\t", BLANK) else rf'[{delimiter}\n"]'
    points, commas = (re.search(rf"(?:^|{between}) *[+-]?\d*[{sign}]\d+(?:[eE][+-]?\d+)? *(?:$|{between})", body)
                      for sign in ".,")
    return "," if commas and not points else "."
