"""Data sheets: how the public objects print, as a tree in a terminal and as a table in a notebook.

>>> print(text("Robot: 2 cables", {"period": period(0.02), "outputs": listed(["x", "y"]), "range": {"x": "±1 mm"}}))
Robot: 2 cables
├─ period: 0.02 s (50 Hz)
├─ outputs: x, y
└─ range
   └─ x: ±1 mm
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from math import isfinite, isnan

MOST = 6  # largest number of names and ranges that are listed


class DataSheet:
    """Base class of objects that print as a data sheet.

    A subclass returns the content by `data_sheet()` → (title, entries). entries map a label to a text, or to further
    entries below it.
    """

    def __init_subclass__(cls, **options):
        super().__init_subclass__(**options)
        if "__repr__" not in vars(cls):
            cls.__repr__ = DataSheet.__repr__  # otherwise a dataclass adds its own

    def data_sheet(self) -> tuple[str, Mapping]:
        """Title and entries of the sheet."""
        raise NotImplementedError(f"{type(self).__name__} lacks data_sheet()")

    def __repr__(self) -> str:
        return text(*self.data_sheet())

    def _repr_html_(self) -> str:
        return html(*self.data_sheet())


def text(title: str, entries: Mapping) -> str:
    """The sheet as a tree, one entry per line."""
    return "\n".join([title, *_branches(entries)])


def _branches(entries: Mapping) -> list[str]:
    lines = []
    for number, (label, value) in enumerate(entries.items(), start=1):
        stem, below = ("└─ ", "   ") if number == len(entries) else ("├─ ", "│  ")
        if isinstance(value, Mapping):
            lines += [stem + label, *(below + line for line in _branches(value))]
        else:
            lines.append(f"{stem}{label}: {value}")
    return lines


def html(title: str, entries: Mapping) -> str:
    """The sheet as an HTML table, one row per entry; entries below another entry are indented. Texts are escaped."""
    rows = "".join(_rows(entries, 0))
    return f"<table><thead><tr><th colspan='2'>{escape(title)}</th></tr></thead><tbody>{rows}</tbody></table>"


def _rows(entries: Mapping, depth: int) -> Iterable[str]:
    for label, value in entries.items():
        nested = isinstance(value, Mapping)
        yield (f"<tr><td style='text-align:left;padding-left:{1 + depth}em'>{escape(label)}</td>"
               f"<td style='text-align:left'>{'' if nested else escape(str(value))}</td></tr>")
        if nested:
            yield from _rows(value, depth + 1)


def columns(rows: Sequence[Sequence[str]]) -> str:
    """A table as text. The first row is the header; the first column is aligned left, the others right."""
    widths = [max(map(len, column)) for column in zip(*rows)]
    lines = ["  ".join(cell.rjust(width) if place else cell.ljust(width)
                       for place, (cell, width) in enumerate(zip(row, widths))).rstrip() for row in rows]
    return "\n".join([lines[0], "-" * max(map(len, lines)), *lines[1:]])


def html_columns(rows: Sequence[Sequence[str]], caption: str) -> str:
    """The same table in HTML, with its caption."""
    head, *body = [[escape(cell) for cell in row] for row in rows]
    lines = ["<tr>" + "".join(f"<td>{cell}</td>" for cell in row) + "</tr>" for row in body]
    return (f"<table><caption>{escape(caption)}</caption><thead><tr>" + "".join(f"<th>{cell}</th>" for cell in head)
            + "</tr></thead><tbody>" + "".join(lines) + "</tbody></table>")


def number(value: float, digits: int = 3) -> str:
    """A number with this many significant digits; ∞ for an infinite number."""
    value = float(value)
    if not isfinite(value):
        return "not a number" if value != value else "∞" if value > 0 else "−∞"
    rounded = f"{value:.{digits}g}"
    return "0" if float(rounded) == 0 else f"{float(rounded):.0f}" if abs(float(rounded)) >= 10**digits else rounded


def period(seconds: float) -> str:
    """A period and its rate, for example "0.02 s (50 Hz)"."""
    return f"{number(seconds)} s ({number(1.0 / seconds)} Hz)"


def span(low: float, high: float, unit: str, scale: float = 1.0) -> str:
    """A range, for example "-3 … 2.5 mm". scale: factor that converts the values to the unit."""
    return f"{number(scale * low)} … {number(scale * high)}{unit and ' ' + unit}"


def listed(names: Iterable) -> str:
    """A list of names or numbers; of a long list, the first ones and the total number."""
    names = [str(name) for name in names]
    shown = ", ".join(names if len(names) <= MOST + 1 else names[:MOST])
    return shown if len(names) <= MOST + 1 else f"{shown}, … ({len(names)})"


def spans(names: Sequence[str], low: Sequence[float], high: Sequence[float], unit: str, scale: float = 1.0) -> dict:
    """The range of each of these quantities; of a long list, the first ones."""
    ranges = {name: span(one, other, unit, scale) for name, one, other in zip(names, low, high)}
    if len(ranges) <= MOST + 1:
        return ranges
    return dict(list(ranges.items())[:MOST]) | {"…": f"{len(ranges) - MOST} more"}


def stability(rates: Iterable[complex]) -> str:
    """Text on how fast the slowest mode decays, from rates in 1/s. Rates of zero, which belong to constants, are left
    out.
    """
    rates = [complex(rate) for rate in rates]
    if any(isnan(abs(rate)) for rate in rates):
        return "not known"
    slowest = max((rate for rate in rates if abs(rate) > 1e-9), key=lambda rate: rate.real, default=None)
    if slowest is None:
        return "no mode moves"
    turning = f" ± {number(abs(slowest.imag))}i" if abs(slowest.imag) > 1e-9 else ""
    verdict = "margin" if slowest.real < 0 else "unstable"
    return f"{verdict} {number(abs(slowest.real))} 1/s, slowest mode {number(slowest.real)}{turning} 1/s"


def unit_of(input_unit: str) -> str:
    """An input's unit as it is printed: empty for normalized commands."""
    return "" if input_unit == "1" else input_unit


def origin(provenance: Mapping) -> dict[str, str]:
    """Short entries for a provenance: reader or plant, files with the start of their SHA-256, version and commit."""
    found = {}
    reader = provenance.get("reader") or (f"plant {_name(provenance['plant'])}" if provenance.get("plant") else None)
    if reader:
        found["from"] = str(reader)
    sources = provenance.get("sources") or {}
    if isinstance(provenance.get("stored"), Mapping):
        found["file"] = _digests(provenance["stored"])
    elif sources:
        found["sources"] = _digests(sources)
    made = " ".join(str(provenance[key]) for key in ("package", "commit") if provenance.get(key))
    if made or provenance.get("version"):
        found["made by"] = made or f"ssmr_torch {provenance['version']}"
    return found


def _name(plant) -> str:
    return str(plant.get("class", "")).rpartition(".")[2] if isinstance(plant, Mapping) else str(plant)


def _digests(files: Mapping) -> str:
    first = [f"{name} ({str(digest)[:8]})" for name, digest in list(files.items())[:3]]
    return ", ".join(first) + (f", … ({len(files)})" if len(files) > 3 else "")
