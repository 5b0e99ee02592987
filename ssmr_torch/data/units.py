"""Units of recordings, and the values that give a wrong one away."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from pydantic import BeforeValidator, Field

from ssmr_torch.data.card_file import Card, not_as_described

UNITS = {"length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3}, "input": {"N": 1.0, "mN": 1e-3, "1": 1.0},
         "time": {"s": 1.0, "ms": 1e-3}}
LARGEST_INPUT = {"N": 100.0, "1": 10.0}
SMALLEST_INPUT = 1e-2  # N; less moves hardly any soft robot
COLUMNS = {"length": "observations", "input": "inputs", "time": "times"}
CARD_KEYS = {"length": "range", "input": "largest_input", "time": "interval_range"}


def _unit_of(key: str):
    def known(value):
        if str(value) not in UNITS[key]:
            raise not_as_described()
        return str(value)  # YAML reads 1 as a number

    return Annotated[str, BeforeValidator(known), Field(description=f"one of {list(UNITS[key])}")]


class Units(Card):
    """Units of the file; everything becomes m, N and s. Input "1" stands for normalized commands."""

    part: ClassVar[str] = "units"

    length: _unit_of("length")
    input: _unit_of("input") = "N"
    time: _unit_of("time") = "s"

    @property
    def input_inside(self) -> str:
        """The unit of inputs in the dataset, "N" or "1"."""
        return "1" if self.input == "1" else "N"

    def scale(self, key: str) -> float:
        return UNITS[key][getattr(self, key)]


@dataclass(frozen=True)
class Plausible:
    """What a soft robot does; values outside come from a wrong unit.

    displacement: smallest and largest peak displacement from rest, m. interval: smallest and largest median
    sampling interval, s. largest_input: of any |input|, N or 1; None takes 100 N, or 10 for normalized commands.
    """

    displacement: tuple[float, float] = (1e-3, 2.0)
    interval: tuple[float, float] = (1e-4, 0.5)
    largest_input: float | None = None

    def bounds(self, key: str, unit: str) -> tuple[float, float]:
        """Smallest and largest plausible value, in SI units, of what a file holds in this unit."""
        if key == "input":
            return 0.0, self.largest_input or LARGEST_INPUT["1" if unit == "1" else "N"]
        return self.displacement if key == "length" else self.interval

    def too_small(self, largest: float, units: Units) -> str:
        """What to say of a largest input, in N or 1, that is so small that its unit is doubtful; else ""."""
        if units.input != "mN" or not 0 < largest < SMALLEST_INPUT:
            return ""
        return (f"the largest input is {largest:.3g} N when the inputs are read in mN; expected at least "
                f"{SMALLEST_INPUT:g} N: if the file holds N, set units.input: N")

    def refuse(self, key: str, value: float, units: Units, quantity: str) -> None:
        """Raises ValueError, naming the units that are likelier, unless `value` (SI units) is plausible."""
        unit = getattr(units, key)
        lowest, highest = self.bounds(key, unit)
        if lowest <= value <= highest:
            return
        inside = {"length": " m", "time": " s", "input": " N" if units.input_inside == "N" else ""}[key]
        raw = value / units.scale(key)
        likely = [name for name, scale in UNITS[key].items()
                  if self.bounds(key, name)[0] <= raw * scale <= self.bounds(key, name)[1]]
        guess = f"the {COLUMNS[key]} look like {' or '.join(likely)}" if likely else "no known unit makes it plausible"
        raise ValueError(f"{quantity} is {value:.3g}{inside} when the {COLUMNS[key]} are read in {unit}; expected "
                         f"between {lowest:g} and {highest:g}{inside}: {guess}. Correct units.{key}, or "
                         f"widen {CARD_KEYS[key]} where the value is true")
