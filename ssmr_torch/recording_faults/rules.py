"""`FaultRules`: what is done about each kind of fault."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Self

CHOICES = {
    "unwritten_rows": ("cut", "refuse", "keep"),
    "lost_markers": ("bridge", "cut", "refuse", "keep"),
    "exchanged_markers": ("cut", "correct", "refuse", "keep"),
    "outliers": ("bridge", "cut", "refuse", "keep"),
    "held_values": ("bridge", "cut", "refuse", "keep"),
    "slow_camera": ("refuse", "bridge", "thin", "keep"),
    "dead_columns": ("refuse", "keep"),
    "wrong_units": ("refuse", "keep"),
    "rest_position": ("refuse", "keep"),
    "moving_decays": ("refuse", "keep"),
    "drift": ("keep", "remove", "refuse"),
    "copies": ("refuse", "keep"),
}
MISSING = ("refuse", "split", "bridge")
FEW = 50            # rows of the longest run, below which nothing is refused by a comparison
BY_COMPARISON = ("slow_camera", "dead_columns", "wrong_units", "rest_position", "moving_decays", "copies")


@dataclass(frozen=True)
class FaultRules:
    """One rule for each fault, in the order in which faults are looked for.

    bridge: short stretches are filled from the motion around them, longer ones are cut out; the run ends before them
    and another begins after them. cut: the rows are cut out, however few. refuse: ValueError. keep: said only.
    correct, thin, remove: the markers are exchanged back, held rows are left out, the trend is subtracted.
    Raises ValueError for an unknown rule, with those that are known.
    """

    unwritten_rows: str = "cut"
    lost_markers: str = "bridge"
    exchanged_markers: str = "cut"
    outliers: str = "bridge"
    held_values: str = "bridge"
    slow_camera: str = "refuse"
    dead_columns: str = "refuse"
    wrong_units: str = "refuse"
    rest_position: str = "refuse"
    moving_decays: str = "refuse"
    drift: str = "keep"
    copies: str = "refuse"

    def __post_init__(self):
        for field in fields(self):
            value, known = getattr(self, field.name), CHOICES[field.name]
            if value not in known:
                raise ValueError(f"faults.{field.name} is {value!r}; expected one of {', '.join(known)}")

    @classmethod
    def of(cls, given: Mapping[str, str], rows: int = FEW) -> Self:
        """The rules that are given by name, and the defaults of the others.

        rows: of the longest run. Statistics need samples: below `FEW` rows, what is refused by comparison by default is
        kept and said. Raises ValueError for an unknown fault or rule.
        """
        unknown = [str(key) for key in given if key not in CHOICES]
        if unknown:
            raise ValueError(f"faults has the unknown key {unknown[0]!r}; known keys: {', '.join(CHOICES)}")
        few = dict.fromkeys(BY_COMPARISON, "keep") if rows < FEW else {}
        return cls(**few | dict(given))
