"""`Note`: what was found in a recording, and what was done about it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

MOST_STRETCHES = 60
ACTIONS = ("kept", "dropped", "bridged", "cut", "corrected")


@dataclass(frozen=True)
class Note:
    """One fault of one run.

    run: its name. kind: the fault in a few words, such as "outliers". said: one sentence with the numbers and the
    remedy. done: one of `ACTIONS`; "kept" is a warning, because the data are unchanged. rows: rows of the file, from 0,
    of which `said` names the first. numbers: plain values, SI units.
    Raises ValueError for an unknown action.
    """

    run: str
    kind: str
    said: str
    done: str = "kept"
    rows: tuple[int, ...] = ()
    numbers: dict = field(default_factory=dict)

    def __post_init__(self):
        if self.done not in ACTIONS:
            raise ValueError(f"{self.run}: {self.kind} was {self.done!r}; expected one of {ACTIONS}")
        object.__setattr__(self, "rows", tuple(int(row) for row in self.rows))

    def __str__(self) -> str:
        return f"{self.run}: {self.said}"

    def as_dict(self) -> dict:
        """Plain values, for the provenance; of the rows, how many they are and the first `MOST_STRETCHES` stretches."""
        return {"run": self.run, "kind": self.kind, "said": self.said, "done": self.done, "count": len(set(self.rows)),
                "rows": stretches(self.rows)[:MOST_STRETCHES], "numbers": self.numbers}


def stretches(rows: Sequence[int]) -> list[list[int]]:
    """Rows as stretches [first, last] of consecutive numbers."""
    found: list[list[int]] = []
    for row in sorted(set(rows)):
        if found and row == found[-1][1] + 1:
            found[-1][1] = row
        else:
            found.append([row, row])
    return found


def rows_said(rows: Sequence[int], most: int = 4) -> str:
    """Rows in words: "row 7", or "rows 3, 10..14 and 6 more stretches"."""
    parts = [str(first) if first == last else f"{first}..{last}" for first, last in stretches(rows)]
    if len(parts) > most:
        parts = [*parts[:most - 1], f"{len(parts) - most + 1} more stretches"]
    joined = parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"
    return f"{'row' if len(rows) == 1 else 'rows'} {joined}"
