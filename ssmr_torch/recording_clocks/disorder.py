"""Rows that are written twice, out of order or with a wrong stamp, and clocks that start again or wrap around."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ssmr_torch.recording_clocks.clock_rules import typical_step
from ssmr_torch.recording_files.note import Note, rows_said
from ssmr_torch.recording_files.table import Table

FAR = 20                # intervals; a clock that falls by more starts again
BLOCK = 3               # rows in a row that are copies, at least, where the originals are not next to them
EVEN = 0.45             # deviation of the steps from the interval after sorting, in intervals
BACKWARDS = 0.9         # share of the steps that go back where rows stand newest first
BITS = (8, 16, 24, 32)  # of counters
COUNTERS = tuple(2.0 ** 32 * scale for scale in (1e-3, 1e-6))  # s; ms and µs of microcontrollers
REMEDY = "correct the stamp, leave the row out, or set stamps: even where the rows' order is right"


class Stamps(NamedTuple):
    """time: (n,) s. rows: (n,) rows of the table. notes: what was done so far."""

    time: np.ndarray
    rows: np.ndarray
    notes: tuple[Note, ...] = ()

    def without(self, dropped: np.ndarray, *notes: Note) -> Stamps:
        return Stamps(self.time[~dropped], self.rows[~dropped], (*self.notes, *notes))


def copies(table: Table, stamps: Stamps) -> np.ndarray:
    """(n,), whether a row equals an earlier one in all columns: the row before it, or as part of a block of `BLOCK`."""
    _, place, count = np.unique(stamps.time, return_inverse=True, return_counts=True)
    earlier = np.full(len(stamps.time), -1)
    seen: dict[tuple, int] = {}
    for at in np.flatnonzero(count[place] > 1):
        row = stamps.rows[at]
        key = tuple(str(column[row]) if column.dtype.kind == "O" else column[row].tobytes()
                    for column in table.columns.values())
        earlier[at] = seen.get(key, -1)
        seen[key] = at
    copied = earlier >= 0
    lag = np.where(copied, np.arange(len(earlier)) - earlier, 0)
    edges = np.flatnonzero(np.r_[True, np.diff(lag) != 0, True])
    block = np.repeat(np.diff(edges), np.diff(edges))
    return copied & ((lag == 1) | (block >= BLOCK))


def without_copies(name: str, stamps: Stamps, copied: np.ndarray) -> Stamps:
    """The stamps without rows that are written twice."""
    if not copied.any():
        return stamps
    rows = stamps.rows[copied]
    return stamps.without(copied, Note(name, "repeated rows", f"{rows_said(rows)} "
                                       f"{'repeats' if len(rows) == 1 else 'repeat'} an earlier row, stamp and "
                                       "values; dropped", "dropped", tuple(rows)))


def oldest_first(name: str, stamps: Stamps) -> Stamps:
    """The stamps, turned around where the newest row stands first."""
    steps = np.diff(stamps.time)
    if not np.mean(steps < 0) > BACKWARDS:
        return stamps
    note = Note(name, "newest first", f"the rows stand newest first, from {stamps.time[0]:.6g} to "
                f"{stamps.time[-1]:.6g} s; turned around", "corrected")
    return Stamps(stamps.time[::-1], stamps.rows[::-1], (*stamps.notes, note))


def unwrapped(name: str, stamps: Stamps, scale: float, motion: np.ndarray) -> Stamps:
    """The stamps of a counter of so many bits that began again at 0, in one piece.

    scale: s per count. motion: (n, q), what the robot did, which a wrap does not interrupt.
    """
    step, turns = typical_step(stamps.time), [2.0 ** bits * scale for bits in BITS] + list(COUNTERS)
    shift, wraps = np.zeros(len(stamps.time)), []
    for row in np.flatnonzero(np.diff(stamps.time) < 0) + 1:
        fall = stamps.time[row - 1] - stamps.time[row]
        turn = [each for each in turns if abs(each - fall - step) <= 0.5 * step and each > FAR * step]
        if turn and _goes_on(motion, row):
            shift[row:] += turn[0]
            wraps.append(int(stamps.rows[row]))
    if not wraps:
        return stamps
    return Stamps(stamps.time + shift, stamps.rows, (*stamps.notes, Note(
        name, "counter wraps", f"the counter of time begins again at {rows_said(wraps)}, where the motion goes on; "
        "counted on", "corrected", tuple(wraps))))


def parts_between_restarts(name: str, stamps: Stamps) -> tuple[list[slice], list[Note]]:
    """The stretches in which one clock runs, and a note where another run begins."""
    time, step = stamps.time, typical_step(stamps.time)
    begins, notes = [0], []
    for at in np.flatnonzero(np.diff(time) < 0) + 1:
        if at <= begins[-1] + 1 or is_wrong(time, at, step) or is_wrong(time, at - 1, step):
            continue
        fall = time[begins[-1]:at].max() - time[at]
        again = abs(time[at] - time[begins[-1]]) <= 1.5 * step or abs(time[at]) <= 1.5 * step
        if fall > FAR * step or (again and not _sorts(time, at, step, begins[-1])):
            begins.append(int(at))
            notes.append(Note(name, "clock restarts", f"the clock falls from {time[at - 1]:.6g} to {time[at]:.6g} s at "
                              f"row {stamps.rows[at]}: another run begins there", "cut", (stamps.rows[at],)))
    return [slice(first, last) for first, last in zip(begins, [*begins[1:], len(time)])], notes


def in_order(name: str, stamps: Stamps, same_stamp: str) -> Stamps:
    """The rows of one clock in the order of time.

    Raises ValueError for stamps that are wrong and for rows that share a stamp, unless `same_stamp` keeps one of them.
    """
    stamps = _one_of_each(name, stamps, same_stamp)
    time, step = stamps.time, typical_step(stamps.time)
    falls = np.flatnonzero(np.diff(time) <= 0) + 1
    if not len(falls):
        return stamps
    for at in falls:
        if not _sorts(time, at, step):
            wrong = next((each for each in (at, at - 1) if is_wrong(time, each, step)), None)
            _refuse(name, stamps, at, wrong, len(falls))
    order = np.argsort(time, kind="stable")
    moved = np.flatnonzero(order != np.arange(len(order)))
    note = Note(name, "rows out of order", f"{rows_said(np.sort(stamps.rows[moved]))} are not in the order of time; "
                "sorted", "corrected", tuple(stamps.rows[moved]))
    return Stamps(time[order], stamps.rows[order], (*stamps.notes, note))


def is_wrong(time: np.ndarray, at: int, step: float) -> bool:
    """Whether the stamp at `at` alone is wrong: its neighbours are two intervals apart, and it is not between them."""
    if not 0 < at < len(time) - 1:
        return False
    before, after = time[at - 1], time[at + 1]
    return bool(1.5 * step <= after - before <= 2.5 * step and not before < time[at] < after)


def _one_of_each(name: str, stamps: Stamps, same_stamp: str) -> Stamps:
    same = np.r_[False, np.diff(stamps.time) == 0]
    if same_stamp == "refuse" or not same.any():
        return stamps
    dropped = same if same_stamp == "first" else np.r_[same[1:], False]
    rows = stamps.rows[dropped]
    return stamps.without(dropped, Note(name, "shared stamps", f"{rows_said(rows)} "
                                        f"{'has' if len(rows) == 1 else 'have'} the stamp of another row and other "
                                        f"values; dropped, since same_stamp is {same_stamp}", "dropped", tuple(rows)))


def _sorts(time: np.ndarray, at: int, step: float, first: int = 0) -> bool:
    """Whether sorting makes the stamps around a fall even."""
    reach = int(np.ceil((time[max(first, at - 2 * FAR):at].max() - time[at]) / step)) + 2
    for wider in (2, 4, 8, 16):
        around = np.sort(time[max(first, at - wider * reach):at + wider * reach])
        if np.abs(np.diff(around) / step - 1).max() <= EVEN:
            return True
        if wider * reach > 4 * FAR:
            break
    return False


def _goes_on(motion: np.ndarray, row: int) -> bool:
    """Whether the motion makes no larger step to this row than near it."""
    steps = np.linalg.norm(np.diff(motion[max(row - 10, 0):row + 10], axis=0), axis=1)
    here = np.linalg.norm(motion[row] - motion[row - 1])
    others = np.delete(steps, min(row, 10) - 1) if len(steps) > 1 else steps
    return bool(here <= 2 * others.max(initial=0.0) + 1e-12)


def _refuse(name: str, stamps: Stamps, at: int, wrong: int | None, count: int) -> None:
    time, row = stamps.time, at if wrong is None else wrong
    word = "repeats" if time[at] == time[at - 1] else "goes back"
    more = f", and in {count} rows in all" if count > 1 else ""
    if wrong is not None:
        meant = (time[wrong - 1] + time[wrong + 1]) / 2
        raise ValueError(f"{name}: time {word} at row {stamps.rows[row]} (from 0) with {time[row]:.6g} s, where the "
                         f"rows around it say {meant:.6g} s{more}; {REMEDY}")
    remedy = "set same_stamp: first or last to keep one of the rows" if word == "repeats" else REMEDY
    raise ValueError(f"{name}: time {word} at row {stamps.rows[row]} (from 0) with {time[row]:.6g} s{more}; expected "
                     f"increasing time: {remedy}")
