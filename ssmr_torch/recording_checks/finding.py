"""What a check of recordings finds: one subject, a number, and what to do about it."""

from __future__ import annotations

from dataclasses import dataclass, field

GOOD, LOOK, MISSING, UNTOLD = "good", "look here", "missing", "cannot be told"
SEVERITIES = (GOOD, LOOK, MISSING, UNTOLD)


@dataclass(frozen=True)
class Finding:
    """One subject of the check.

    severity: "good", "look here", "missing", or "cannot be told" from these recordings. said: one sentence with the
    number. remedy: one sentence, empty where there is nothing to do. numbers: plain values, SI units. curves: arrays
    for the figure.
    """

    subject: str
    severity: str
    said: str
    remedy: str = ""
    numbers: dict = field(default_factory=dict)
    curves: dict = field(default_factory=dict, repr=False, compare=False)

    def __post_init__(self):
        if self.severity not in SEVERITIES:
            raise ValueError(f"{self.subject}: severity {self.severity!r}; expected one of {SEVERITIES}")
        if self.severity != GOOD and not self.remedy:
            raise ValueError(f"{self.subject} is {self.severity!r}, but names no remedy")

    def __str__(self) -> str:
        return f"{self.severity}: {self.said}{f' {self.remedy}' if self.remedy else ''}"


def graded(value: float, look: float, missing: float) -> str:
    """Severity of a number of which less is better: above `look`, above `missing`."""
    return GOOD if value <= look else LOOK if value <= missing else MISSING


def millimetres(value: float) -> str:
    """A length in m as text in mm, three digits."""
    return f"{1e3 * float(value):.3g} mm"
