"""Rows that are absent, empty, or partly empty: bridged where they are few, cut where they are many."""

from __future__ import annotations

import numpy as np

from ssmr_torch.faults.clock_trials import LAST, small
from ssmr_torch.faults.measurement_trials import place
from ssmr_torch.faults.outcome import Expected
from ssmr_torch.faults.trial import Trials
from ssmr_torch.result_files import save_text

TRIALS = Trials()


@TRIALS.of("gaps in time")
def of_one_twenty_and_two_hundred_rows(made, rng, folder):
    run = made.runs["c1"]
    first = int(rng.integers(150, 200))
    gone = np.r_[first, first + 300:first + 320, first + 700:first + 900]
    run.keep(np.setdiff1d(np.arange(1500), gone))
    return Expected(f"1, 20 and 200 rows absent in c1 from row {first} on", error=1.15, said=("c1",),
                    samples={"c1": 1280}, near=2)


@TRIALS.of("gaps in time")
def single_rows_absent(made, rng, folder):
    for name in made.controlled():
        made.runs[name].keep(np.setdiff1d(np.arange(1500), rng.choice(np.arange(5, 1495, 7), 25, replace=False)))
    return Expected("25 single rows absent in each controlled run", error=1.1)


@TRIALS.of("missing rows")
def single_rows_empty(made, rng, folder):
    rows = np.sort(rng.choice(np.arange(20, 1480, 9), 20, replace=False))
    for name in ("c1", "c2", "c3", "test"):
        made.runs[name].y[rows] = np.nan
    made.card["missing"] = "split"
    return Expected("20 single rows empty in each controlled run, missing: split", error=1.1, said=("c1",))


@TRIALS.of("missing rows")
def one_coordinate_empty(made, rng, folder):
    run, row, rows = place(made, rng, 2)
    made.runs[run].y[rows, int(rng.integers(3))] = np.nan
    made.card["missing"] = "split"
    return Expected(f"one coordinate empty in rows {row} and {row + 1} of {run}, missing: split", error=1.1,
                    said=(run,))


@TRIALS.of("missing rows")
def without_a_word_in_the_card(made, rng, folder):
    run, row, rows = place(made, rng, 30)
    made.runs[run].y[rows] = np.nan
    return Expected(f"rows {row} to {row + 29} of {run} empty, nothing said in the card",
                    remedy=(run, str(row), "missing"),
                    said=(run,), rows=(row,), near=1, error=1.1)


@TRIALS.of("missing rows")
def a_long_hole(made, rng, folder):
    run, row, rows = place(made, rng, 150, margin=300)
    made.runs[run].y[rows] = np.nan
    made.card["missing"] = "split"
    return Expected(f"rows {row} to {row + 149} of {run} empty, missing: split", said=(run,), samples={run: 1350},
                    near=2, error=1.15)


@TRIALS.of("missing rows")
def a_small_file_with_an_empty_row(made, rng, folder):
    row = int(rng.integers(4, 16))
    small(folder, [f"{k / 100}" for k in range(20)], card={"missing": "split"})
    lines = (folder / "m.csv").read_text(encoding="utf-8").splitlines()
    lines[row + 1] = f"{row / 100},,,,,"
    save_text(folder / "m.csv", "\n".join(lines) + "\n")
    return Expected(f"row {row} of 20 empty, missing: split", samples={"m": 20}, values=LAST)
