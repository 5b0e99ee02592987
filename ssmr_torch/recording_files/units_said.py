"""Units as files say them: in a row below the names, in a name such as "x [mm]", or as an attribute."""

from __future__ import annotations

import re
from collections.abc import Iterable

# What files write, in lower case → the name of the unit.
SPELT = {
    "m": ("m", "meter", "meters", "metre", "metres"), "cm": ("cm", "centimeter", "centimeters", "centimetres"),
    "mm": ("mm", "millimeter", "millimeters", "millimetre", "millimetres"),
    "um": ("um", "µm", "μm", "micrometer", "micrometers", "micron", "microns"),
    "in": ("in", "inch", "inches"), "ft": ("ft", "foot", "feet"),
    "N": ("n", "newton", "newtons"), "kN": ("kn", "kilonewton"), "lbf": ("lbf",),
    "s": ("s", "sec", "secs", "second", "seconds"), "min": ("min", "minute", "minutes"),
    "ms": ("ms", "msec", "millisecond", "milliseconds"),
    "us": ("us", "µs", "μs", "usec", "microsecond", "microseconds"),
    "ns": ("ns", "nsec", "nanosecond", "nanoseconds"), "Hz": ("hz",), "frames": ("frame", "frames"),
    "deg": ("deg", "degree", "degrees", "°"), "rad": ("rad", "radian", "radians"), "V": ("v", "volt", "volts"),
    "mV": ("mv",), "A": ("a", "ampere", "amperes"), "mA": ("ma",), "%": ("%", "percent"), "bar": ("bar",),
    "mbar": ("mbar",), "psi": ("psi",), "Pa": ("pa", "pascal"), "hPa": ("hpa",), "kPa": ("kpa",), "°C": ("°c", "degc"),
    "m/s": ("m/s",), "mm/s": ("mm/s",), "m/s²": ("m/s^2", "m/s2", "m/s²"), "rad/s": ("rad/s",), "1/s": ("1/s",),
}
CASED = {"mN": ("mN", "millinewton", "millinewtons"), "Nm": ("Nm", "N·m", "N*m"), "Nmm": ("Nmm", "N·mm", "N.mm"),
         "MPa": ("MPa",), "1": ("1", "normalized")}  # where the case counts
NAMES = {spelling: unit for table in (SPELT, CASED) for unit, spellings in table.items() for spelling in spellings}
DIMENSIONS = {"length": ("m", "cm", "mm", "um", "in", "ft"), "force": ("N", "mN", "kN", "lbf"),
              "time": ("s", "ms", "us", "ns", "min")}
IN_NAME = re.compile(r"(?:\[([^\[\]]{1,30})\]|\(([^()]{1,30})\)|\{([^{}]{1,30})\})$")
SINCE = re.compile(r"^(\w+) since .*$")
BLANK = ("", "-", "–", "none", "n/a")  # what stands in a row of units where there is none
BRACKETS = str.maketrans("", "", "[](){}<>")


def unit_called(said: object) -> str | None:
    """The name of the unit that a text says, such as "mm" for "Millimeters" or "[mm]"; None when it is not known."""
    text = str(said).strip().translate(BRACKETS).strip()
    since = SINCE.match(text)  # "seconds since 1970-01-01", as NetCDF says it
    text = since.group(1) if since else text
    return NAMES.get(text, NAMES.get(text.lower()))


def split_unit(name: str) -> tuple[str, str | None]:
    """A column's name without its unit, and the unit: ("x", "mm") of "x [mm]", ("x", None) of "x"."""
    name = name.strip()
    found = IN_NAME.search(name[-40:])
    unit = found and unit_called(next(filter(None, found.groups()), ""))
    bare = name.removesuffix(found.group()).strip() if unit and unit != "1" else ""
    return (bare, unit) if bare else (name, None)


def units_in_names(names: Iterable[str]) -> dict[str, str]:
    """Unit by name, of the names that say one."""
    return {name: unit for name in names if (unit := split_unit(name)[1])}


def says_units(cells: Iterable[str]) -> bool:
    """Whether every cell that is not blank is a unit, and one at least is another than "1"."""
    said = {unit_called(cell) for cell in cells if cell.strip().translate(BRACKETS).lower() not in BLANK}
    return None not in said and bool(said - {"1"})


def dimension(unit: str) -> str | None:
    """"length", "force" or "time"; None for other units."""
    return next((name for name, units in DIMENSIONS.items() if unit in units), None)
