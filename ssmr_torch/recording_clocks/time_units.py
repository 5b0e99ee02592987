"""Units of time, exact seconds of stamps, and which unit or meaning stamps are likelier to have."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "d": 86400.0}
SYNONYMS = {"µs": "us", "μs": "us", "sec": "s", "second": "s", "seconds": "s", "msec": "ms", "milliseconds": "ms",
            "usec": "us", "microseconds": "us", "nsec": "ns", "nanoseconds": "ns", "minutes": "min", "days": "d"}
EXACT = 2 ** 40         # integers beyond lose digits as float64 seconds, so that the first is subtracted before
FEW = 10                # whole steps smaller than this may number frames
STEADY = 0.95           # share of the steps that are alike, where numbers count frames
FIRST = 2               # a count begins at 0 or 1


def exact_seconds(stamps: np.ndarray, unit: str) -> tuple[np.ndarray, int]:
    """Seconds (T,) of stamps in `unit`, and the stamp that was subtracted from them, 0 where none had to be.

    Differences of integers are exact: those of an epoch in ns are taken before they become float64.
    """
    scale = TIME_UNITS[unit]
    if stamps.dtype.kind in "iu" and len(stamps) and int(np.abs(stamps.astype(np.float64)).max()) >= EXACT:
        first = int(stamps[0])
        return scale * (stamps.astype(np.int64) - first).astype(np.float64), first
    return scale * stamps.astype(np.float64), 0


def likely_units(interval: float, bounds: Sequence[float]) -> list[str]:
    """Units in which an interval, in the numbers of the file, is plausible, within `bounds`, s."""
    return [unit for unit, scale in TIME_UNITS.items() if bounds[0] <= interval * scale <= bounds[1]]


def counts_frames(stamps: np.ndarray) -> bool:
    """Whether numbers are whole and go up in steps of one, as frame numbers do; single steps may be longer."""
    steps = np.diff(stamps[np.isfinite(stamps)] if stamps.dtype.kind == "f" else stamps).astype(np.float64)
    if not len(steps):
        return False
    whole = np.all(np.mod(stamps[np.isfinite(stamps)].astype(np.float64), 1) == 0)
    return bool(whole and np.median(steps) == 1 and np.mean(steps == 1) >= 1 - 2 * (1 - STEADY))


def refuse_implausible(name: str, interval: float, unit: str, bounds: Sequence[float],
                       stamps: np.ndarray | None = None, column: str | None = None) -> None:
    """Raises ValueError for a median sampling interval (s, of stamps in `unit`) that is not within `bounds`, s.

    The message names the units that are likelier, or frame numbers where `stamps`, as in the file, count them.
    """
    if bounds[0] <= interval <= bounds[1]:
        return
    raw = interval / TIME_UNITS[unit]
    found = (f"{name}: the median sampling interval is {interval:.3g} s when the times are read in {unit}; expected "
             f"between {bounds[0]:g} and {bounds[1]:g} s")
    if stamps is not None and counts_frames(stamps):
        raise ValueError(f"{found}: {column} holds whole numbers in steps of 1: frames? Then give columns.frame: "
                         f"{column} instead of columns.time, and their rate in Hz, as rate: 100")
    likely = likely_units(raw, bounds)
    guess = f"the times look like {' or '.join(likely)}" if likely else "no known unit makes it plausible"
    if stamps is not None and 1 < raw < FEW and _all_whole(stamps):
        guess += ", or like frame numbers (columns.frame and rate)"
    raise ValueError(f"{found}: {guess}. Correct units.time, or widen interval_range where the value is true")


def refuse_implausible_rate(name: str, column: str, rate: float, interval: float, bounds: Sequence[float]) -> None:
    """Raises ValueError where frames of this rate, in Hz, come at an interval, s, that is not within `bounds`, s."""
    if not bounds[0] <= interval <= bounds[1]:
        raise ValueError(f"{name}: {column} counts frames {interval * rate:.4g} apart, at rate: {rate:g} that is every "
                         f"{interval:.3g} s; expected between {bounds[0]:g} and {bounds[1]:g} s: correct rate, in Hz, "
                         "or widen interval_range where the value is true")


def _all_whole(stamps: np.ndarray) -> bool:
    return bool(np.all(np.mod(stamps[np.isfinite(stamps.astype(np.float64))].astype(np.float64), 1) == 0))
