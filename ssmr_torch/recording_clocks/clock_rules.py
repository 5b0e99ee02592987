"""`ClockRules`: where a run's clock stands and what to do with its faults; `Clock`: the seconds that came of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ssmr_torch.recording_clocks.time_units import TIME_UNITS
from ssmr_torch.recording_files.note import Note

STAMPS = ("as_given", "even")
SAME_STAMP = ("refuse", "first", "last")
INTERVAL = (1e-4, 0.5)  # s, smallest and largest plausible sampling interval of a soft robot's recording


@dataclass(frozen=True)
class ClockRules:
    """What is known of a clock.

    time: name of the column of stamps, which count in `unit`; two names are seconds and nanoseconds, or a date and a
    time of day. frame: name of a column of frame numbers instead, of which `rate` pass in 1 s. Neither: samples are
    `interval` s apart. stamps: "as_given", or "even": spread evenly over the rows, whose order is taken as true.
    same_stamp: "refuse" rows that share a stamp but not their values, or keep the "first" or the "last" of them.
    bounds: s, plausible median intervals. outputs, inputs: names of the columns that hold them.
    Raises ValueError for rules that contradict each other.
    """

    time: str | tuple[str, ...] | None = None
    unit: str = "s"
    interval: float | None = None
    frame: str | None = None
    rate: float | None = None
    stamps: str = "as_given"
    same_stamp: str = "refuse"
    bounds: Sequence[float] = INTERVAL
    outputs: tuple[str, ...] = ()
    inputs: tuple[str, ...] = ()

    def __post_init__(self):
        for key, value, known in (("stamps", self.stamps, STAMPS), ("same_stamp", self.same_stamp, SAME_STAMP),
                                  ("units.time", self.unit, tuple(TIME_UNITS))):
            if value not in known:
                raise ValueError(f"{key} is {value!r}; expected one of {list(known)}")
        if self.rate is not None and not 0 < self.rate < np.inf:
            raise ValueError(f"rate is {self.rate!r}; expected frames per second, a positive number")


class Clock(NamedTuple):
    """time: (T,) s. rows: (T,) rows of the table, from 0, in the order of time. notes: what was found and done.
    origin: s, what was subtracted from the stamps, exact in ns as an integer.
    """

    time: np.ndarray
    rows: np.ndarray
    notes: tuple[Note, ...]
    origin: int = 0


def typical_step(time: np.ndarray) -> float:
    """Interval between samples, s: the median of the rising steps."""
    steps = np.diff(time)
    return float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
