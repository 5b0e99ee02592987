"""The clock of a run: its column of time as seconds, and the rows in the order of time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ssmr_torch.recording_clocks.bursts import even, mean_interval, refuse_bursts, refuse_shared_stamps
from ssmr_torch.recording_clocks.clock_rules import Clock, ClockRules, typical_step
from ssmr_torch.recording_clocks.dates import SECOND, is_text, nanoseconds
from ssmr_torch.recording_clocks.disorder import (
    FAR,
    Stamps,
    copies,
    in_order,
    oldest_first,
    parts_between_restarts,
    unwrapped,
    without_copies,
)
from ssmr_torch.recording_clocks.frame_numbers import frames, suspected, uncounted
from ssmr_torch.recording_clocks.gaps import gaps
from ssmr_torch.recording_clocks.time_units import (
    TIME_UNITS,
    exact_seconds,
    refuse_implausible,
    refuse_implausible_rate,
)
from ssmr_torch.recording_files.note import Note
from ssmr_torch.recording_files.table import Table

APART = FAR / 2     # intervals between two runs of one file, so that they are cut there
SAME_RATE = 0.01    # share by which the rates of a file and of its card may differ
ALREADY = 1e-4      # intervals by which stamps may be moved that are even already


def clock_of(table: Table, name: str, file: str, rules: ClockRules) -> Clock:
    """Time in s of each sample of the run `name`, and its rows in the order of time.

    Rows written twice are dropped, rows out of order sorted, counters that wrap counted on, and a run begins where the
    clock starts again; each is said in a note, as are gaps. Clean stamps are multiplied by their unit and nothing else.
    Raises ValueError, with the remedy, for stamps that are no times, an implausible interval, a clock with too few
    digits, bursts, wrong single stamps, and rows that share a stamp.
    """
    rules = _as_in_file(rules, table)
    if rules.time is None and rules.frame is None:
        interval = table.interval if rules.interval is None else rules.interval
        if interval is None:
            raise ValueError(f"{file} has no clock: name its column of time, columns.time, or of frame numbers, "
                             "columns.frame with rate, or give sampling_time")
        rows = np.arange(table.length)
        notes = uncounted(table, name, (*rules.outputs, *rules.inputs))
        if table.interval is not None and abs(interval / table.interval - 1) > SAME_RATE:
            notes.append(Note(name, "another rate", f"the file says {1 / table.interval:.6g} Hz, the card's "
                              f"sampling_time {1 / interval:.6g} Hz; leave it out to take the file's", "kept"))
        return Clock(interval * rows, rows, tuple(notes))
    raw, scale, unit = _stamps(table, file, rules)
    time, first = exact_seconds(raw, unit) if unit else (scale * raw, 0)
    there = np.flatnonzero(np.isfinite(time))
    if len(there) < 2:
        raise ValueError(f"{name}: {len(there)} of {len(time)} rows have a stamp; expected one in each row: correct "
                         "columns.time, or give sampling_time")
    stamps = Stamps(time[there], there)
    if rules.stamps == "even":
        clock = _spread(name, Stamps(time, np.arange(len(time))), rules)
    else:
        clock = _ordered(table, name, file, stamps, scale, rules, raw[there])
    origin = round(first * scale * SECOND) if unit != "ns" else first
    return _with_unstamped(clock, table.length)._replace(origin=origin)


def _as_in_file(rules: ClockRules, table: Table) -> ClockRules:
    """The rules with the columns' names in the file: "time [ms]" for "time"."""
    def found(name: str) -> str:
        return table.find(name) or name

    times = found(rules.time) if isinstance(rules.time, str) else rules.time and tuple(map(found, rules.time))
    return replace(rules, time=times, frame=rules.frame and found(rules.frame),
                   outputs=tuple(map(found, rules.outputs)), inputs=tuple(map(found, rules.inputs)))


def _named(time) -> str:
    return time if isinstance(time, str) else time[0]


def _stamps(table: Table, file: str, rules: ClockRules) -> tuple[np.ndarray, float, str]:
    """Numbers (T,), s per count, and the unit in which they count; "" for frame numbers."""
    if rules.frame is not None:
        rate = rules.rate or (table.interval and 1 / table.interval)
        if not rate:
            raise ValueError(f"{file}: column {rules.frame!r} counts frames; give their rate in Hz, as rate: 100")
        return frames(table, rules.frame, file), 1 / rate, ""
    names = [rules.time] if isinstance(rules.time, str) else list(rules.time)
    columns = [_numeric(_column(table, name, file)) for name in names]
    where = f"{file}, column {names[0]!r}"
    if len(names) == 2 and not any(map(is_text, columns)):
        whole, fraction = (column.astype(np.int64) for column in columns)
        return whole * SECOND + fraction, TIME_UNITS["ns"], "ns"
    if is_text(columns[0]):
        text = columns[0] if len(names) == 1 else np.array(
            [f"{day} {clock}" for day, clock in zip(*columns)], dtype=object)
        stamps, there = nanoseconds(text, where)
        return (stamps if there.all() else np.where(there, stamps - stamps[there][0], np.nan)), TIME_UNITS["ns"], "ns"
    return columns[0], TIME_UNITS[rules.unit], rules.unit


def _column(table: Table, name: str, file: str) -> np.ndarray:
    found = table.find(name)
    return table.columns[found] if found else table.numbers([name], file)[:, 0]  # which refuses it


def _numeric(column: np.ndarray) -> np.ndarray:
    """Text that holds numbers only as numbers; stamps of dates as they are."""
    if column.dtype.kind in "OSU":
        try:
            return column.astype(np.float64)
        except (TypeError, ValueError):
            return column
    return column.astype(np.float64) if column.dtype.kind in "bf" else column


def _ordered(table: Table, name: str, file: str, stamps: Stamps, scale: float, rules: ClockRules,
             raw: np.ndarray) -> Clock:
    column = rules.frame or _named(rules.time)
    stamps = oldest_first(name, stamps)
    copied = copies(table, stamps)
    if rules.same_stamp == "refuse":
        refuse_shared_stamps(name, stamps.time, copied)
    if typical_step(stamps.time) == 0:
        raise ValueError(f"{name}: the stamps never rise; expected increasing time: give sampling_time instead")
    if rules.frame is None:
        refuse_bursts(name, stamps.time[~copied])
    unit = "s" if is_text(_column(table, column, file)) else rules.unit
    if rules.frame is None:
        refuse_implausible(name, typical_step(stamps.time), unit, rules.bounds, raw, column)
    else:
        refuse_implausible_rate(name, column, 1 / scale, typical_step(stamps.time), rules.bounds)
    notes = [] if rules.frame or unit == "s" else suspected(name, column, raw, unit)
    stamps = without_copies(name, stamps, copied)
    motion = np.nan_to_num(table.numbers([each for each in rules.outputs if table.find(each)], name)[stamps.rows])
    stamps = unwrapped(name, stamps, scale, motion)
    parts, found = parts_between_restarts(name, stamps)
    notes += found
    pieces = []
    for part in parts:
        piece = in_order(name, Stamps(stamps.time[part], stamps.rows[part]), rules.same_stamp)
        notes += [*piece.notes, *gaps(name, piece.time, piece.rows)]
        pieces.append(piece)
    return _joined(pieces, [*stamps.notes, *notes])


def _joined(pieces: list[Stamps], notes: list[Note]) -> Clock:
    """The pieces one after the other, so far apart that they are cut there."""
    time = [pieces[0].time]
    for piece in pieces[1:]:
        apart = APART * typical_step(np.concatenate([pieces[0].time, piece.time]))
        time.append(piece.time + (time[-1][-1] + apart - piece.time[0]))
    return Clock(np.concatenate(time), np.concatenate([piece.rows for piece in pieces]), tuple(notes))


def _spread(name: str, stamps: Stamps, rules: ClockRules) -> Clock:
    """Evenly spread stamps, in the order of the rows."""
    finite = np.isfinite(stamps.time)
    step = mean_interval(stamps.time[finite])
    if not step > 0:
        raise ValueError(f"{name}: the stamps do not rise, so nothing tells the rate; give sampling_time instead")
    falls = np.flatnonzero(np.diff(stamps.time) < -FAR * step) + 1
    falls = [at for at in falls if np.nanmedian(stamps.time[at:at + 5]) < np.nanmedian(stamps.time[max(at - 5, 0):at])
             - FAR / 2 * step]
    pieces = [Stamps(even(stamps.time[part]), stamps.rows[part])
              for part in np.split(np.arange(len(stamps.time)), falls)]
    moved = max(float(np.nanmax(np.abs(piece.time - stamps.time[piece.rows]))) for piece in pieces)
    interval = float(np.median(np.diff(pieces[0].time)))
    refuse_implausible(name, interval, rules.unit, rules.bounds)
    if moved < ALREADY * interval and finite.all() and len(pieces) == 1:
        return Clock(stamps.time, stamps.rows, tuple(gaps(name, stamps.time, stamps.rows)))
    note = Note(name, "even stamps", f"the samples are spread evenly, {interval:.5g} s apart; stamps moved by up to "
                f"{moved:.3g} s", "corrected", (), {"interval_s": interval, "moved_s": moved})
    found = [each for piece in pieces for each in gaps(name, piece.time, piece.rows) if each.kind == "gap"]
    return _joined(pieces, [note, *found])


def _with_unstamped(clock: Clock, length: int) -> Clock:
    """The rows without a stamp again in their places, at no time."""
    dropped = [row for note in clock.notes if note.done == "dropped" for row in note.rows]
    unstamped = np.setdiff1d(np.arange(length), np.r_[clock.rows, np.array(dropped, dtype=int)])
    if not len(unstamped):
        return clock
    places = np.searchsorted(np.sort(clock.rows), unstamped)
    return clock._replace(time=np.insert(clock.time, places, np.nan), rows=np.insert(clock.rows, places, unstamped))
