"""Units of recordings, and the values that give a wrong one away."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from pydantic import BeforeValidator, Field

from ssmr_torch.data.card_file import Card, not_as_described
from ssmr_torch.recording_clocks.clock_rules import INTERVAL
from ssmr_torch.recording_clocks.time_units import SYNONYMS, TIME_UNITS

UNITS = {"length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3}, "input": {"N": 1.0, "mN": 1e-3, "1": 1.0},
         "time": TIME_UNITS}
LARGEST_INPUT = {"N": 100.0, "1": 10.0}
SMALLEST_INPUT = 1e-2  # N; less moves hardly any soft robot
COLUMNS = {"length": "observations", "input": "inputs"}
CARD_KEYS = {"length": "range", "input": "largest_input"}


def _unit_of(key: str):
    def known(value):
        unit = SYNONYMS.get(str(value), str(value))  # YAML reads 1 as a number
        if unit not in UNITS[key]:
            raise not_as_described()
        return unit

    return Annotated[str, BeforeValidator(known), Field(description=f"one of {list(UNITS[key])}")]


class Units(Card):
    """Units of the file; everything becomes m, N and s. Input "1" stands for normalized commands.

    input_time: of the stamps of inputs in a file of their own; `time` by default.
    """

    part: ClassVar[str] = "units"

    length: _unit_of("length")
    input: _unit_of("input") = "N"
    time: _unit_of("time") = "s"
    input_time: _unit_of("time") | None = Field(None, description=f"one of {list(UNITS['time'])}")

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
    interval: tuple[float, float] = INTERVAL
    largest_input: float | None = None

    def bounds(self, key: str, unit: str) -> tuple[float, float]:
        """Smallest and largest plausible value, in SI units, of what a file holds in this unit."""
        if key == "input":
            return 0.0, self.largest_input or LARGEST_INPUT["1" if unit == "1" else "N"]
        return self.displacement

    def too_small(self, largest: float, units: Units) -> str:
        """What to say of a largest input, in N or 1, that is so small that its unit is doubtful; else ""."""
        if units.input != "mN" or not 0 < largest < SMALLEST_INPUT:
            return ""
        return (f"the largest input is {largest:.3g} N when the inputs are read in mN; expected at least "
                f"{SMALLEST_INPUT:g} N: if the file holds N, set units.input: N")

    def refuse(self, key: str, value: float, units: Units, quantity: str) -> None:
        """Raises ValueError, naming the units that are likelier, unless `value` (SI units) is plausible.

        key: "length" or "input"; times are judged where clocks are read, `time_units.refuse_implausible`.
        """
        unit = getattr(units, key)
        lowest, highest = self.bounds(key, unit)
        if lowest <= value <= highest:
            return
        inside = {"length": " m", "input": " N" if units.input_inside == "N" else ""}[key]
        raw = value / units.scale(key)
        likely = [name for name, scale in UNITS[key].items()
                  if self.bounds(key, name)[0] <= raw * scale <= self.bounds(key, name)[1]]
        guess = f"the {COLUMNS[key]} look like {' or '.join(likely)}" if likely else "no known unit makes it plausible"
        raise ValueError(f"{quantity} is {value:.3g}{inside} when the {COLUMNS[key]} are read in {unit}; expected "
                         f"between {lowest:g} and {highest:g}{inside}: {guess}. Correct units.{key}, or "
                         f"widen {CARD_KEYS[key]} where the value is true")
