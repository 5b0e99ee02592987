"""What became of an injected fault: the words for it, what was expected, and who judges."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

OUTCOMES = {
    "refused": "bad input was refused with one message that says what to do",
    "bridged": "the fault was found, said and mended, and the result is right",
    "counted": "the fault was found and said, what it spoilt was left out, and the rest is right",
    "survived": "the work went on, and the result is right",
    "wrong": "the result is wrong, or a refusal says too little, or nothing was said",
    "traceback": "an exception left the package that is none of its refusals",
    "hang": "it did not end in time",
}
BAD = ("wrong", "traceback", "hang")
LINES, LETTERS = 3, 480  # of a refusal; a line is wrapped at 160 letters at most
REFUSALS = (ValueError, OSError)  # what a command ends with in one message


@dataclass(frozen=True)
class Found:
    """The outcome of one trial. kind: of fault; case: which one exactly; said: the message, or what was wrong."""

    kind: str
    case: str
    outcome: str
    said: str = ""

    def __post_init__(self):
        if self.outcome not in OUTCOMES:
            raise ValueError(f"outcome is {self.outcome!r}; expected one of {', '.join(OUTCOMES)}")

    @property
    def good(self) -> bool:
        return self.outcome not in BAD

    def row(self) -> dict[str, str]:
        return {"kind": self.kind, "case": self.case, "outcome": self.outcome, "said": " ".join(self.said.split())}


@dataclass(frozen=True)
class Expected:
    """The right answer to a fault in recordings; each part that is given must hold.

    case: which fault exactly, with its places and sizes. refused: True where only a refusal is right, False where only
    reading is, None where either is. remedy: patterns of which a refusal must hold each. said: patterns of which the
    log must hold each when the recordings are read, and rows (first, last) to be named within `near`; where nothing is
    expected and `silent` is set, nothing may be said. samples: number by run, its pieces together, each within `near`
    where `near` is positive. error: the largest RMSE of the fit as a multiple of that of the clean recordings.
    values: (run, column, row, value in SI units, tolerance). timestep: s. names: of runs that must be among the
    others. unchanged: all runs must be as they were written.
    """

    case: str
    refused: bool | None = None
    remedy: tuple[str, ...] = ()
    said: tuple[str, ...] = ()
    rows: tuple[int, ...] = ()
    near: int = 0
    silent: bool = False
    samples: Mapping[str, int] = field(default_factory=dict)
    error: float | None = None
    values: tuple[tuple[str, int, int, float, float], ...] = ()
    timestep: float | None = None
    names: tuple[str, ...] = ()
    unchanged: bool = False


def refusal_faults(message: str) -> str:
    """What is wrong with the message of a refusal; "" where nothing is."""
    if not message.strip():
        return "the refusal says nothing"
    if len(message.splitlines()) > LINES or len(message) > LETTERS:
        return f"the refusal has {len(message.splitlines())} lines and {len(message)} letters: {message[:200]}"
    return ""


def counts(found: Iterable[Mapping]) -> list[dict]:
    """The table: a row for each kind in the order in which it first appears, a column for each outcome, and a sum."""
    found = list(found)
    kinds = list(dict.fromkeys(each["kind"] for each in found))
    rows = [{"kind": kind, "trials": sum(each["kind"] == kind for each in found)}
            | {outcome: sum(each["kind"] == kind and each["outcome"] == outcome for each in found)
               for outcome in OUTCOMES} for kind in kinds]
    total = {column: sum(row[column] for row in rows) for column in ("trials", *OUTCOMES)}
    return [*rows, {"kind": "all"} | total] if rows else []
