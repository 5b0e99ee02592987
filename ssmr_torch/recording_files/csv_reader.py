"""Named columns of numbers from the CSV files of measurement systems, whatever their encoding and separators."""

from __future__ import annotations

import csv
import logging
import re
from dataclasses import dataclass
from io import BytesIO, StringIO
from pathlib import Path

import numpy as np

logger = logging.getLogger(__name__)

DELIMITERS = (";", "\t", ",")  # the comma last: it may be the decimal sign
COMMENT = re.compile(r"\s*(?:%|sep=|#(?!N/A|DIV/0!|VALUE!|REF!|NUM!|NAME\?|NULL!))")  # "sep=;" and cells of Excel
ABSENT = ("nan", "Nan", "NAN", "NaN", "na", "Na", "NA", "null", "Null", "NULL")  # as good as an empty cell
QUOTED = re.compile(r'"\s*[+-]?\d+,\d')  # a number with a decimal comma, between commas
DECIMALS = " (commas are decimal signs only where no cell has a decimal point)"
BEYOND = "\0beyond"            # the column of cells that no name stands above


def read_csv(path: Path) -> dict[str, np.ndarray]:
    """Columns by name, (T,) each, from a text file with one row of names; empty cells become NaN.

    Commas, semicolons or tabs; decimal commas in files without them as delimiters; quoted cells; UTF-8, UTF-16 or
    Windows-1252, with or without a byte order mark; lines of comments (#, %) and empty lines anywhere; the last comment
    as the row of names where numbers follow at once; and a row of units under the names, which is logged and left out.
    Numbers are those that `float` would give, to the last bit. Rows are counted from 0, without what is left out.
    Raises ValueError for a file that is no text, has no names or no rows, names a column twice, or has a row of
    another length or a cell that is no number, saying where.
    """
    sheet = _sheet(path)
    if not sheet.names or any(_is_number(name) for name in sheet.names):
        raise ValueError(f"{path.name}: the first row is {sheet.header[:60]!r}; expected the names of the columns")
    if len(set(sheet.names)) < len(sheet.names):
        raise ValueError(f"{path.name}: the header names a column twice, {sheet.names}; give each its own name")
    if not sheet.body.strip():
        raise ValueError(f"{path.name} has a header but no rows; expected one row per sample")
    frame = _parsed(sheet, path)
    return {name: _numbers(frame[name], name, sheet, path) for name in sheet.names if name or frame[name].notna().any()}


@dataclass(frozen=True)
class _Sheet:
    """The row of names, the names, the text of the rows below them, and what separates cells and decimals."""

    header: str
    names: list[str]
    body: str
    delimiter: str
    decimal: str


def _sheet(path: Path) -> _Sheet:
    lines = [line for line in _text(path).splitlines() if line.strip()]
    rows = [line for line in lines if not COMMENT.match(line)]
    comments = next((place for place, line in enumerate(lines) if line in rows[:1]), 0)
    delimiter = _delimiter(rows)
    if comments and rows and all(_is_number(cell) for cell in _cells(rows[0], delimiter)):
        named = lines[comments - 1].lstrip(" #%")
        if len(_cells(named, delimiter)) == len(_cells(rows[0], delimiter)):
            rows.insert(0, named)
    header = rows[0] if rows else ""
    if len(rows) > 1 and _is_row_of_units(_cells(rows[1], delimiter)):
        logger.info("%s: the row below the names, %r, is taken for units and left out; the card's units count",
                    path.name, rows.pop(1))
    body = "\n".join(rows[1:])
    decimal = _decimal(body, delimiter)
    if decimal == ",":
        logger.info("%s: commas are read as decimal signs", path.name)
    return _Sheet(header, [name.strip() for name in _cells(header, delimiter)], body, delimiter, decimal)


def _text(path: Path) -> str:
    data = path.read_bytes()
    encodings = ("utf-16",) if data[:2] in (b"\xff\xfe", b"\xfe\xff") else ("utf-8-sig", "cp1252")
    if not data[:2].startswith((b"\xff", b"\xfe")) and b"\0" in data[:4]:
        encodings = ("utf-16-le" if data[1:2] == b"\0" else "utf-16-be",)
    for encoding in encodings:
        try:
            text = data.decode(encoding)
        except UnicodeDecodeError as error:
            reason = error.reason
            continue
        if "\0" not in text:
            return text
        reason = "it holds zero bytes"
    raise ValueError(f"{path.name} is not a text file ({reason}); expected CSV")


def _delimiter(rows: list[str]) -> str:
    """The one that cuts the names and the row below them into equally many cells, else the most frequent."""
    header = rows[0] if rows else ""
    for delimiter in DELIMITERS:
        if len({len(_cells(row, delimiter)) for row in rows[:2]}) == 1 < len(_cells(header, delimiter)):
            return delimiter
    return max(reversed(DELIMITERS), key=header.count)


def _decimal(body: str, delimiter: str) -> str:
    commas = QUOTED.search(body) if delimiter == "," else "," in body
    return "," if commas and "." not in body else "."


def _cells(row: str, delimiter: str) -> list[str]:
    return next(csv.reader([row], delimiter=delimiter), [])


def _is_number(cell: str, decimal: str = ",") -> bool:
    try:
        float(cell.replace(decimal, "."))
    except ValueError:
        return False
    return "_" not in cell  # Python's own 1_000


def _is_row_of_units(cells: list[str]) -> bool:
    said = [cell for cell in cells if cell.strip()]
    return bool(said) and not any(_is_number(cell) or cell.strip() in ABSENT for cell in said)


def _parsed(sheet: _Sheet, path: Path):
    """A frame of all cells; its columns hold numbers, or text where one cell at least is none."""
    import pandas

    names = [*sheet.names, BEYOND]
    try:
        frame = pandas.read_csv(BytesIO(sheet.body.encode()), sep=sheet.delimiter, decimal=sheet.decimal, header=None,
                                names=names, index_col=False, na_values=list(ABSENT), skipinitialspace=True,
                                low_memory=False)
    except pandas.errors.ParserError as error:
        _refuse_ragged(sheet, path)
        raise ValueError(f"{path.name} cannot be read ({error}); look for quotation marks without a partner") from error
    # Missing cells are empty ones to pandas, and only those at the end can be missing.
    if frame[BEYOND].notna().any() or frame[sheet.names[-1]].isna().any():
        _refuse_ragged(sheet, path)
    return frame


def _refuse_ragged(sheet: _Sheet, path: Path) -> None:
    for number, row in enumerate(csv.reader(StringIO(sheet.body), delimiter=sheet.delimiter)):
        beyond = row[len(sheet.names):]
        if len(row) < len(sheet.names) or len(beyond) > 1 or any(cell.strip() for cell in beyond):
            raise ValueError(f"{path.name}: row {number} (from 0) has {len(row)} cells, the header "
                             f"{len(sheet.names)}")


def _numbers(column, name: str, sheet: _Sheet, path: Path) -> np.ndarray:
    if column.dtype.kind in "iuf":
        return column.to_numpy(dtype=np.float64)
    for number, cell in enumerate(column):
        if not _is_number(str(cell), sheet.decimal):
            hint = DECIMALS if _is_number(str(cell)) else ""
            raise ValueError(f"{path.name}: row {number} (from 0), column {name!r} holds {str(cell)!r}; expected a "
                             f"number{hint}")
    return np.array([float(str(cell).replace(sheet.decimal, ".")) for cell in column])
