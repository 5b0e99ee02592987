"""Samples that arrive in bursts, or share a stamp: found, and spread evenly over the rows."""

from __future__ import annotations

import numpy as np

from ssmr_torch.recording_clocks.gaps import LONGEST

FEWEST = 3              # long steps that show bursts
CROWDED = 0.5           # share of a burst's period within which its samples are stamped
ALIKE = 0.8             # share of the bursts that come as regularly as the others, within half of their period
SHARED = 0.1            # share of the rows with the stamp of the row before and other values
CLIP = 4.0              # residuals further off than this many times their median do not count in the fit
NUMBERS = {2: "pairs", 3: "threes", 4: "fours", 5: "fives", 6: "sixes", 7: "sevens", 8: "eights", 10: "tens"}


def even(time: np.ndarray) -> np.ndarray:
    """The times (T,), s, of samples that were taken evenly, from stamps that are not even; gaps stay.

    In each piece between gaps, time[k] = a + interval·k, fitted to the stamps with which bursts begin. The interval is
    the same in all pieces. Stamps that are not finite are filled.
    Raises ValueError where the stamps do not rise.
    """
    there = np.flatnonzero(np.isfinite(time))
    if len(there) < 2 or not time[there[-1]] > time[there[0]]:
        raise ValueError("the stamps do not rise, so nothing tells the rate; give sampling_time instead")
    stamps = np.interp(np.arange(len(time)), there, time[there])
    pieces = np.split(np.arange(len(time)), _breaks(stamps))
    fits = [_line(stamps[piece]) for piece in pieces]
    lengths = np.array([len(piece) for piece in pieces])
    interval = float(fits[int(lengths.argmax())][1])
    return np.concatenate([_start(stamps[piece], interval) + interval * np.arange(len(piece)) for piece in pieces])


def mean_interval(time: np.ndarray) -> float:
    """Interval between samples, s, over bursts: the median over 64 rows each."""
    width = min(64, len(time) - 1)
    return float(np.median(time[width:] - time[:-width]) / width)


def refuse_shared_stamps(name: str, time: np.ndarray, alike: np.ndarray) -> None:
    """Raises ValueError where many rows have the stamp of the row before.

    time: (T,) s. alike: (T,), rows that are copies of the row before and do not count.
    """
    same = np.r_[False, np.diff(time) == 0] & ~alike
    sizes = np.diff(np.flatnonzero(np.r_[~same, True]))
    if not len(sizes) or (sizes.max() < 3 and same.sum() < SHARED * len(time)):
        return
    if len(sizes) == 1:
        raise ValueError(f"{name}: all {len(time)} rows share a stamp, {time[0]:.10g} s: the clock has too few digits; "
                         "give sampling_time instead")
    shared = int(np.median(sizes[1:-1])) if len(sizes) > 2 else int(sizes.max())
    rate = (len(sizes) - 1) and float((np.cumsum(sizes)[-2] - 0) / (time[-1] - time[0]))
    shared = shared if shared > 1 else int(sizes.max())
    raise ValueError(f"{name}: {shared} rows share a stamp: the clock has too few digits; give sampling_time instead "
                     f"of columns.time, or stamps: even, which spreads them over the time, about {rate:.3g} Hz")


def refuse_bursts(name: str, time: np.ndarray) -> None:
    """Raises ValueError where samples arrive in bursts, with their size and the mean rate; time (T,) s rises."""
    steps = np.diff(time)
    if len(steps) < 8:
        return
    short = np.median(steps)
    long = np.flatnonzero(steps > max(LONGEST * short, np.mean(steps)))
    if len(long) < FEWEST:
        return
    periods, sizes = np.diff(time[long + 1]), np.diff(long)
    crowded = 1 - steps[long[1:]] / periods
    regular = np.abs(periods / np.median(periods) - 1) < 0.5
    if np.mean(regular) < ALIKE or np.median(crowded) > CROWDED or np.median(sizes) < 2:
        return
    size = int(np.median(sizes))
    rate = (len(time) - 1) / (time[-1] - time[0])
    raise ValueError(f"{name}: samples arrive in {NUMBERS.get(size, f'bursts of {size}')}; mean rate {rate:.3g} Hz; "
                     "set stamps: even to spread them evenly")


def _breaks(stamps: np.ndarray) -> np.ndarray:
    """Rows at which the time that passed is longer than bursts explain, for good."""
    steps, interval = np.diff(stamps), mean_interval(stamps)
    longer = steps[steps > interval]
    limit = LONGEST * max(interval, float(np.median(longer)) if len(longer) else 0.0)
    late = stamps - interval * np.arange(len(stamps))
    found = []
    for row in np.flatnonzero(steps > limit) + 1:
        reach = slice(row, row + 16), slice(max(row - 16, 0), row)
        if np.median(late[reach[0]]) - np.median(late[reach[1]]) > 0.8 * limit:
            found.append(row)
    return np.array(found, dtype=int)


def _begins(stamps: np.ndarray) -> np.ndarray:
    """Rows at which a burst begins; all rows where there are none."""
    steps, interval = np.diff(stamps), (stamps[-1] - stamps[0]) / max(len(stamps) - 1, 1)
    crowded = np.mean(steps < 0.5 * interval) > 0.3 if len(steps) else False
    begins = np.flatnonzero(steps > interval) + 1
    return begins if crowded and len(begins) >= 2 else np.arange(len(stamps))


def _line(stamps: np.ndarray) -> tuple[float, float]:
    """(a, interval) of a + interval·row through the beginnings of the bursts; far ones do not count."""
    rows = _begins(stamps)
    if len(rows) < 2:
        return float(stamps[0]), 0.0
    kept = np.ones(len(rows), dtype=bool)
    for _ in range(2):
        interval, start = np.polyfit(rows[kept], stamps[rows[kept]] - stamps[0], 1)
        off = np.abs(stamps[rows] - stamps[0] - start - interval * rows)
        kept = off <= CLIP * np.median(off) + 1e-12 * (abs(stamps[-1]) + 1)
        if kept.sum() < 2:
            break
    return float(start + stamps[0]), float(interval)


def _start(stamps: np.ndarray, interval: float) -> float:
    rows = _begins(stamps)
    return float(np.median(stamps[rows] - interval * rows))
