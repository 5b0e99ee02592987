"""Hostile steps: every kind of controller under spoilt measurements, jumps of time and shut actuators.

Every controller of `KINDS` steers the plant of tracking_instance.py along the fast figure eight while measurements are
spoilt, skipped, masked or no numbers, time stops, jumps and is not finite, and actuators are shut and opened. A row
each: exceptions, commands that are not finite or out of bounds, the worst CPU time of a step and how many took more
than half the period, whether a reset makes it a fresh controller again, and what was counted. It fails where an
exception left a controller, a command was out of bounds, or a reset left something behind.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from time import thread_time

import numpy as np

from ssmr_torch.benchmarks.scaling import SAMPLES, among_circles, window_model
from ssmr_torch.benchmarks.table import BenchmarkFailed
from ssmr_torch.benchmarks.tracking_instance import BOUNDS, ModelPlant, oscillators, perturbed, predictive
from ssmr_torch.checked_arguments import checked
from ssmr_torch.control.actuator import Actuator
from ssmr_torch.control.disturbance_observer import DisturbanceObserver
from ssmr_torch.control.kalman_observers import KalmanObserver
from ssmr_torch.control.static_pregain import StaticPregainController
from ssmr_torch.models.named_structures import koopman
from ssmr_torch.quantities import SEED, TEXT
from ssmr_torch.ranges import Either, OneOf, Whole
from ssmr_torch.tasks.references import figure_eight

TIMESTEP, NOISE, HALF = 0.01, 3e-5, 0.5
TASK, SLOW = figure_eight(laps=30.0), figure_eight(angular_speed=0.2, laps=1.0)


def lifted_model(degree: int = 2, ridge: float = 1e-6):
    """z⁺ = A z + B u with z the monomials of the newest measurement, fitted to the plant's answer to random inputs."""
    plant, rng = ModelPlant(perturbed(oscillators(), 0.03)), np.random.default_rng(0)
    inputs = np.repeat(0.5 * rng.uniform(*BOUNDS, size=(SAMPLES // 10, 4)), 10, axis=0)
    outputs = np.array([plant.reset(), *(plant.step(u) for u in inputs)])
    rows = 6 + 21 * (degree == 2)
    build = partial(koopman, scale=np.full(6, 0.04), N=np.zeros((0, rows, rows)), pregain=np.zeros((0, 7)),
                    set_points=np.zeros((0, 7)), degree=degree, input_delays=0, constant=False,
                    state_scale=np.ones(rows), input_dim=4, output_dim=6, delays=0, timestep=TIMESTEP,
                    window_timestep=TIMESTEP, base_timestep=TIMESTEP)
    blank = build(A=np.zeros((rows, rows)), B=np.zeros((rows, 4)))
    lifted = np.stack([blank.encode(y[None], np.zeros((0, 4))) for y in outputs])
    known = np.hstack([lifted[:-1], inputs])
    gram = known.T @ known + ridge * len(known) * np.eye(rows + 4)
    table = np.linalg.solve(gram, known.T @ lifted[1:]).T
    return build(A=np.ascontiguousarray(table[:, :rows]), B=np.ascontiguousarray(table[:, rows:]))


def pregain_model():
    """The linear part of the oscillators with the pregain of its own equilibria."""
    model = oscillators()
    A, B, _ = model.linearize(np.zeros(6), np.zeros(4))
    static, common, pregain = np.linalg.solve(np.eye(6) - A, B)[:2], np.full(4, 0.3), np.zeros((4, 7))
    pregain[:, 1:3] = np.linalg.pinv(static)
    pregain[:, 0] = common - np.linalg.pinv(static) @ static @ common
    return koopman(scale=np.ones(6), A=A, B=B, N=np.zeros((0, 6, 6)), pregain=pregain, set_points=np.eye(7), degree=1,
                   input_delays=0, constant=False, state_scale=model.state_scale, input_dim=4, output_dim=6, delays=0,
                   timestep=TIMESTEP, window_timestep=TIMESTEP, base_timestep=TIMESTEP)


def _steers(model: Callable = oscillators, circles: int = 0, **changes) -> Callable:
    task = among_circles(circles, laps=30.0) if circles else TASK
    return lambda: predictive(model(), task, BOUNDS, **changes)


WATCH = partial(DisturbanceObserver, gain=np.vstack([0.3 * np.eye(6), 0.02 * np.eye(6)]), limit=0.05, lost=0.01,
                covariance=1e-8 * np.eye(6))
# what a designed controller has
DESIGNED = {"period": TIMESTEP, "horizon": 10, "move_weight": 300.0, "input_weight": 20.0, "huber": 5e-3,
            "approach": 0.5, "observer": WATCH}

KINDS = {
    "SSMR on the chart": _steers(),
    "SSMR, horizon 10, rate": _steers(horizon=10, input_rate=5.0),
    "SSMR, late measurements": _steers(measurement_delay=0.02),
    "SSMR, Kalman": _steers(observer=partial(KalmanObserver, disturbance="output")),
    "SSMR, extended Kalman": _steers(observer=partial(KalmanObserver, disturbance="input", extended=True)),
    "SSMR, actuator": _steers(**DESIGNED, actuator=Actuator(TIMESTEP, (0.6,) * 4, delay=2, lag=0.02)),
    "SSMR, rubbing actuator, rate": _steers(**DESIGNED, input_rate=5.0, actuator=Actuator(
        TIMESTEP, (0.6,) * 4, delay=1, lag=0.01, friction=0.05, play=0.02)),
    "SSMR, rate": _steers(input_rate=5.0),
    "SSMR, rate, daqp": _steers(input_rate=5.0, qp="daqp"),
    "SSMR, 20 circles, rate": _steers(circles=20, input_rate=5.0),
    "SSMR, 20 circles, daqp": _steers(circles=20, qp="daqp"),
    "SSMR, daqp": _steers(qp="daqp"),
    "DMD": _steers(partial(window_model, 18)),
    "DMD, Kalman": _steers(partial(window_model, 18), observer=partial(KalmanObserver, disturbance="output")),
    "EDMD": _steers(lifted_model),
    "static pregain": lambda: StaticPregainController(pregain_model(), SLOW, BOUNDS, input_weight=3.6e4),
}


@dataclass
class Outcome:
    """What hostile steps did to a controller; times in s."""

    exceptions: Counter = field(default_factory=Counter)
    outside: int = 0
    worst: float = 0.0
    late: int = 0
    counts: Counter = field(default_factory=Counter)
    fallbacks: Counter = field(default_factory=Counter)
    fresh: bool = True


def measured(rng: np.random.Generator, y: np.ndarray):
    """A measurement of y (6,), one in five of them hostile."""
    y = y + NOISE * rng.standard_normal(6)
    if rng.uniform() > 0.2:
        return y
    one = np.arange(6) == rng.integers(6)
    forms = (lambda: y + 10.0**rng.uniform(-3, 1) * rng.standard_normal(6), lambda: np.where(one, np.nan, y),
             lambda: y * np.nan, lambda: np.where(one, np.inf, y), lambda: np.where(one, -1e300, y),
             lambda: y + 1.0 * one, lambda: y.tolist(), lambda: np.ma.array(y, mask=one),
             lambda: np.round(1e3 * y).astype(int), lambda: [None, "lost", *y[2:]], lambda: y.astype(np.float32),
             lambda: y.astype(object), lambda: y + 0j, lambda: y + 0.2, lambda: np.full(6, 1e30))
    return forms[rng.integers(len(forms))]()


def times(rng: np.random.Generator) -> Iterator[tuple[float, int]]:
    """(time of the call, samples that the robot has moved on since the last one), one in ten of them hostile."""
    sample, offset = 0, 0.0
    while True:
        kind = rng.integers(80)
        moved = {1: 2, 2: 3, 3: 60, 4: 0}.get(kind, 1)
        offset = {5: offset + 100.0, 6: offset - 3.0}.get(kind, offset)
        sample += moved
        time = offset + sample * TIMESTEP
        yield {7: np.nan, 8: time + 0.4 * TIMESTEP, 9: 1e300, 10: -np.inf}.get(kind, time), moved


def bounds(rng: np.random.Generator) -> np.ndarray:
    """The bounds of the robot, with some of the actuators shut."""
    found = BOUNDS.copy()
    for dead in np.flatnonzero(rng.uniform(size=4) < 0.3):
        found[:, dead] = rng.uniform(*BOUNDS[:, dead])
    return found


def endure(build: Callable, steps: int, seed: int = 0) -> Outcome:
    """So many hostile steps of the controller that `build` makes."""
    controller, found, rng = build(), Outcome(), np.random.default_rng(seed)
    plant = ModelPlant(perturbed(oscillators(), 0.03))
    plant.model = replace(plant.model, substeps=1)
    observation, applied, calls = plant.reset(), np.zeros(4), times(rng)
    for k in range(steps):
        time, moved = next(calls)
        for _ in range(moved):
            observation = plant.step(applied)
        if k % 500 == 499:  # it shall not only be lost
            observation = plant.reset()
        if k % 200 == 100:
            controller.input_bounds = bounds(rng) if k % 400 == 100 else BOUNDS
        given, began = measured(rng, observation), thread_time()
        try:
            command = controller(time, given)
        except Exception as error:  # whatever it is: that is what is looked for
            found.exceptions[f"{type(error).__name__}: {error}"[:80]] += 1
            continue
        spent = thread_time() - began
        found.worst, found.late = max(found.worst, spent), found.late + (spent > HALF * controller.period)
        lower, upper = controller.input_bounds
        found.outside += not (np.isfinite(command.input).all() and (lower <= command.input).all()
                              and (command.input <= upper).all())
        applied = np.clip(np.nan_to_num(command.input), *BOUNDS)
        if k % 3 == 0 and hasattr(controller, "prepare"):
            controller.prepare()
    found.counts, found.fallbacks = controller.counts, controller.fallbacks
    found.fresh = _is_fresh(controller, build())
    return found


def _is_fresh(controller, other) -> bool:
    """Whether after a reset the controller and a fresh one give the same commands, to the last bit."""
    controller.input_bounds = BOUNDS
    controller.reset()
    rng = np.random.default_rng(1)
    waves = 0.01 * np.sin(0.1 * np.arange(100)[:, None] + np.arange(6)) + 1e-4 * rng.standard_normal((100, 6))
    return all((controller(TIMESTEP * k, y).input == other(TIMESTEP * k, y).input).all() for k, y in enumerate(waves))


@checked(steps=Whole(1, 10**9), seed=SEED, only=Either(TEXT, OneOf("")))
def rows(*, steps: int = 100_000, seed: int = 0, only: str = "") -> Iterator[dict | str]:
    """One row per controller, and a remark on what it counted and on every exception.

    steps: hostile calls of each controller.   only: controllers whose name contains this.
    Raises `BenchmarkFailed`, with the names, after the last row where one of them failed.
    """
    logging.getLogger("ssmr_torch").setLevel(logging.ERROR)  # a first measurement may be a hostile one
    failed = []
    for name, build in KINDS.items():
        if only not in name:
            continue
        found = endure(build, steps, seed)
        if found.exceptions or found.outside or not found.fresh:
            failed.append(name)
        yield {"controller": name, "exceptions": sum(found.exceptions.values()), "outside": found.outside,
               "worst step, ms": 1e3 * found.worst, "steps over half": found.late, "fresh again": found.fresh}
        told = {status.name.lower(): count for status, count in found.fallbacks.items()} | dict(found.counts)
        yield "    " + ", ".join(f"{count} {what}" for what, count in sorted(told.items()))
        yield from (f"    {count} times {what}" for what, count in found.exceptions.items())
    if failed:
        raise BenchmarkFailed("an exception, a command out of bounds or something left by a reset: "
                              f"{', '.join(failed)}")
