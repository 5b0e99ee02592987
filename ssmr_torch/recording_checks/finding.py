"""`Finding`: the result of one recording check, with its severity, a number, and what to do."""

from __future__ import annotations

from dataclasses import dataclass, field

GOOD, LOOK, MISSING, UNTOLD = "good", "warning", "missing", "unknown"
SEVERITIES = (GOOD, LOOK, MISSING, UNTOLD)


@dataclass(frozen=True)
class Finding:
    """One subject of the check.

    severity: "good", "warning", "missing", or "unknown" if these recordings do not show it. said: one sentence with the
    number. remedy: one sentence on what to do; empty if there is nothing to do. numbers: plain values, SI units.
    curves: arrays for the figure.
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
            raise ValueError(f"{self.subject} is {self.severity!r}, but has no remedy; give one sentence on what to do")

    def __str__(self) -> str:
        return f"{self.severity}: {self.said}{f' {self.remedy}' if self.remedy else ''}"


def graded(value: float, look: float, missing: float) -> str:
    """Severity of a number that should be small: a warning above `look`, missing above `missing`."""
    return GOOD if value <= look else LOOK if value <= missing else MISSING


def millimetres(value: float) -> str:
    """A length in m as text in mm, three digits."""
    return f"{1e3 * float(value):.3g} mm"
