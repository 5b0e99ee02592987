"""Samples that were lost: gaps that cut a run, single absent samples that are bridged, and stamps that jitter."""

from __future__ import annotations

import numpy as np

from ssmr_torch.recording_clocks.clock_rules import typical_step
from ssmr_torch.recording_files.note import Note, rows_said

LONGEST = 3.0           # median intervals; samples further apart belong to two runs
ABSENT = (1.6, 3.0)     # median intervals, where one or two samples are absent
UNEVEN = 0.1            # share of the interval by which 95 % of the steps may deviate before it is said
STEADY, ODD = 0.02, 0.2     # deviation of most stamps of a steady clock, and of an odd one, in intervals
EPOCH = 86400.0         # s; longer gaps are another setting of the clock
MOST_ODD = 0.01         # share of the stamps


def find_time_gaps(time: np.ndarray, longest: float = LONGEST) -> np.ndarray:
    """Rows before which more than `longest` median sampling intervals passed, because samples were lost."""
    steps = np.diff(time)
    return np.flatnonzero(steps > longest * np.median(steps)) + 1


def gaps(name: str, time: np.ndarray, rows: np.ndarray) -> list[Note]:
    """Notes on the gaps, absent samples, jitter and single odd stamps of increasing times (T,), s."""
    steps, step = np.diff(time), typical_step(time)
    if len(steps) < 3 or not step:
        return []
    relative = steps / step
    notes = [_gap(name, place, steps[place - 1], step, rows) for place in find_time_gaps(time)]
    odd = _odd(time, step)
    absent = np.flatnonzero((relative > ABSENT[0]) & (relative <= ABSENT[1])) + 1
    absent = np.setdiff1d(absent, np.r_[odd, odd + 1])
    spread = float(np.quantile(np.abs(relative - 1), 0.95))
    if len(absent) and spread <= UNEVEN:
        lost = int(np.round(relative[absent - 1] - 1).sum())
        notes.append(Note(name, "absent samples", f"{samples(lost)} {'is' if lost == 1 else 'are'} absent, before "
                          f"{rows_said(rows[absent])}; bridged", "bridged", tuple(rows[absent]), {"samples": lost}))
    elif spread > UNEVEN:
        notes.append(Note(name, "jitter", f"the sampling intervals deviate by {100 * spread:.2g} % from {step:.4g} s; "
                          "where the sampling was even and only the stamps are not, set stamps: even", "kept", (),
                          {"share": spread, "interval_s": step}))
    return notes + ([_odd_said(name, time, odd, rows)] if len(odd) else [])


def samples(count: int) -> str:
    """A number of samples in words."""
    return f"{count} sample{'' if count == 1 else 's'}"


def _gap(name: str, place: int, length: float, step: float, rows: np.ndarray) -> Note:
    lost = round(length / step - 1)
    said = f"the clock jumps by {length:.4g} s before row {rows[place]}, to another setting" if length > EPOCH else (
        f"{samples(lost)} are missing before row {rows[place]}, a gap of {length:.4g} s")
    return Note(name, "gap", f"{said}; the run is cut there", "cut", (rows[place],),
                {"samples": lost, "gap_s": float(length)})


def _odd(time: np.ndarray, step: float) -> np.ndarray:
    """Rows of single stamps that lie off the middle of two good neighbours, in an otherwise steady clock."""
    if np.median(np.abs(np.diff(time) / step - 1)) > STEADY:
        return np.empty(0, dtype=int)
    whole = np.abs(time[2:] - time[:-2] - 2 * step) <= STEADY * step
    odd = np.flatnonzero(whole & (np.abs(_off_middle(time)) > ODD * step)) + 1
    return odd if len(odd) <= max(1, MOST_ODD * len(time)) else odd[:0]


def _off_middle(time: np.ndarray) -> np.ndarray:
    return time[1:-1] - (time[:-2] + time[2:]) / 2


def _odd_said(name: str, time: np.ndarray, odd: np.ndarray, rows: np.ndarray) -> Note:
    off = _off_middle(time)[odd - 1]
    worst = float(off[np.argmax(np.abs(off))])
    return Note(name, "odd stamp", f"the stamp of {rows_said(rows[odd])} is up to {1e3 * abs(worst):.3g} ms "
                f"{'early' if worst < 0 else 'late'} between even ones; set stamps: even where the sampling was even",
                "kept", tuple(rows[odd]), {"deviation_s": worst})
