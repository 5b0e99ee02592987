"""One benchmark → one table: printed row by row, and kept as CSV and JSON with the machine, its load and provenance.

A benchmark is a module of this room with a function `rows(**settings)`, which yields a mapping for each row of the
table and a text for each remark. It raises `BenchmarkFailed` after its rows where what it measures is not accepted.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

from ssmr_torch import data_sheet as sheet
from ssmr_torch.benchmarks.machine import in_words, load, machine
from ssmr_torch.result_files import save_csv, save_json

DIGITS = 4
WIDTH_OF_TEXT, WIDTH_OF_NUMBER = 28, 8


class BenchmarkFailed(ValueError):
    """What a benchmark measured is not accepted; the message says what and by how much."""


def tabulate(name: str, made: Iterable[Mapping | str], settings: Mapping, directory: Path, provenance: Mapping,
             say: Callable[[str], None] = print) -> list[dict]:
    """Print what a benchmark yields, and keep it in directory/NAME.csv and NAME.json, complete after every row.

    The JSON holds settings, machine, load before and after, rows, remarks, why it failed (or null), provenance.
    Returns the rows. Raises `BenchmarkFailed` as the benchmark does, when all is saved.
    """
    rows, remarks, before = [], [], machine()
    report = {"benchmark": name, "settings": dict(settings), "machine": before, "load": {"before": before["load"]},
              "rows": rows, "remarks": remarks, "failed": None, "provenance": dict(provenance)}
    say(in_words(before))
    try:
        for each in made:
            if isinstance(each, str):
                remarks.append(each)
                say(each)
                continue
            rows.append(dict(each))
            say("\n".join(lines_of(rows)))
            _save(directory, name, report)
    except BenchmarkFailed as failure:
        report["failed"] = str(failure)
        raise
    finally:
        _save(directory, name, report)
    say(str(directory / f"{name}.json"))
    return rows


def lines_of(rows: list[dict]) -> list[str]:
    """The last row as text, with the header above it where it is the first, or has other columns than the one before.

    >>> print(*lines_of([{"solver": "proxqp", "CPU, ms": 0.12345, "failures": 0, "ratio": None}]), sep="\\n")
    solver                         CPU, ms  failures     ratio
    proxqp                          0.1235         0         –
    """
    last, head = rows[-1], []
    if len(rows) == 1 or list(rows[-2]) != list(last):
        head = ["  ".join(_aligned(column, column, value) for column, value in last.items()).rstrip()]
    return [*head, "  ".join(_aligned(column, cell(value), value) for column, value in last.items()).rstrip()]


def cell(value) -> str:
    """One value as text: – for None, yes or no for a truth value, four digits of a number with a point."""
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return sheet.number(value, DIGITS) if isinstance(value, float) else str(value)


def _aligned(column: str, text: str, value) -> str:
    if isinstance(value, str):
        return text.ljust(max(WIDTH_OF_TEXT, len(column)))
    return text.rjust(max(WIDTH_OF_NUMBER, len(column)))


def _save(directory: Path, name: str, report: dict) -> None:
    report["load"]["after"] = load()
    save_csv(directory / f"{name}.csv", report["rows"])
    save_json(directory / f"{name}.json", report)
