"""Time of our control step over the horizon, the number of states, and the number of obstacles.

Three series of runs on the instance of tracking_instance.py: the horizon N; the state dimension, with linear models
whose state is a window of measurements; the number of circles to avoid, near the path and far from it.
CPU time per control step; failures are fallbacks; clearance is the smallest from any circle, negative inside.
A short run: ssmr benchmark scaling laps=1 series=[states]
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from ssmr_torch.benchmarks.tracking_instance import (
    BOUNDS,
    ModelPlant,
    measure,
    oscillators,
    perturbed,
    predictive,
)
from ssmr_torch.checked_arguments import checked
from ssmr_torch.models.named_structures import koopman
from ssmr_torch.models.polynomial import PolynomialModel
from ssmr_torch.quantities import TEXT
from ssmr_torch.ranges import Each, Number, Whole
from ssmr_torch.tasks.obstacles import random_circles
from ssmr_torch.tasks.references import figure_eight

SERIES = ("horizon", "states", "obstacles")
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


@checked(series=Each(TEXT), laps=Number(1e-2, 1e4), N=Whole(1, 500), qp=TEXT, horizons=Each(Whole(1, 500), 1, 100),
         states=Each(Whole(1, 500), 1, 100), circles=Each(Whole(0, 1000), 1, 100))
def rows(*, series: Sequence[str] = SERIES, laps: float = 3.0, N: int = 10, qp: str = "proxqp",
         horizons: Sequence[int] = (3, 5, 10, 15, 20, 30, 40), states: Sequence[int] = (6, 12, 24, 48, 96, 120),
         circles: Sequence[int] = (0, 1, 3, 10, 20, 50, 100)) -> Iterator[dict]:
    """One row per size.

    laps: of the figure eight, 79 control steps each.   N: horizon of the series of states and obstacles.   qp: solver
    of the controller.   Raises ValueError for a series that is none.
    """
    unknown = sorted(set(series) - set(SERIES))
    if unknown:
        raise ValueError(f"series has {', '.join(unknown)}; known are {', '.join(SERIES)}")
    build = partial(predictive, qp=qp)
    for horizon in horizons if "horizon" in series else ():
        yield _row(f"N = {horizon}", measure(horizon, laps, build))
    for count in states if "states" in series else ():
        yield _row(f"{count} states", measure(N, laps, build, window_model(count)))
    for count in circles if "obstacles" in series else ():
        yield _row(f"{count} circles", measure(N, laps, build, task=among_circles(count, laps)))


def _row(size: str, found: dict) -> dict:
    median, late = np.percentile(found["cpu"], (50, 99))
    return {"size": size, "steps": found["steps"], "CPU median, ms": float(median), "CPU 99 %, ms": float(late),
            "CPU largest, ms": float(max(found["cpu"])), "failures": found["failures"],
            "RMSE, mm": float(found["rmse"]),
            "clearance, mm": float(found["clearance"]) if np.isfinite(found["clearance"]) else None}
