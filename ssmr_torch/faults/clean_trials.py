"""Clean recordings in many shapes: nothing may be said of them, and nothing may be changed."""

from __future__ import annotations

import numpy as np

from ssmr_torch.faults.made_recordings import HELD, NOISE, MadeRecordings, Robot, made_recordings
from ssmr_torch.faults.outcome import Expected
from ssmr_torch.faults.trial import Trials

TRIALS = Trials()
KIND = "clean recordings"


def clean(case: str, **more) -> Expected:
    return Expected(case, refused=False, silent=True, unchanged=True, **more)


def driven(made: MadeRecordings, inputs, rng, noise: float = NOISE) -> None:
    """Every run with inputs again, under inputs(count, number of inputs)."""
    for name in (*made.controlled(), "test"):
        run = made.runs[name]
        run.u = inputs(len(run), made.robot.inputs)
        run.y = made.robot.positions(run.u, np.zeros(2 * made.robot.modes))
        run.y = run.y + noise * rng.normal(size=run.y.shape)


def replaced(made: MadeRecordings, other: MadeRecordings) -> None:
    made.robot, made.runs, made.card = other.robot, other.runs, other.card


def ramps(rng, count: int, inputs: int, every: int = 250) -> np.ndarray:
    knots = 2 * rng.uniform(-1, 1, (count // every + 2, inputs))
    return np.column_stack([np.interp(np.arange(count), every * np.arange(len(knots)), column) for column in knots.T])


@TRIALS.of(KIND)
def as_they_are(made, rng, folder):
    return clean("the base set", error=1.001)


@TRIALS.of(KIND)
def rounded(made, rng, folder):
    step = float(rng.choice([0.01, 0.1, 0.2]))
    for run in made.runs.values():
        run.y = step * np.round(run.y / step)
    return clean(f"rounded to {step:g} mm", error=1.3)


@TRIALS.of(KIND)
def noisy(made, rng, folder):
    size = float(rng.choice([0.05, 0.2, 0.5]))
    for run in made.runs.values():
        run.y = run.y + size * rng.normal(size=run.y.shape)
    return clean(f"noise of {size:g} mm")


@TRIALS.of(KIND)
def without_noise(made, rng, folder):
    replaced(made, made_recordings(Robot(), noise=0.0))
    made.digits = 12
    return clean("no noise at all")


@TRIALS.of(KIND)
def one_decay(made, rng, folder):
    for name in made.decays()[1:]:
        del made.runs[name]
    made.card |= {"files": [f"{name}.csv" for name in made.runs], "decays": ["d1"]}
    return clean("a single decay")


@TRIALS.of(KIND)
def no_decays(made, rng, folder):
    for name in made.decays():
        del made.runs[name]
    made.card |= {"files": [f"{name}.csv" for name in made.runs], "decays": []}
    return clean("no decays")


@TRIALS.of(KIND)
def fast_sampling(made, rng, folder):
    replaced(made, made_recordings(Robot(), timestep=0.001, seconds=4.0, seed=1))
    return clean("1 kHz")


@TRIALS.of(KIND)
def slow_sampling(made, rng, folder):
    replaced(made, made_recordings(Robot(), timestep=0.05, seconds=60.0, decay_seconds=4.0, seed=1))
    return clean("20 Hz")


@TRIALS.of(KIND)
def steps(made, rng, folder):
    driven(made, lambda count,
           inputs: np.repeat(rng.choice([-2.0, 0.0, 2.0], (count // 150 + 1, inputs)), 150, 0)[:count],
           rng)
    return clean("steps of 1.5 s between −2, 0 and 2")


@TRIALS.of(KIND)
def slow_ramps(made, rng, folder):
    driven(made, lambda count, inputs: ramps(rng, count, inputs), rng)
    return clean("slow ramps")


@TRIALS.of(KIND)
def a_growing_motion(made, rng, folder):
    k = np.arange(1500)
    driven(made, lambda count, inputs: np.linspace(0, 2, count)[:, None] * np.sin(
        0.05 * k[:count, None] + np.arange(inputs)), rng)
    return clean("sines that grow from nothing")


@TRIALS.of(KIND)
def dither(made, rng, folder):
    driven(made, lambda count, inputs: ramps(rng, count, inputs) + np.repeat(
        0.1 * rng.normal(size=(count // 2 + 1, inputs)), 2, 0)[:count], rng)
    return clean("ramps with dither of each 20 ms")


@TRIALS.of(KIND)
def still_phases(made, rng, folder):
    for name in made.controlled():
        made.runs[name].u[500:800] = 0.0
        made.runs[name].y = made.robot.positions(made.runs[name].u, np.zeros(4)) + 0.0
        made.runs[name].y += NOISE * rng.normal(size=made.runs[name].y.shape)
    return clean("3 s without input in each run")


@TRIALS.of(KIND)
def still_phases_that_are_rounded(made, rng, folder):
    for name in made.controlled():
        made.runs[name].u[500:900] = 0.0
        made.runs[name].y = np.round(made.robot.positions(made.runs[name].u, np.zeros(4)), 1)
    return clean("rest of 4 s, rounded to 0.1 mm: the same number for seconds")


@TRIALS.of(KIND)
def a_hit(made, rng, folder):
    run, row = "c2", int(rng.integers(300, 1200))
    made.runs[run].u[row:row + 4] += 6.0
    made.runs[run].y = made.robot.positions(made.runs[run].u, np.zeros(4))
    made.runs[run].y += NOISE * rng.normal(size=made.runs[run].y.shape)
    return clean(f"an input of 40 ms from row {row} of {run} that makes the robot jerk")


@TRIALS.of(KIND)
def one_mode_and_one_input(made, rng, folder):
    replaced(made, made_recordings(Robot(modes=1, inputs=1), seed=2))
    return clean("one mode, one input")


@TRIALS.of(KIND)
def three_markers_and_four_inputs(made, rng, folder):
    replaced(made, made_recordings(Robot(modes=3, markers=3, inputs=4), seed=3))
    return clean("three modes, three markers, four inputs")


@TRIALS.of(KIND)
def far_slower(made, rng, folder):
    for run in made.runs.values():
        run.time = 10 * run.time
    return clean("ten times as slow, 10 Hz")


@TRIALS.of(KIND)
def displacements_in_metres(made, rng, folder):
    made.as_displacements()
    return clean("displacements, rest 0, 0, 0", error=1.001)


@TRIALS.of(KIND)
def a_step_from_rest(made, rng, folder):
    for name in made.controlled():
        run = made.runs[name]
        run.u[:200] = 0.0
        run.y = made.robot.positions(run.u, np.zeros(4)) + NOISE * rng.normal(size=run.y.shape)
    return clean("2 s of rest, then inputs")


@TRIALS.of(KIND)
def short_runs(made, rng, folder):
    for name in made.controlled():
        made.runs[name].keep(slice(0, 150))
    return clean("runs of 1.5 s")


@TRIALS.of(KIND)
def a_large_slow_motion(made, rng, folder):
    driven(made, lambda count, inputs: 8 * np.sin(2 * np.pi * np.arange(count)[:, None] / 1500 + np.arange(inputs)),
           rng)
    return clean("one slow turn of the whole workspace in 15 s")


@TRIALS.of(KIND)
def inputs_on_two_levels(made, rng, folder):
    driven(made, lambda count, inputs: np.repeat(rng.choice([0.0, 1.0], (count // HELD + 1, inputs)), HELD, 0)[:count],
           rng)
    return clean("valves: inputs 0 or 1")


@TRIALS.of(KIND)
def a_clock_with_an_offset(made, rng, folder):
    for run in made.runs.values():
        run.time = run.time + 12345.5
    return clean("clocks that begin at 12345.5 s", error=1.001)
