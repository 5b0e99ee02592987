"""Letters among random circles, which no set of circles may make the robot touch.

A robot is recorded and a model fitted to it; a controller with an observer of the output's disturbance is tightened by
what it mispredicts on the recorded test runs. It then draws ETH through each set of twenty circles, which the letters
lead into; the circles are 3 mm apart, so there is always a way round. Where the robot truly was is judged at 1 ms. One
row per set, and the summary as a remark. It fails where a set was violated.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ssmr_torch import configuration
from ssmr_torch.benchmarks.robots import kept
from ssmr_torch.benchmarks.table import BenchmarkFailed
from ssmr_torch.checked_arguments import checked
from ssmr_torch.closed_loop.simulation import simulate
from ssmr_torch.control.kalman_observers import KalmanObserver
from ssmr_torch.control.mpc import ModelPredictiveController
from ssmr_torch.control.tightening import tightened
from ssmr_torch.deployment import artifact
from ssmr_torch.evaluation.metrics import closed_loop_metrics
from ssmr_torch.fitting.fit import fit
from ssmr_torch.quantities import LENGTH, NOISE, PATH, TEXT, TRUTH
from ssmr_torch.ranges import Number, OrNone, Whole
from ssmr_torch.tasks.obstacles import random_circles
from ssmr_torch.tasks.symbols import symbol
from ssmr_torch.trajectory import Trajectory

# Of the inputs in units of their range: ten times the default, as on the finite-element trunk.
INPUT_WEIGHT = 2250.0


class Outcome(NamedTuple):
    """One set: its seed, share of the time inside a circle and depth (m) at 1 ms, RMSE (m) to the letters, fallbacks,
    the largest violation that a plan foresaw (m), and the longest step's CPU time (s).
    """

    seed: int
    inside: float
    depth: float
    rmse: float
    fallbacks: float
    planned: float
    slowest: float


def letters(seed: int, half_size: float, duration: float, tracked=("tip_x", "tip_y")):
    """ETH among the set's circles, which grow with the letters: 8 to 12 mm for letters of ±20 mm."""
    size = half_size / 0.020
    circles = random_circles(seed, reach=0.030 * size, diameters=(0.008 * size, 0.012 * size), free=0.010 * size,
                             gap=0.003 * size)
    return symbol("ETH", half_size, duration, 0.7, tracked, name="ETH among obstacles", obstacles=circles)


def designed(model, plant, task, runs, **settings) -> ModelPredictiveController:
    """The controller for this task; runs: those that tighten it, none where they are empty."""
    controller = ModelPredictiveController(model, task, plant.input_bounds, timestep=plant.timestep,
                                           output_names=plant.output_names, input_weight=INPUT_WEIGHT, **settings)
    return tightened(controller, runs) if runs else controller


def noisy(run: Trajectory, noise_std: float) -> Trajectory:
    """The run as the controller's sensors would have seen it."""
    noise = noise_std * np.random.default_rng(0).standard_normal(run.observation.shape)
    return Trajectory(run.time, run.observation + noise, run.input)


def outcome(seed: int, plant, controller, task, noise_std: float) -> Outcome:
    """The controller on the plant through the task, judged."""
    record = simulate(plant, controller, task, seed=seed, noise_std=noise_std)
    found = closed_loop_metrics(record, task.obstacles)
    return Outcome(seed, found["violation_ratio"], found["max_violation"], found["rmse"], found["fallbacks"],
                   found["planned_violation"], float(np.nanmax(record.solve_time)))


def summary(outcomes: list[Outcome]) -> str:
    """Means and the worst over the sets."""
    values = np.array([one[1:] for one in outcomes])
    violated, (inside, depth) = int((values[:, 1] > 0).sum()), values[:, :2].max(axis=0)
    return (f"{len(outcomes)} sets: {violated} violated; inside {100 * values[:, 0].mean():.3g} % of the time, at most "
            f"{100 * inside:.3g} %; deepest {1e3 * depth:.3g} mm; RMSE {1e3 * values[:, 2].mean():.3g} mm; "
            f"{values[:, 3].sum():.0f} fallbacks; plans violated {1e3 * values[:, 4].max():.3g} mm at most; longest "
            f"step {1e3 * values[:, 5].max():.3g} ms")


@checked(plant=TEXT, folder=OrNone(PATH), kind=TEXT, model=OrNone(PATH), sets=Whole(1, 100_000),
         first=Whole(0, 1_000_000), half_size=Number(1e-6, 100.0, "m"), duration=Number(1e-2, 1e5, "s"),
         quantile=Number(1e-6, 1 - 1e-6), noise=LENGTH, chart=TRUTH, process_noise=NOISE, hard=TRUTH)
def rows(*, plant: str = "slow_manifold", folder: str | None = None, kind: str = "auto", model: str | None = None,
         sets: int = 100, first: int = 0, half_size: float = 0.020, duration: float = 10.0, quantile: float = 0.99,
         noise: float = 3e-5, chart: bool = False, process_noise: float = 1e-3,
         hard: bool = False) -> Iterator[dict | str]:
    """One row per set of circles, remarks with the margins and the summary.

    plant: its name in conf/plant.   folder: keeps the recording, and is read the next time.   kind: of the model that
    is fitted.   model: folder of an artifact to take instead.   first: seed of the first set.   half_size: of the
    letters, m.   duration: s.   quantile: of the errors that give the margins; 0: none.   noise: of every measured
    value, m.   chart: the state from the chart alone, without an observer.   process_noise: of the observer, see
    `KalmanObserver`.   hard: constraints that the inputs can keep are kept.
    Raises `BenchmarkFailed` after the last set where one was violated.
    """
    configuration.register()
    data = kept(plant, None if folder is None else Path(folder))
    robot = configuration.built(configuration.composed("collect", [f"plant={plant}"]).plant)
    learned = artifact.load(model).model if model else fit(data, kind)
    runs = [noisy(run.read(), noise) for run in data.select("test", kind="controlled")] if quantile else []
    settings = {"hard_constraints": hard, "observer": None if chart else partial(KalmanObserver,
                                                                                process_noise=process_noise)}
    settings |= {"margin_quantile": quantile} if quantile else {}
    outcomes: list[Outcome] = []
    for seed in range(first, first + sets):
        task = letters(seed, half_size, duration, robot.output_names[:2])
        controller = designed(learned, robot, task, runs, **settings)
        if not outcomes and controller.settings.margins is not None:
            yield "margins: " + ", ".join(f"{1e3 * margin:.3g}" for margin in controller.settings.margins) + " mm"
        outcomes.append(one := outcome(seed, robot, controller, task, noise))
        yield {"set": seed, "inside, %": 100 * float(one.inside), "depth, mm": 1e3 * float(one.depth),
               "RMSE, mm": 1e3 * float(one.rmse), "fallbacks": int(one.fallbacks),
               "planned violation, mm": 1e3 * float(one.planned), "slowest step, ms": 1e3 * float(one.slowest)}
    yield summary(outcomes)
    violated = sum(one.depth > 0 for one in outcomes)
    if violated:
        raise BenchmarkFailed(f"{violated} of {sets} sets were violated; expected none")
