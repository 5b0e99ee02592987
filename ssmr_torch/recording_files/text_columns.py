"""Columns from the lines of a table in a text file, whatever system wrote it."""

from __future__ import annotations

import csv
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO, StringIO

import numpy as np

from ssmr_torch.recording_files.cells import is_number, number, numbers
from ssmr_torch.recording_files.cut_line import is_cut
from ssmr_torch.recording_files.note import Note, rows_said

BLANK = "blank"      # stands for runs of blanks as the delimiter
FOOTER = 5           # last lines among which a footer is looked for
# Pandas knows these in the cases that occur; `cells.ABSENT` knows all of them.
QUICK = ("nan", "Nan", "NAN", "NaN", "na", "Na", "NA", "null", "Null", "NULL", "None", "-nan(ind)", "1.#QNAN", "#N/A")
UNNAMED = "column {}"


@dataclass(frozen=True)
class Lines:
    """The lines of a table below its header.

    names: of the columns, once each; "" for a column that is read only if it holds something. lines: of the rows,
    without empty ones. delimiter: between cells. decimal: sign of decimals. open_end: no newline ends the last line,
    while all others end with one. header: lines that may be repeated among the rows, such as the names.
    """

    names: Sequence[str]
    lines: Sequence[str]
    delimiter: str = ","
    decimal: str = "."
    open_end: bool = False
    header: Sequence[str] = ()


def split_row(line: str, delimiter: str) -> list[str]:
    """The cells of a line; quotation marks enclose delimiters."""
    if delimiter == BLANK:
        line, delimiter = " ".join(line.split()), " "
    return next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])


def columns_of(table: Lines, file: str) -> tuple[dict[str, np.ndarray], list[Note]]:
    """Columns by name, (T,) each, and what was left out.

    A column is int64 or float64 where all its cells are numbers or absent, else text (object). Rows of nothing at the
    end, repeated headers, a footer and a last line that was cut are left out; the latter three are said.
    Raises ValueError for a row of another length than the header, saying where.
    """
    rows, notes = _rows(table, file)
    if table.delimiter == BLANK:
        rows = ["\t".join(split_row(row, BLANK)) for row in rows]
    delimiter = "\t" if table.delimiter == BLANK else table.delimiter
    if not rows:
        raise ValueError(f"{file} has a header but no rows; expected one row per sample")
    frame = _parsed(rows, len(table.names), delimiter, table.decimal, file)
    filled = frame.notna().any(axis=1).to_numpy()
    length = len(filled) - int(np.argmax(filled[::-1])) if filled.any() else len(filled)
    columns = {}
    for place, name in enumerate(table.names):
        column = _column(frame[place], table.decimal)[:length]
        if name or frame[place].notna().any():
            columns[name or UNNAMED.format(place + 1)] = column
    return columns, notes


def _rows(table: Lines, file: str) -> tuple[list[str], list[Note]]:
    """The lines of samples, and notes on those left out."""
    notes, rows = [], list(table.lines)
    repeated = {line.strip() for line in table.header}
    if repeated and any(row.strip() in repeated for row in rows):
        kept = [row for row in rows if row.strip() not in repeated]
        places = [k for k, row in enumerate(rows) if row.strip() in repeated]
        before = sorted({place - n for n, place in enumerate(places)})
        notes.append(Note("", "repeated header", f"the header is repeated before {rows_said(before)} and left out "
                          "there; the logger was restarted, so look at the clock there", "dropped", tuple(before)))
        rows = kept
    if table.open_end and len(rows) > 1 and is_cut(
            [split_row(row, table.delimiter) for row in rows[-301:-1]], split_row(rows[-1], table.delimiter),
            table.decimal):
        cut = rows.pop()
        notes.append(Note("", "cut line", f"the last line, {cut[-40:]!r}, is incomplete and without a newline, so row "
                          f"{len(rows)} (from 0) is left out; copy the file again if the recording went on", "dropped",
                          (len(rows),)))
    footer = _footer(rows, table)
    if footer:
        notes.append(Note("", "footer", f"{len(footer)} line{'s' * (len(footer) > 1)} below row "
                          f"{len(rows) - len(footer) - 1} (from 0), {footer[0][:40]!r}, are no samples and left out",
                          "dropped", ()))
        rows = rows[:len(rows) - len(footer)]
    return rows, notes


def _footer(rows: list[str], table: Lines) -> list[str]:
    """Last lines that are no samples: with fewer cells than the header, and words."""
    found = 0
    for row in rows[:-FOOTER - 1:-1]:
        cells = split_row(row, table.delimiter)
        filled = [cell for cell in cells if cell.strip()]
        words = any(number(cell, table.decimal) is None for cell in filled)
        if not words or len(filled) >= len(table.names) or (len(table.names) > 2 and len(filled) > 2):
            break
        found += 1
    return rows[len(rows) - found:] if found else []


def _parsed(rows: list[str], width: int, delimiter: str, decimal: str, file: str):
    """A frame of all cells, columns 0, 1, …; they hold numbers, or text where one cell at least is none."""
    import pandas

    body = "\n".join(rows)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", pandas.errors.ParserWarning)  # cells beyond the names would be left out
            frame = pandas.read_csv(BytesIO(body.encode("utf-8", "replace")), sep=delimiter, decimal=decimal,
                                    header=None, names=range(width + 1), index_col=False, na_values=list(QUICK),
                                    skipinitialspace=True, low_memory=False, skip_blank_lines=False)
    except (pandas.errors.ParserError, pandas.errors.ParserWarning) as error:
        _refuse_ragged(body, width, delimiter, file)
        raise ValueError(f"{file} cannot be read ({error}); look for quotation marks without a partner") from error
    # Missing cells are empty ones to pandas, and only those at the end can be missing.
    if frame[width].notna().any() or frame[width - 1].isna().any():
        _refuse_ragged(body, width, delimiter, file)
    return frame


def _refuse_ragged(body: str, width: int, delimiter: str, file: str) -> None:
    for number_, row in enumerate(csv.reader(StringIO(body), delimiter=delimiter)):
        beyond = row[width:]
        if len(row) < width and any(cell.strip() for cell in row) or len(beyond) > 1 and any(map(str.strip, beyond)) \
                or any(cell.strip() for cell in beyond):
            raise ValueError(f"{file}: row {number_} (from 0) has {len(row)} cells, the header {width}")


def _column(column, decimal: str) -> np.ndarray:
    if column.dtype.kind in "iuf":
        return column.to_numpy()
    if column.dtype.kind == "b":
        return column.astype(str).to_numpy(dtype=object)
    text = column.to_numpy(dtype=object)
    # A glance at the first cells spares a look at all of a column of words.
    if not any(is_number(str(cell), decimal) or number(str(cell), decimal) is not None for cell in text[:50]):
        return text
    read = numbers(text, decimal)
    if read.dtype.kind == "O" and decimal == ",":  # what is a number has a point from here on
        read = np.array([cell.replace(",", ".") if isinstance(cell, str) and is_number(cell, ",") else cell
                         for cell in read], dtype=object)
    return read
