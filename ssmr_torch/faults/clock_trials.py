"""Clocks: their units and digits, frames, bursts, order, gaps, jitter, and inputs that lag behind the outputs."""

from __future__ import annotations

import numpy as np

from ssmr_torch.faults.made_recordings import small_recordings
from ssmr_torch.faults.measurement_trials import place
from ssmr_torch.faults.outcome import Expected
from ssmr_torch.faults.trial import Trials
from ssmr_torch.result_files import save_text

TRIALS = Trials()
LAST = (("m", 0, 19, 0.0019, 1e-9),)  # the last x of the small recordings is 1.9 mm from rest


def small(folder, times, *, rows=None, card=None) -> None:
    """The small recordings with these texts in the column of time, in these rows."""
    made = small_recordings()
    cells = [row.split(",", 1)[1] for row in made.rows("m")]
    order = range(20) if rows is None else rows
    save_text(folder / "m.csv", "\n".join(["t,x,y,z,u1,u2", *(f"{times[k]},{cells[k]}" for k in order)]) + "\n")
    made.card |= card or {}
    made.write_card(folder)


# Frame numbers ---------------------------------------------------------------------------------------------------

@TRIALS.of("frames as a clock")
def whole_numbers(made, rng, folder):
    first = int(rng.integers(0, 5000))
    for run in made.runs.values():
        run.time = first + np.arange(len(run))
    return Expected(f"frame numbers from {first} in the column of time, unit s", refused=True, remedy=("frame", "rate"))


def counted(made, rate: int) -> None:
    """Frame numbers in a column of their own and the rate in the card."""
    made.card["columns"] = {"frame" if key == "time" else key: value for key, value in made.card["columns"].items()}
    made.card["rate"] = rate


@TRIALS.of("frames as a clock")
def missing_numbers_are_missing_frames(made, rng, folder):
    for name, run in made.runs.items():
        run.time = 7 + np.arange(len(run))
        if name in made.controlled():
            run.keep(np.setdiff1d(np.arange(1500), rng.choice(np.arange(5, 1495, 7), 30, replace=False)))
    counted(made, 100)
    return Expected("30 numbers missing in each controlled run, the card gives the rate", refused=False, error=1.1,
                    timestep=0.01)


@TRIALS.of("frames as a clock")
def a_counter_of_eight_bits_with_its_rate(made, rng, folder):
    for run in made.runs.values():
        run.time = (200 + np.arange(len(run))) % 256
    counted(made, 100)
    return Expected("a counter of 8 bits, the card gives the rate", error=1.05, remedy=("wrap|again|restart|back",),
                    timestep=0.01)


@TRIALS.of("frames as a clock")
def the_counter_wraps(made, rng, folder):
    for run in made.runs.values():
        run.time = (65000 + np.arange(len(run))) % 65536
    return Expected("a frame counter of 16 bits that begins again at 0", refused=True,
                    remedy=("frame|begins again|wrap",))


# Lag -------------------------------------------------------------------------------------------------------------

def lagging(made, rows: int) -> Expected:
    for name, run in made.runs.items():
        if not name.startswith("d"):
            run.u = np.roll(run.u, rows, axis=0)
    milliseconds = 10 * rows
    return Expected(f"inputs of all runs {rows} rows ({milliseconds} ms) late", remedy=("lag|late|early|shift",),
                    said=("lag|late|early|shift", f"{abs(milliseconds)}|{abs(milliseconds) / 1000:g}"))


@TRIALS.of("inputs that lag")
def by_some_rows(made, rng, folder):
    return lagging(made, int(rng.integers(3, 12)))


@TRIALS.of("inputs that lag")
def early_inputs(made, rng, folder):
    return lagging(made, -int(rng.integers(2, 6)))


@TRIALS.of("inputs that lag")
def removed_on_request(made, rng, folder):
    rows = int(rng.choice([-2, 4, 9]))
    lagging(made, rows)
    made.card["input_lag"] = "remove"
    return Expected(f"inputs of all runs {rows} rows late, input_lag: remove", refused=False, error=1.2,
                    said=("lag|late|early",))


@TRIALS.of("inputs that lag")
def one_run_alone(made, rng, folder):
    run, rows = str(rng.choice(made.controlled())), int(rng.integers(6, 15))
    made.runs[run].u = np.roll(made.runs[run].u, rows, axis=0)
    return Expected(f"inputs of {run} alone {rows} rows late", remedy=(run,), said=(run, "lag|late|shift"))


@TRIALS.of("inputs that lag")
def a_quarter_of_a_second(made, rng, folder):
    return lagging(made, 25)


# Bursts, jitter -------------------------------------------------------------------------------------------------

def bursts(made, size: int) -> None:
    for run in made.runs.values():
        k = np.arange(len(run))
        run.time = 0.01 * size * (k // size) + 0.0004 * (k % size)


@TRIALS.of("stamps in bursts")
def threes(made, rng, folder):
    bursts(made, 3)
    return Expected("stamps in threes", remedy=("threes|3", "burst|arrive|evenly"), said=("threes|3",), error=1.3,
                    timestep=0.01)


@TRIALS.of("stamps in bursts")
def fives_spread_evenly(made, rng, folder):
    bursts(made, 5)
    made.card["stamps"] = "even"
    return Expected("stamps in fives, stamps: even", refused=False, said=("fives|5",), error=1.2, timestep=0.01)


@TRIALS.of("stamps in bursts")
def tens_with_equal_stamps(made, rng, folder):
    for run in made.runs.values():
        run.time = 0.1 * (np.arange(len(run)) // 10)
    return Expected("ten rows share each stamp", refused=True, remedy=("10 rows|tens|share|burst",))


@TRIALS.of("stamps in bursts")
def some_at_times(made, rng, folder):
    for run in made.runs.values():
        late = np.flatnonzero(rng.uniform(size=len(run)) < 0.05)
        run.time = run.time + np.isin(np.arange(len(run)), late) * 0.008
    return Expected("one stamp in twenty 8 ms late", remedy=("stamp|clock|interval",), error=1.6, said=(),
                    timestep=0.01)


@TRIALS.of("jitter")
def of_a_tenth(made, rng, folder):
    for run in made.runs.values():
        held = run.time + 0.001 * rng.uniform(-0.5, 0.5, len(run))
        run.time = held - held[0]
    return Expected("stamps of a steady camera jitter by ±0.5 ms", error=1.3, timestep=0.01)


# Units and digits ------------------------------------------------------------------------------------------------

@TRIALS.of("units of clocks")
def nanoseconds_of_a_robot(made, rng, folder):
    first = 1_650_000_000_000_000_000 + int(rng.integers(10**17))
    small(folder, [first + 10_000_000 * k for k in range(20)])
    return Expected("epoch in ns, said to be s", refused=True, remedy=(r"\bns\b",))


@TRIALS.of("units of clocks")
def nanoseconds_said(made, rng, folder):
    first = 1_650_000_000_000_000_000 + int(rng.integers(10**17))
    small(folder, [first + 10_000_000 * k for k in range(20)],
          card={"units": {"length": "mm", "input": "1", "time": "ns"}})
    return Expected("epoch in ns, said to be ns", refused=False, samples={"m": 20}, values=LAST, timestep=0.01)


@TRIALS.of("units of clocks")
def microseconds_that_wrap(made, rng, folder):
    small(folder, [(2**32 - 100_000 + 10_000 * k) % 2**32 for k in range(20)],
          card={"units": {"length": "mm", "input": "1", "time": "us"}})
    return Expected("µs of 32 bits that begin again at 0 in row 10", remedy=("wrap|begins again|goes back",),
                    said=("m",), samples={"m": 20}, values=LAST)


@TRIALS.of("units of clocks")
def milliseconds_said_to_be_seconds(made, rng, folder):
    small(folder, [1000 + 10 * k for k in range(20)])
    return Expected("10 ms each, said to be s", refused=True, remedy=(r"\bms\b",))


@TRIALS.of("units of clocks")
def ten_digits_of_an_epoch(made, rng, folder):
    small(folder, [f"{1_732_340_000 + k / 100:.6g}" for k in range(20)])
    return Expected("an epoch written with six digits", refused=True, remedy=("digits", "sampling_time"))


@TRIALS.of("units of clocks")
def whole_seconds(made, rng, folder):
    for run in made.runs.values():
        run.time = 1_700_000_000 + np.floor(run.time)
    return Expected("whole epoch seconds, 100 rows each", refused=True, remedy=("100 rows", "sampling_time"))


@TRIALS.of("units of clocks")
def minutes(made, rng, folder):
    small(folder, [f"{k / 6000:.10f}" for k in range(20)],
          card={"units": {"length": "mm", "input": "1", "time": "min"}})
    return Expected("minutes, said to be min", refused=False, samples={"m": 20}, values=LAST, timestep=0.01)


# Order -----------------------------------------------------------------------------------------------------------

STEADY = [f"{k / 100:g}" for k in range(20)]


@TRIALS.of("order of rows")
def a_row_twice(made, rng, folder):
    row = int(rng.integers(1, 19))
    small(folder, STEADY, rows=[*range(row + 1), *range(row, 20)])
    return Expected(f"row {row} written twice", refused=False, said=("m",), rows=(row,), near=1, samples={"m": 20},
                    values=LAST)


@TRIALS.of("order of rows")
def three_rows_backwards(made, rng, folder):
    row = int(rng.integers(2, 16))
    small(folder, STEADY, rows=[*range(row), row + 2, row + 1, row, *range(row + 3, 20)])
    return Expected(f"rows {row} to {row + 2} backwards", refused=False, said=("m",), rows=(row,), near=2,
                    samples={"m": 20}, values=LAST)


@TRIALS.of("order of rows")
def a_block_twice(made, rng, folder):
    small(folder, STEADY, rows=[*range(12), *range(8, 20)])
    return Expected("rows 8 to 11 written twice", refused=False, said=("m",), samples={"m": 20}, values=LAST)


@TRIALS.of("order of rows")
def two_rows_of_one_time_with_other_values(made, rng, folder):
    small(folder, [*STEADY[:10], STEADY[9], *STEADY[11:]])
    return Expected("row 10 has the stamp of row 9 but other values", refused=True, remedy=(r"\b10\b|\b9\b",))


@TRIALS.of("order of rows")
def a_clock_that_restarts(made, rng, folder):
    run, row, _ = place(made, rng, margin=400)
    made.runs[run].time[row:] -= made.runs[run].time[row]
    return Expected(f"the clock of {run} begins again at row {row}", remedy=(run, str(row)), said=(run,), rows=(row,),
                    near=1, error=1.15)


@TRIALS.of("order of rows")
def newest_first(made, rng, folder):
    small(folder, STEADY, rows=list(range(19, -1, -1)))
    return Expected("all rows backwards", remedy=("goes back|backwards|newest",), said=("m",), samples={"m": 20},
                    values=LAST)


# Dates -----------------------------------------------------------------------------------------------------------

@TRIALS.of("dates and times")
def with_a_zone_and_microseconds(made, rng, folder):
    small(folder, [f"2024-05-01T12:00:00.{10000 * k:06d}+02:00" for k in range(20)])
    return Expected("ISO with µs and a zone", refused=False, samples={"m": 20}, values=LAST, timestep=0.01)


@TRIALS.of("dates and times")
def with_a_blank_and_z(made, rng, folder):
    small(folder, [f"2024-12-31 23:59:59.{900 + 10 * k:03d}Z" if k < 10 else f"2025-01-01 00:00:00.{10 * (k - 10):03d}Z"
                   for k in range(20)])
    return Expected("a blank for the T, Z, over midnight of New Year", refused=False, samples={"m": 20}, values=LAST,
                    timestep=0.01)


@TRIALS.of("dates and times")
def of_a_spreadsheet(made, rng, folder):
    small(folder, [f"01.05.2024 12:00:00,{10 * k:03d}".replace(",", ".") for k in range(20)])
    return Expected("day.month.year as a spreadsheet writes", remedy=("date|time|ISO|2024-",), samples={"m": 20},
                    values=LAST)


@TRIALS.of("dates and times")
def the_hour_that_comes_twice(made, rng, folder):
    small(folder, [f"2024-10-27T02:59:59.{900 + 10 * k}+02:00" if k < 10 else
                   f"2024-10-27T02:00:00.{10 * (k - 10):03d}+01:00" for k in range(20)])
    return Expected("the hour that comes twice in October, zones given", refused=False, samples={"m": 20}, values=LAST,
                    timestep=0.01)


@TRIALS.of("dates and times")
def the_time_of_day(made, rng, folder):
    small(folder, [f"12:59:59.{900 + 10 * k}" if k < 10 else f"13:00:00.{10 * (k - 10):03d}" for k in range(20)])
    return Expected("the time of day without a date", remedy=("time|date|number",), samples={"m": 20}, values=LAST)
