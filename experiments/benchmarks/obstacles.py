"""Letters among random circles: `python experiments/benchmarks/obstacles.py [--plant tendon_chain] [--sets 100]`.

A robot is recorded and a model fitted to it; a controller with an observer of the output's disturbance is tightened by
what it mispredicts on the recorded test runs. It then draws ETH through each set of twenty circles, which the letters
lead into; the circles are 3 mm apart, so there is always a way round. Where the robot truly was is judged at 1 ms. One
line for each set that was violated, and the summary. Exit status 1 where one was.
"""

from __future__ import annotations

import argparse
import sys
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from control_step import machine
from robots import kept

from ssmr_torch import configuration
from ssmr_torch.closed_loop.simulation import simulate
from ssmr_torch.control.kalman_observers import KalmanObserver
from ssmr_torch.control.mpc import ModelPredictiveController
from ssmr_torch.control.tightening import tightened
from ssmr_torch.deployment import artifact
from ssmr_torch.evaluation.metrics import closed_loop_metrics
from ssmr_torch.fitting.by_kind import fit
from ssmr_torch.tasks.obstacles import random_circles
from ssmr_torch.tasks.symbols import symbol
from ssmr_torch.trajectory import Trajectory

# Of the inputs in units of their range: ten times the default, as on the finite-element trunk.
INPUT_WEIGHT = 2250.0
PROGRESS = 10


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


def options() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--plant", default="slow_manifold", help="its name in conf/plant")
    parser.add_argument("--folder", type=Path, help="keep the recording here, and read it from there the next time")
    parser.add_argument("--kind", default="auto", help="kind of model that is fitted")
    parser.add_argument("--artifact", help="folder of a model to take instead of fitting one")
    parser.add_argument("--sets", type=int, default=100, help="sets of circles")
    parser.add_argument("--first", type=int, default=0, help="seed of the first set")
    parser.add_argument("--half-size", type=float, default=0.020, help="of the letters, m")
    parser.add_argument("--duration", type=float, default=10.0, help="of the drawing, s")
    parser.add_argument("--quantile", type=float, default=0.99, help="of the errors that give the margins; 0: none")
    parser.add_argument("--noise", type=float, default=3e-5, help="of every measured value, m")
    parser.add_argument("--chart", action="store_true", help="the state from the chart alone, without an observer")
    parser.add_argument("--process-noise", type=float, default=1e-3, help="of the observer, see KalmanObserver")
    parser.add_argument("--hard", action="store_true", help="constraints that the inputs can keep are kept")
    return parser


def main(arguments: list[str] | None = None) -> int:
    """One line per violated set and a summary; 1 where a set was violated."""
    given = options().parse_args(arguments)
    configuration.register()
    data = kept(given.plant, given.folder)
    plant = configuration.built(configuration.composed("collect", [f"plant={given.plant}"]).plant)
    model = artifact.load(given.artifact).model if given.artifact else fit(data, given.kind)
    runs = [noisy(run.read(), given.noise) for run in data.select("test", kind="controlled")] if given.quantile else []
    observer = None if given.chart else partial(KalmanObserver, process_noise=given.process_noise)
    settings = {"hard_constraints": given.hard, "observer": observer} \
        | ({"margin_quantile": given.quantile} if given.quantile else {})
    print(machine("numba", "proxsuite"))
    outcomes: list[Outcome] = []
    for seed in range(given.first, given.first + given.sets):
        task = letters(seed, given.half_size, given.duration, plant.output_names[:2])
        controller = designed(model, plant, task, runs, **settings)
        if not outcomes and controller.settings.margins is not None:
            print("margins: " + ", ".join(f"{1e3 * margin:.3g}" for margin in controller.settings.margins) + " mm")
        outcomes.append(outcome(seed, plant, controller, task, given.noise))
        if outcomes[-1].depth > 0:
            print(f"set {seed}: inside {100 * outcomes[-1].inside:.3g} % of the time, by "
                  f"{1e3 * outcomes[-1].depth:.3g} mm", flush=True)
        if len(outcomes) % PROGRESS == 0 and len(outcomes) < given.sets:
            print(f"  {len(outcomes)} of {given.sets} sets", flush=True)
    print(summary(outcomes))
    return int(any(one.depth > 0 for one in outcomes))


if __name__ == "__main__":
    sys.exit(main())
