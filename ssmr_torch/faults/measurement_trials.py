"""Measurements that lie: outliers, held and missing values, exchanged markers, drift, wrong rests and units, copies."""

from __future__ import annotations

import numpy as np

from ssmr_torch.faults.made_recordings import MadeRecordings, Robot
from ssmr_torch.faults.outcome import Expected
from ssmr_torch.faults.trial import Trials

TRIALS = Trials()
TWO, THREE = Robot(markers=2), Robot(markers=3)


def place(made: MadeRecordings, rng, count: int = 1, margin: int = 60) -> tuple[str, int, slice]:
    """A training run with inputs, and so many rows in a row in it: (run, first, rows)."""
    run = str(rng.choice(made.controlled()))
    first = int(rng.integers(margin, len(made.runs[run]) - margin - count))
    return run, first, slice(first, first + count)


# One wrong row, or a few -----------------------------------------------------------------------------------------

@TRIALS.of("outliers")
def one_coordinate_jumps(made, rng, folder):
    run, row, rows = place(made, rng)
    column, size = int(rng.integers(3)), float(rng.choice([-1, 1]) * rng.uniform(8, 60))
    made.runs[run].y[rows, column] += size
    return Expected(f"{made.observation[column]} {size:+.0f} mm in row {row} of {run}", said=(run,), rows=(row,),
                    error=1.05)


@TRIALS.of("outliers")
def three_rows_far_away(made, rng, folder):
    run, row, rows = place(made, rng, 3)
    made.runs[run].y[rows] += rng.normal(size=3) * 200
    return Expected(f"rows {row} to {row + 2} of {run} some 200 mm off", said=(run,), rows=(row,), near=2, error=1.05)


@TRIALS.of("outliers")
def an_input_spikes(made, rng, folder):
    run, row, rows = place(made, rng)
    made.runs[run].u[rows, 1] = 9.0
    return Expected(f"u2 = 9 in row {row} of {run} alone", said=(run,), rows=(row,), near=1, error=1.1)


@TRIALS.of("outliers")
def a_sentinel_of_the_tracker(made, rng, folder):
    run, row, rows = place(made, rng, int(rng.integers(1, 8)))
    value = float(rng.choice([-9999.0, 9999.99, -1e6]))
    made.runs[run].y[rows] = value
    return Expected(f"{value:g} in rows {row} to {rows.stop - 1} of {run}", said=(run,), rows=(row,), near=1,
                    error=1.05)


@TRIALS.of("outliers")
def zeros_in_a_decay(made, rng, folder):
    count = int(rng.integers(1, 4))
    first = int(rng.integers(40, 200))
    made.runs["d3"].y[first:first + count] = 0.0
    return Expected(f"exact zeros in {count} rows of d3 from row {first}", said=("d3",), rows=(first,), near=1,
                    error=1.05)


@TRIALS.of("outliers")
def many_single_rows(made, rng, folder):
    run = str(rng.choice(made.controlled()))
    rows = np.sort(rng.choice(np.arange(20, 1480, 15), 12, replace=False))
    made.runs[run].y[rows, rng.integers(3, size=12)] += 40.0
    return Expected(f"12 single rows of {run} off by 40 mm", said=(run,), rows=(int(rows[0]),), error=1.05)


@TRIALS.of("outliers", TWO)
def a_marker_at_the_origin(made, rng, folder):
    run, row, rows = place(made, rng, int(rng.integers(1, 5)))
    made.runs[run].y[rows, 3:] = 0.0
    return Expected(f"second marker at the origin in rows {row} to {rows.stop - 1} of {run}", said=(run,), rows=(row,),
                    near=1, error=1.05)


@TRIALS.of("outliers")
def the_test_run_too(made, rng, folder):
    row = int(rng.integers(100, 1400))
    made.runs["test"].y[row] = 0.0
    return Expected(f"exact zeros in row {row} of test", said=("test",), rows=(row,), error=1.05)


# Values that are held --------------------------------------------------------------------------------------------

@TRIALS.of("held values")
def a_camera_of_a_third_of_the_rate(made, rng, folder):
    for name in made.training():
        made.runs[name].y = made.runs[name].y[3 * (np.arange(len(made.runs[name])) // 3)]
    return Expected("positions at 33 Hz in a log of 100 Hz", remedy=("33",), said=("33",), error=1.6)


@TRIALS.of("held values")
def a_camera_of_half_the_rate_by_rule(made, rng, folder):
    rule = str(rng.choice(["thin", "bridge"]))
    for name in made.training():
        made.runs[name].y = made.runs[name].y[2 * (np.arange(len(made.runs[name])) // 2)]
    made.card["faults"] = {"slow_camera": rule}
    return Expected(f"positions at 50 Hz in a log of 100 Hz, slow_camera: {rule}", said=("50",), refused=False,
                    error=2.2 if rule == "thin" else 1.3)


@TRIALS.of("held values")
def a_camera_that_misses_every_other_sample_of_one_run(made, rng, folder):
    run = str(rng.choice(made.controlled()))
    made.runs[run].y = made.runs[run].y[2 * (np.arange(1500) // 2)]
    return Expected(f"positions of {run} at 50 Hz in a log of 100 Hz", remedy=(run, "50"), said=(run, "50"), error=1.25)


@TRIALS.of("held values")
def a_stuck_stretch(made, rng, folder):
    count = int(rng.integers(15, 120))
    run, row, rows = place(made, rng, count)
    made.runs[run].y[rows] = made.runs[run].y[row]
    return Expected(f"rows {row} to {rows.stop - 1} of {run} hold one value", said=(run,), rows=(row,), near=2,
                    error=1.05)


@TRIALS.of("held values", TWO)
def one_marker_stuck(made, rng, folder):
    run, row, rows = place(made, rng, 60)
    made.runs[run].y[rows, 3:] = made.runs[run].y[row, 3:]
    return Expected(f"second marker stuck in rows {row} to {row + 59} of {run}", said=(run,), rows=(row,), near=2,
                    error=1.05)


@TRIALS.of("held values")
def an_irregular_slow_camera(made, rng, folder):
    for name in made.training():
        count = len(made.runs[name])
        keep = np.zeros(count, dtype=bool)
        keep[np.cumsum(rng.choice([3, 4], count)) % count] = True
        keep[0] = True
        made.runs[name].y = made.runs[name].y[np.maximum.accumulate(np.where(keep, np.arange(count), 0))]
    return Expected("positions every third or fourth row (28 Hz in 100 Hz)", remedy=("held|hold|repeat|rate",),
                    said=("held|hold|repeat|rate",), error=1.8)


# Markers ---------------------------------------------------------------------------------------------------------

@TRIALS.of("exchanged markers", TWO)
def a_block_of_one_run(made, rng, folder):
    count = int(rng.integers(5, 200))
    run, row, rows = place(made, rng, count)
    y = made.runs[run].y
    y[rows] = y[rows][:, [3, 4, 5, 0, 1, 2]]
    return Expected(f"markers exchanged in rows {row} to {rows.stop - 1} of {run}", said=(run,), rows=(row,), near=2,
                    error=1.14)


@TRIALS.of("exchanged markers", TWO)
def one_row(made, rng, folder):
    run, row, rows = place(made, rng)
    made.runs[run].y[rows] = made.runs[run].y[rows][:, [3, 4, 5, 0, 1, 2]]
    return Expected(f"markers exchanged in row {row} of {run} alone", said=(run,), rows=(row,), near=1, error=1.05)


@TRIALS.of("exchanged markers", THREE)
def two_of_three(made, rng, folder):
    run, row, rows = place(made, rng, 80)
    made.runs[run].y[rows] = made.runs[run].y[rows][:, [0, 1, 2, 6, 7, 8, 3, 4, 5]]
    return Expected(f"second and third of three markers exchanged in rows {row} to {row + 79} of {run}", said=(run,),
                    rows=(row,), near=2, error=1.14)


@TRIALS.of("exchanged markers", THREE)
def three_in_a_circle(made, rng, folder):
    run, row, rows = place(made, rng, 40)
    made.runs[run].y[rows] = made.runs[run].y[rows][:, [3, 4, 5, 6, 7, 8, 0, 1, 2]]
    return Expected(f"three markers in a circle in rows {row} to {row + 39} of {run}", said=(run,), rows=(row,), near=2,
                    error=1.14)


@TRIALS.of("exchanged markers", TWO)
def a_whole_run(made, rng, folder):
    run = str(rng.choice(made.controlled()))
    made.runs[run].y = made.runs[run].y[:, [3, 4, 5, 0, 1, 2]]
    return Expected(f"markers exchanged in all of {run}", remedy=(run,), said=(run,), error=1.14)


@TRIALS.of("exchanged markers", TWO)
def to_the_end_of_a_run_of_displacements(made, rng, folder):
    made.as_displacements()
    run, row, _ = place(made, rng)
    made.runs[run].y[row:] = made.runs[run].y[row:][:, [3, 4, 5, 0, 1, 2]]
    return Expected(f"markers exchanged from row {row} of {run} on, displacements", said=(run,), rows=(row,), near=2,
                    error=1.2)
