"""Building blocks of C text: tables whose literals read back to the same double, products with them, comments."""

from __future__ import annotations

import re
from typing import NamedTuple

import numpy as np


class Family(NamedTuple):
    """The part of the C file that depends on the model family.

    sizes: its enumerators.   code: tables and functions, among them `encode_window`, `decode_state`, and what its kind
    of step needs.   scratch: doubles on the stack in its deepest call.   mathematics: whether <math.h> is needed.
    """

    sizes: dict[str, int]
    code: str
    scratch: int
    mathematics: bool = False


def table(name: str, array: np.ndarray, note: str) -> str:
    """A constant array, row by row: int for integers, double for the rest; a single zero where it is empty.

    repr gives the shortest decimal number that reads back to the same double.
    """
    array = np.asarray(array)
    integers = np.issubdtype(array.dtype, np.integer)
    literals = [repr(int(value) if integers else float(value)) for value in array.ravel()] or ["0"]
    across = 16 if integers else 5
    rows = [", ".join(literals[k:k + across]) for k in range(0, len(literals), across)]
    shape = " x ".join(map(str, array.shape))
    return (f"/* {note}: {shape} */\nstatic const {'int' if integers else 'double'} {name}[{len(literals)}] = {{\n    "
            + ",\n    ".join(rows) + "\n};\n\n")


def product(function: str, rows: int, columns: int | None, stored: str | None = None, accumulate: bool = False,
            most: int = 4) -> str:
    """A function out = table · x (or out += …), with the table stored column by column.

    The inner loop runs over rows, so that a compiler that may not reorder sums can still use vector instructions. It
    takes four columns at a time, so that it need not wait for each sum.
    stored: the table's name; None: the table is the function's first argument.   columns: None: their number is an
    argument before x.   most: the largest number of columns; for fewer than four no loop over four is written, because
    compilers warn of it.
    """
    fours = columns is not None or most >= 4
    given = "" if stored else "const double *restrict table, "
    given += "int columns, " if columns is None else ""
    whole, table = "whole" if columns is None else str(columns - columns % 4), stored or "table"
    each = [f"{table}[{f'(q + {k})' if k else 'q'} * {rows} + i] * x[{f'q + {k}' if k else 'q'}]" for k in range(4)]
    over_rows = f"        for (i = 0; i < {rows}; i++)\n            out[i] += "
    lines = [f"static void {function}({given}const double *restrict x, double *restrict out)\n{{\n"]
    lines += ["    const int whole = columns - columns % 4;\n"] * (columns is None and fours) + ["    int i, q;\n"]
    if not accumulate:
        lines += [f"    for (i = 0; i < {rows}; i++)\n        out[i] = 0.0;\n"]
    lines += [f"    for (q = 0; q < {whole}; q += 4)\n{over_rows}({each[0]} + {each[1]})\n"
              f"                      + ({each[2]} + {each[3]});\n"] * fours
    if columns is None or columns % 4:
        end = "columns" if columns is None else columns
        lines += [f"    for (q = {whole if fours else 0}; q < {end}; q++)\n{over_rows}{each[0]};\n"]
    return "".join(lines) + "}\n\n"


def times(name: str, matrix: np.ndarray, note: str, accumulate: bool = False) -> str:
    """The table `name` (rows, columns) and the function `name_times` that multiplies it by a vector."""
    rows, columns = matrix.shape
    return table(name, matrix.T, f"{note}, column by column") + product(f"{name}_times", rows, columns, name,
                                                                        accumulate)


def comment(text: object) -> str:
    """The text as one line of ASCII that cannot end a C comment or begin another one."""
    plain = " ".join(str(text).encode("ascii", "replace").decode().split())
    return plain.replace("\\", "/").replace("??", "?").replace("*/", "* /").replace("/*", "/ *")


def identifier(name: str) -> str:
    """A model's name as prefix of C names and as file name: "SSMR (published)" → ssmr_published."""
    plain = re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_")
    return plain if plain and not plain[0].isdigit() else f"model_{plain}".rstrip("_")
