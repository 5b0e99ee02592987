"""A last line that was cut while it was written: a file without a final newline whose last cell is incomplete."""

from __future__ import annotations

import re
from collections.abc import Sequence

from ssmr_torch.recording_files.cells import is_number, number

NEIGHBOURS = 300     # rows before the last that tell what is usual
FEWEST = 4           # rows that there must be to tell
NEAR = 30            # rows before the last that tell how far a value steps
FAR = 5              # of the largest of these steps, beyond which a value is not its own
HELD = 3             # rows with one value, after which an unseen prefix of it is a cut


def is_cut(rows: Sequence[Sequence[str]], last: Sequence[str], decimal: str = ".") -> bool:
    """Whether the cells of a last line without newline are a line cut short.

    rows: cells of the rows before it. It is cut when it has fewer cells than they, when its last cell is no number or
    empty while theirs are numbers, when it has fewer digits than every other of its column, when it is shorter and far
    from the rows before, or when it is a beginning, never seen before, of a value that was held. Many exporters write
    no final newline, so a plausible line stays.
    """
    rows = [row for row in rows[-NEIGHBOURS:] if row]
    if not rows:
        return False
    width = max(map(len, rows))
    if len(last) < min(map(len, rows)):
        return True
    # A separator at the end of each row leaves an empty cell there.
    column = next((k for k in reversed(range(min(width, len(last)))) if any(row[k:k + 1] != [""] for row in rows)), 0)
    cells = [row[column].strip() for row in rows if len(row) > column]
    numeric = [cell for cell in cells if is_number(cell, decimal)]
    if len(numeric) < max(FEWEST, 0.9 * len(cells)):
        return False
    cell = last[column].strip()
    if not is_number(cell, decimal):
        return number(cell, decimal) is None or cell not in cells
    if cell[-1] in ".," and not any(other[-1] in ".," for other in numeric):
        return True
    return _is_shorter(cell, numeric) or _is_astray(cell, numeric, decimal) or _is_beginning(cell, numeric)


def digits(cell: str) -> int:
    """Digits after the decimal sign, and those of an exponent."""
    found = re.fullmatch(r"[+-]?\d*(?:[.,](\d*))?(?:[eE][+-]?(\d*))?", cell)
    return sum(len(part or "") for part in found.groups()) if found else 0


def _is_shorter(cell: str, cells: Sequence[str]) -> bool:
    """Fewer digits than any other value but zero; by two at least, unless all others have equally many."""
    counts = {digits(other) for other in cells if other.strip("+-0.,")}
    return bool(counts) and digits(cell) < min(counts) - (len(counts) > 1)


def _is_astray(cell: str, cells: Sequence[str], decimal: str) -> bool:
    values = [number(other, decimal) for other in cells[-NEAR:]]
    largest = max(abs(after - before) for before, after in zip(values, values[1:]))
    return len(cell) < len(cells[-1]) and abs(number(cell, decimal) - values[-1]) > FAR * largest > 0


def _is_beginning(cell: str, cells: Sequence[str]) -> bool:
    held = cells[-1] != cell and set(cells[-HELD:]) == {cells[-1]}
    return held and cells[-1].startswith(cell) and cell not in cells
