"""How our control step scales: `python experiments/benchmarks/control_scaling.py` (set OMP_NUM_THREADS=1).

Three series of runs on the instance of control_step.py: the horizon N; the state dimension, with linear models whose
state is a window of measurements; the number of circles to avoid, near the path and far from it.
CPU time per control step; failures are fallbacks; clearance is the smallest from any circle, negative inside.
A short run: --laps 1 --series states.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from functools import partial

import numpy as np
from control_step import BOUNDS, ModelPlant, machine, measure, oscillators, perturbed, predictive

from ssmr_torch.models.named_structures import koopman
from ssmr_torch.models.polynomial import PolynomialModel
from ssmr_torch.tasks.obstacles import random_circles
from ssmr_torch.tasks.references import figure_eight

HORIZONS = (3, 5, 10, 15, 20, 30, 40)
STATES = (6, 12, 24, 48, 96, 120)
CIRCLES = (0, 1, 3, 10, 20, 50, 100)
SAMPLES = 3000


def window_model(states: int, ridge: float = 1e-6) -> PolynomialModel:
    """z⁺ = A z + B u with z the newest states / 6 measurements, fitted to the plant's answer to random inputs.

    Raises ValueError when that is no whole number of measurements.
    """
    if states < 6 or states % 6:
        raise ValueError(f"{states} states; expected a multiple of the 6 outputs")
    delays, plant, rng = states // 6 - 1, ModelPlant(perturbed(oscillators(), 0.03)), np.random.default_rng(0)
    outputs, inputs = [plant.reset()], np.repeat(0.5 * rng.uniform(*BOUNDS, size=(SAMPLES // 10, 4)), 10, axis=0)
    outputs = np.array(outputs + [plant.step(u) for u in inputs]) + 3e-5 * rng.standard_normal((SAMPLES + 1, 6))
    scale = np.full(states, 0.04)
    windows = np.hstack([outputs[delays - lag:SAMPLES - lag] for lag in range(delays + 1)]) / scale
    known = np.hstack([windows, inputs[delays:]])
    gram = known.T @ known + ridge * len(known) * np.eye(known.shape[1])
    newest = np.linalg.solve(gram, known.T @ (outputs[delays + 1:] / scale[:6])).T
    A, B = np.eye(states, k=-6), np.zeros((states, 4))
    A[:6], B[:6] = newest[:, :states], newest[:, states:]
    return koopman(
        scale=scale, A=A, B=B, N=np.zeros((0, states, states)), pregain=np.zeros((0, 7)), set_points=np.zeros((0, 7)),
        degree=1, input_delays=0, constant=False, state_scale=np.ones(states), input_dim=4, output_dim=6,
        delays=delays, timestep=0.01, window_timestep=0.01, base_timestep=0.01)


def among_circles(count: int, laps: float):
    """The fast figure eight among so many seeded circles of 4 to 6 mm; some are in its way."""
    circles = random_circles(0, count, reach=0.050, diameters=(0.004, 0.006), gap=0.002) if count else ()
    return replace(figure_eight(laps=laps), obstacles=circles)


def series(name: str, laps: float, qp: str, N: int):
    """(what is varied, result of `measure`) for each size."""
    build = partial(predictive, qp=qp)
    if name == "horizon":
        yield from ((f"N = {horizon}", measure(horizon, laps, build)) for horizon in HORIZONS)
    elif name == "states":
        yield from ((f"{states} states", measure(N, laps, build, window_model(states))) for states in STATES)
    else:
        yield from ((f"{count} circles", measure(N, laps, build, task=among_circles(count, laps)))
                    for count in CIRCLES)


def main(arguments: list[str] | None = None) -> None:
    """One line per size."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--laps", type=float, default=3.0, help="of the figure eight, 79 control steps each")
    parser.add_argument("--series", nargs="+", default=["horizon", "states", "obstacles"],
                        choices=["horizon", "states", "obstacles"])
    parser.add_argument("--N", type=int, default=10, help="horizon of the series of states and obstacles")
    parser.add_argument("--qp", default="proxqp", help="solver of the controller")
    given = parser.parse_args(arguments)
    print(f"{machine('numba', 'proxsuite')}, {given.qp}")
    print(f"{'':<12} {'steps':>6} {'CPU median':>11} {'CPU p99':>11} {'largest':>11} {'failures':>9} {'RMSE':>9} "
          f"{'clearance':>10}")
    for name in given.series:
        for size, result in series(name, given.laps, given.qp, given.N):
            median, p99 = np.percentile(result["cpu"], (50, 99))
            clearance = f"{result['clearance']:>7.2f} mm" if np.isfinite(result["clearance"]) else ""
            print(f"{size:<12} {result['steps']:>6} {median:>8.3f} ms {p99:>8.3f} ms {max(result['cpu']):>8.3f} ms "
                  f"{result['failures']:>9} {result['rmse']:>6.3f} mm {clearance}", flush=True)


if __name__ == "__main__":
    main()
