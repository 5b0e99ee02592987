"""Recordings whose level is wrong: drift, a rest of other data, decays that do not rest, units, copies, empty rows."""

from __future__ import annotations

import numpy as np

from ssmr_torch.faults.made_recordings import MadeRun, Robot
from ssmr_torch.faults.measurement_trials import place
from ssmr_torch.faults.outcome import Expected
from ssmr_torch.faults.trial import Trials

TRIALS = Trials()
TWO = Robot(markers=2)


def removed(made, rng) -> bool:
    """Whether the card asks that drift is removed."""
    asked = bool(rng.integers(2))
    if asked:
        made.card["faults"] = {"drift": "remove"}
    return asked


@TRIALS.of("drift")
def one_run_drifts(made, rng, folder):
    run, size, column = str(rng.choice(made.controlled())), float(rng.uniform(6, 15)), int(rng.integers(3))
    made.runs[run].y[:, column] += np.linspace(0, size, 1500)
    limit = 1.3 if removed(made, rng) else None
    name = made.observation[column]
    return Expected(f"{name} of {run} drifts by {size:.0f} mm in 15 s, {'removed' if limit else 'kept'}",
                    remedy=("drift", run), said=("drift", run), error=limit)


@TRIALS.of("drift")
def runs_at_other_levels(made, rng, folder):
    size = float(rng.uniform(5, 9))
    made.runs["c2"].y[:, 0] += size
    made.runs["c3"].y[:, 0] -= size
    limit = 1.3 if removed(made, rng) else None
    return Expected(f"x of c2 {size:+.0f} mm, of c3 {-size:+.0f} mm, {'removed' if limit else 'kept'}",
                    remedy=("drift|level|shift|rest", "c2"), said=("drift|level|shift|rest", "c2", "c3"), error=limit)


@TRIALS.of("drift")
def the_camera_was_knocked(made, rng, folder):
    run, row, _ = place(made, rng, margin=300)
    made.runs[run].y[row:] += [6.0, -4.0, 5.0]
    limit = 1.3 if removed(made, rng) else None
    return Expected(f"all positions 9 mm off from row {row} of {run} on, {'removed' if limit else 'kept'}",
                    remedy=(run,), said=(run,), rows=(row,), near=3, error=limit)


@TRIALS.of("drift", TWO)
def a_marker_comes_loose(made, rng, folder):
    run = str(rng.choice(made.controlled()))
    made.runs[run].y[:, 3:] += np.linspace(0, 1, 1500)[:, None] * [4.0, 8.0, -6.0]
    limit = 1.3 if removed(made, rng) else None
    return Expected(f"the second marker of {run} drifts by 11 mm, {'removed' if limit else 'kept'}", remedy=(run,),
                    said=("drift", run), error=limit)


@TRIALS.of("rest of other data")
def the_rest_has_another_sign(made, rng, folder):
    made.card["rest"][0] = -25.0
    return Expected("rest x −25 where the decays end at 5 mm", remedy=("30 mm", "rest"), said=("30 mm", "rest"))


@TRIALS.of("rest of other data")
def displacements_with_a_rest(made, rng, folder):
    for run in made.runs.values():
        run.y = run.y - made.robot.rest
    return Expected("displacements, but a rest of positions", remedy=("120 mm", "rest"), said=("120 mm", "rest"))


@TRIALS.of("rest of other data")
def positions_said_to_be_centred(made, rng, folder):
    made.card["centred"] = made.decays()[:3]
    return Expected("positions, but three decays are said to be centred", remedy=("centred|rest",),
                    said=("centred|rest",))


@TRIALS.of("rest of other data")
def axes_in_another_order(made, rng, folder):
    made.card["rest"] = [made.card["rest"][k] for k in (2, 1, 0)]
    return Expected("rest as z, y, x", remedy=("115 mm", "rest"), said=("115 mm", "rest"))


@TRIALS.of("rest of other data", TWO)
def the_second_marker_has_no_rest(made, rng, folder):
    made.card["rest"][3:] = [0.0, 0.0, 0.0]
    return Expected("rest 0, 0, 0 of the second marker", remedy=("60 mm", "rest"), said=("60 mm", "rest"))


@TRIALS.of("decays without rest")
def all_still_moving(made, rng, folder):
    count = int(rng.integers(30, 60))
    for name in made.decays():
        made.runs[name].keep(slice(0, count))
    made.card["rest"] = "last sample of decays"
    return Expected(f"six decays of {count} rows, rest from them", remedy=("rest|moving|speed",),
                    said=("mm/s|m/s|moving|apart|spread|within",))


@TRIALS.of("decays without rest")
def one_of_them_ends_elsewhere(made, rng, folder):
    size = float(rng.uniform(8, 20))
    made.runs["d4"].y[:, 0] += size
    made.card["rest"] = "last sample of decays"
    return Expected(f"x of d4 ends {size:.0f} mm from the others", remedy=("d4",), said=("d4", f"{size:.0f}"),
                    error=3.0)


@TRIALS.of("decays without rest")
def a_single_moving_one(made, rng, folder):
    made.runs["d1"].keep(slice(0, 60))
    for name in made.decays()[1:]:
        del made.runs[name]
    made.card |= {"files": [f"{name}.csv" for name in made.runs], "decays": ["d1"], "rest": "last sample of decays"}
    return Expected("one decay of 0.6 s, rest from it", remedy=("d1",), said=("d1",))


@TRIALS.of("moving inputs of a decay")
def a_controlled_run_among_the_decays(made, rng, folder):
    run = str(rng.choice(made.controlled()))
    made.card["decays"].append(run)
    return Expected(f"{run} is said to be a decay", refused=True, remedy=(run, "input"))


@TRIALS.of("moving inputs of a decay")
def the_first_half_is_driven(made, rng, folder):
    made.runs["d2"].u[:40, 0] = 1.5
    made.runs["d2"].y = made.robot.positions(made.runs["d2"].u, np.zeros(4))
    return Expected("d2 is driven for 0.4 s, then falls", remedy=("d2", "input"), said=("d2", "input"))


@TRIALS.of("units")
def one_file_in_another_unit(made, rng, folder):
    run, scale = str(rng.choice(made.controlled())), float(rng.choice([0.001, 0.1]))
    made.runs[run].y = made.runs[run].y * scale
    return Expected(f"{run} in {'m' if scale < 0.01 else 'cm'}, the others in mm", remedy=(run,), said=(run,),
                    error=1.2)


@TRIALS.of("units")
def one_column_in_another_unit(made, rng, folder):
    column = int(rng.integers(3))
    for run in made.runs.values():
        run.y[:, column] /= 1000.0
    made.card["rest"][column] /= 1000.0
    return Expected(f"{made.observation[column]} in m, the others in mm", remedy=(f"\\b{made.observation[column]}\\b",),
                    said=(f"\\b{made.observation[column]}\\b",))


@TRIALS.of("units")
def an_output_that_never_moves(made, rng, folder):
    for run in made.runs.values():
        run.y[:, 1] = -3.0
    return Expected("y = −3 in every row", remedy=(r"\by\b",), said=(r"\by\b",))


@TRIALS.of("units")
def an_input_in_newtons_declared_as_millinewtons(made, rng, folder):
    made.card["units"]["input"] = "mN"
    return Expected("inputs of 2 N, declared as mN", remedy=("mN|largest_input|input",), said=("input",))


@TRIALS.of("units")
def one_run_of_inputs_in_percent(made, rng, folder):
    run = str(rng.choice(made.controlled()))
    made.runs[run].u = made.runs[run].u * 100
    made.card["largest_input"] = 300.0
    return Expected(f"inputs of {run} in %", remedy=(run,), said=(run,))


@TRIALS.of("units")
def a_dead_sensor_in_one_run(made, rng, folder):
    run = str(rng.choice(made.controlled()))
    made.runs[run].y[:, 2] = made.runs[run].y[0, 2]
    return Expected(f"z never moves in {run}", remedy=(run, r"\bz\b"), said=(run, r"\bz\b"), error=1.2)


@TRIALS.of("copies")
def a_copy_within_the_training(made, rng, folder):
    made.runs["c4"] = made.runs["c1"]
    made.card["files"].append("c4.csv")
    return Expected("c4 is a copy of c1", remedy=("c4", "c1"), said=("c4", "c1"))


@TRIALS.of("copies")
def the_test_is_a_training_run(made, rng, folder):
    run = str(rng.choice(made.controlled()))
    made.runs["test"] = made.runs[run]
    return Expected(f"test is a copy of {run}", refused=True, remedy=("test", run))


@TRIALS.of("copies")
def the_test_is_a_part_with_a_clock_of_its_own(made, rng, folder):
    first, source = int(rng.integers(100, 700)), made.runs["c2"]
    count = int(rng.integers(400, 800))
    made.runs["test"] = MadeRun(0.01 * np.arange(count), source.y[first:first + count], source.u[first:first + count])
    return Expected(f"test is rows {first} to {first + count - 1} of c2", refused=True, remedy=("test", "c2"))


@TRIALS.of("copies")
def the_test_begins_as_training_and_is_written_with_fewer_digits(made, rng, folder):
    source = made.runs["c3"]
    made.runs["test"] = MadeRun(source.time, np.round(source.y, 2), source.u)
    return Expected("test is c3 rounded to 0.01 mm", refused=True, remedy=("test", "c3"))


@TRIALS.of("rows never written")
def zeros_at_the_end(made, rng, folder):
    run, count = str(rng.choice(made.controlled())), int(rng.integers(20, 600))
    made.as_displacements()
    made.runs[run].y[-count:], made.runs[run].u[-count:] = 0.0, 0.0
    return Expected(f"{count} rows of zeros at the end of {run}", said=(run,), rows=(1500 - count,), near=1,
                    samples={run: 1500 - count}, error=1.05)


@TRIALS.of("rows never written")
def zeros_before_the_start(made, rng, folder):
    made.runs["c1"].y[:40], made.runs["c1"].u[:40] = 0.0, 0.0
    return Expected("40 rows of zeros before positions of c1", said=("c1",), rows=(39,), near=1, samples={"c1": 1460},
                    error=1.05)


@TRIALS.of("rows never written")
def the_clock_is_zero_too(made, rng, folder):
    run = made.runs["c2"]
    run.y[-100:], run.u[-100:], run.time[-100:] = 0.0, 0.0, 0.0
    return Expected("100 rows of zeros, clock too, at the end of c2", remedy=("c2", "1400"), said=("c2",), rows=(1400,),
                    near=1, samples={"c2": 1400}, error=1.05)
