"""Cells of text files: numbers, the words for absent values, and what is neither."""

from __future__ import annotations

import re

import numpy as np

# As good as an empty cell, in lower case: of Excel, MATLAB, C, R, SQL, Python, ROS and people.
ABSENT = frozenset((
    "", "nan", "+nan", "-nan", "nan(ind)", "-nan(ind)", "nan(snan)", "-nan(snan)", "1.#qnan", "-1.#qnan", "1.#snan",
    "1.#ind", "-1.#ind", "1.#qnan0", "-1.#ind00", "1.#ind00", "na", "n/a", "#n/a", "#n/a n/a", "<na>", "#na", "nil",
    "none", "null", "nat", "-", "--", "---", "–", "—", ".", "..", "?", "*", "missing", "undefined", "invalid", "\\n",
    "#value!", "#div/0!", "#ref!", "#num!", "#name?", "#null!"))
INFINITE = {"1.#inf": np.inf, "+1.#inf": np.inf, "-1.#inf": -np.inf, "1.#inf00": np.inf, "-1.#inf00": -np.inf}
THOUSANDS = re.compile(r"[+-]?\d{1,3}(?:([.,' \u00a0\u202f])\d{3})(?:\1\d{3})*(?:[.,]\d+)?")
DECIMALS = " (commas are decimal signs only where no cell has a decimal point)"


def number(cell: str, decimal: str = ".") -> float | None:
    """The number in a cell, NaN for a word that says that there is none; None for other text."""
    text = cell.strip().strip('"').strip()
    word = text.lower()
    if word in ABSENT:
        return np.nan
    if word in INFINITE:
        return INFINITE[word]
    if "_" in text or (decimal == "," and "." in text):  # Python's own 1_000; the sign of thousands
        return None
    try:
        return float(text.replace(",", ".")) if decimal == "," else float(text)
    except ValueError:
        return None


def is_number(cell: str, decimal: str = ".") -> bool:
    """Whether a cell holds a number, which an empty cell and the words for absent values do not."""
    found = number(cell, decimal)
    return found is not None and not np.isnan(found)


def why_no_number(cell: str) -> str:
    """What to add to "expected a number": nothing, or why a cell that looks like one is none."""
    text = cell.strip()
    if THOUSANDS.fullmatch(text) and number(text, ",") is None:
        return "; export without signs between thousands, as 1234.5"
    return DECIMALS if number(text, ",") is not None else ""


def numbers(column: np.ndarray, decimal: str = ".") -> np.ndarray:
    """A column of text as numbers (T,) float64; unchanged when one cell is no number, or when none is."""
    known: dict[object, float] = {}
    found = np.full(len(column), np.nan)
    for row, cell in enumerate(column):
        if cell not in known:
            value = np.nan if cell != cell else number(str(cell), decimal)
            if value is None:
                return column
            known[cell] = value
        found[row] = known[cell]
    return found
