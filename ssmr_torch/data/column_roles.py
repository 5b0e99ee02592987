"""`roles`: what the columns of a recording are, guessed by their names and by how they change."""

from __future__ import annotations

import re
from typing import NamedTuple

import numpy as np

from ssmr_torch.data.units import UNITS, Plausible
from ssmr_torch.recording_files.table import Table
from ssmr_torch.recording_files.units_said import split_unit

TIMES = re.compile(r"(?:_*t|_*times?|.*timestamps?|.*stamp|zeit|secs?|seconds|clock|%?time|elapsed.*)", re.IGNORECASE)
FRAMES = re.compile(r"(?:sub ?)?frames?(?: ?(?:no|number|#))?|index|(?:field\.header\.)?seq|sample|id|received|"
                    r"column 1", re.IGNORECASE)
INPUTS = re.compile(r"(?:u|c|cmd|command|input|control|valve|motor|pwm|pressure|tau|torque|setpoint|actuator|cable|"
                    r"tendon|tension|voltage|current|data|effort|f|fx|fy|fz|force)s?(?:[\W_]*\d*)*", re.IGNORECASE)
AXES = re.compile(r"(?:.*[\W_]|[a-z]?)[xyz](?:[\W_]*\d*)*", re.IGNORECASE)
ASIDE = re.compile(r".*(?:rotation|orientation|quaternion|quality|error|residual|velocity|twist).*", re.IGNORECASE)
HELD = 0.5           # share of rows that repeat the row before, from which a column is an input
SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}


class Roles(NamedTuple):
    """Names of the columns: time (None: there is none), observation, input. seconds: (T,), of the column of time, with
    its unit. frames: whether the column of time counts frames. unsure: the roles that rest on how columns change only.
    """

    time: str | None
    observation: list[str]
    input: list[str]
    seconds: np.ndarray | None = None
    unit: str | None = None
    frames: bool = False
    unsure: tuple[str, ...] = ()


def roles(table: Table) -> Roles:
    """What the columns of a table are likely to be; a person corrects it."""
    numeric = {name: column for name, column in table.columns.items() if column.dtype.kind in "fiub"}
    time = next((name for name, column in numeric.items() if TIMES.fullmatch(_bare(name)) and _rises(column)), None)
    unit, seconds = _seconds(numeric[time], table.units.get(time)) if time else (None, None)
    free = {name: column for name, column in numeric.items()
            if name != time and not FRAMES.fullmatch(_bare(name)) and not TIMES.fullmatch(_bare(name))
            and not ASIDE.fullmatch(name) and np.isfinite(column).any()}
    inputs = [name for name in free if INPUTS.fullmatch(_bare(name))]
    rest = {name: column for name, column in free.items() if name not in inputs}
    unsure = []
    if not inputs:
        inputs = [name for name, column in rest.items() if _held(column)]
        inputs = inputs if len(inputs) < len(rest) else []
        unsure = ["input"] if inputs else []
    outputs = [name for name in rest if name not in inputs]
    axes = [name for name in outputs if AXES.fullmatch(_bare(name))]
    if not axes and outputs:
        unsure.append("observation")
    return Roles(time, axes or outputs, inputs, seconds, unit, _counts(numeric[time]) if time else False, tuple(unsure))


def _bare(name: str) -> str:
    """A name without its unit and what stands before it: "x" of "tip/pose/position/x", "u_0" of "r1/u_0"."""
    parts = re.split(r"[/:]", split_unit(name)[0])
    return "/".join(parts[-2:]) if parts[-1].isdigit() and len(parts) > 1 else parts[-1]


def _rises(column: np.ndarray) -> bool:
    steps = np.diff(column.astype(np.float64))
    return len(steps) > 0 and bool(np.mean(steps > 0) > 0.5)


def _counts(column: np.ndarray) -> bool:
    steps = np.diff(column.astype(np.float64))
    return bool(len(steps)) and bool((steps == 1).mean() > 0.9)


def _held(column: np.ndarray) -> bool:
    return bool((np.diff(column) == 0).mean() > HELD) if len(column) > 1 else False


def _seconds(column: np.ndarray, said: str | None) -> tuple[str | None, np.ndarray]:
    """The unit of a column of time, said or that which makes its steps plausible, and the column in s from its start.
    """
    start = column[0]
    shifted = (column - start).astype(np.float64)
    step = np.median(np.diff(shifted)) if len(column) > 1 else 0.0
    lowest, highest = Plausible.interval
    fitting = [unit for unit, scale in SECONDS.items() if lowest <= step * scale <= highest]
    unit = said if said in SECONDS else next(iter(fitting), None)
    return unit, shifted * SECONDS.get(unit or "s", 1.0)


def length_unit(table: Table, names: list[str]) -> tuple[str, bool]:
    """The unit of positions, and whether the file says it; else mm for motions of 1 and more, m for smaller ones."""
    said = {table.units.get(name) for name in names} - {None}
    if len(said) == 1 and (unit := said.pop()) in UNITS["length"]:
        return unit, True
    with np.errstate(invalid="ignore"):
        extents = [np.nanmax(table.columns[name]) - np.nanmin(table.columns[name]) for name in names]
    return ("mm" if max(extents, default=0.0) >= 1 else "m"), False


def input_unit(table: Table, names: list[str]) -> tuple[str, bool]:
    """The unit of inputs, and whether the file says it; else 1, N or mN by their size."""
    said = {table.units.get(name) for name in names} - {None}
    if len(said) == 1 and (unit := said.pop()) in UNITS["input"]:
        return unit, True
    largest = max((float(np.nanmax(np.abs(table.columns[name]))) for name in names), default=0.0)
    return "1" if largest <= 10 else "N" if largest <= 100 else "mN", False
