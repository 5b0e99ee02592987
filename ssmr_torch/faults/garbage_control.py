"""Very many control steps, one in twenty with a fault: no exception, inputs within bounds, memory that stays flat."""

from __future__ import annotations

import gc
import logging
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from time import thread_time

import numpy as np

from ssmr_torch.benchmarks.endurance import LIMIT, memory
from ssmr_torch.benchmarks.hostile import KINDS, measured
from ssmr_torch.benchmarks.tracking_instance import BOUNDS, ModelPlant, oscillators, perturbed
from ssmr_torch.faults.outcome import Found

KIND = "garbage in control"
CONTROLLERS = ("SSMR on the chart", "SSMR, extended Kalman", "SSMR, actuator", "static pregain")
SHARE = 0.05            # of the steps that have a fault
TIMESTEP = 0.01         # s
RESET_EVERY, CHECKPOINTS = 500, 10
NEAR = 1e-3             # m, of a measurement with noise alone


@dataclass
class Endured:
    """faults: steps with one. exceptions: by text. outside: inputs out of bounds. grown: MB. longest: step, s."""

    faults: int = 0
    exceptions: Counter = field(default_factory=Counter)
    outside: int = 0
    grown: float = 0.0
    longest: float = 0.0
    counts: Counter = field(default_factory=Counter)


def steps(count: int, seed: int = 0) -> list[dict]:
    """So many control steps in all, shared by the controllers; a row for each controller.

    Faults: measurements that are spoilt, missing, masked or no numbers; time that stops, goes back or jumps; samples
    that are skipped.
    """
    level = logging.getLogger("ssmr_torch").level
    logging.getLogger("ssmr_torch").setLevel(logging.CRITICAL)
    try:
        own = max(1, count // len(CONTROLLERS))
        return [_found(name, own, endured(KINDS[name], own, seed)).row() for name in CONTROLLERS]
    finally:
        logging.getLogger("ssmr_torch").setLevel(level)


def endured(build: Callable, count: int, seed: int = 0) -> Endured:
    """So many steps of the controller that `build` makes, on a plant that differs from its model by 3 %."""
    controller, found, rng = build(), Endured(), np.random.default_rng(seed)
    plant = ModelPlant(perturbed(oscillators(), 0.03))
    plant.model = replace(plant.model, substeps=1)
    observation, sample, before = plant.reset(), 0, None
    for k in range(count):
        fault = rng.uniform() < SHARE
        given, time, moved = _spoilt(rng, observation, sample) if fault else (observation, TIMESTEP * sample, 1)
        found.faults += fault
        began = thread_time()
        applied = _asked(controller, time, given, found)
        found.longest = max(found.longest, thread_time() - began)
        for _ in range(moved):
            observation = plant.step(applied)
        sample += moved
        if k % RESET_EVERY == RESET_EVERY - 1:  # it shall not only be lost
            observation = plant.reset()
        if (k + 1) % max(1, count // CHECKPOINTS) == 0:
            gc.collect()
            before = memory() if before is None else before
            found.grown = memory() - before
    found.counts = Counter(controller.counts)
    return found


def _spoilt(rng, observation: np.ndarray, sample: int):
    """(measurement, time s, samples that pass) with one fault."""
    kind = int(rng.integers(5))
    if kind == 0:
        return np.full(len(observation), np.nan), TIMESTEP * sample, 1
    if kind < 3:
        return _hostile(rng, observation), TIMESTEP * sample, 1
    if kind == 3:
        return observation, float(rng.choice([np.nan, np.inf, -1.0, 1e300, TIMESTEP * (sample - 1)])), 1
    return observation, TIMESTEP * sample, int(rng.integers(2, 40))


def _hostile(rng, observation: np.ndarray):
    """A measurement that is no clean one with noise."""
    while True:
        given = measured(rng, observation)
        clean = isinstance(given, np.ndarray) and not np.ma.isMaskedArray(given) and given.dtype == float \
            and np.abs(given - observation).max() < NEAR
        if not clean:
            return given


def _asked(controller, time: float, given, found: Endured) -> np.ndarray:
    """The input for the robot; the one of rest where an exception left the controller or the input is no number."""
    try:
        command = controller(time, given)
    except Exception as error:  # whatever it is: that is what is looked for
        found.exceptions[f"{type(error).__name__}: {error}"[:80]] += 1
        return np.zeros(len(BOUNDS[0]))
    wrong = not (np.isfinite(command.input).all() and (BOUNDS[0] <= command.input).all()
                 and (command.input <= BOUNDS[1]).all())
    found.outside += wrong
    return np.zeros(len(BOUNDS[0])) if wrong else command.input


def _found(name: str, count: int, after: Endured) -> Found:
    case = f"{name}: {count} steps, {after.faults} with a fault"
    told = ", ".join(f"{number} {what}" for what, number in sorted(after.counts.items()))
    said = f"memory {after.grown:+.1f} MB, longest step {1e3 * after.longest:.3g} ms, {told}"
    if after.exceptions:
        return Found(KIND, case, "traceback", "; ".join(f"{n} × {what}" for what, n in after.exceptions.items()))
    if after.outside or after.grown > LIMIT:
        return Found(KIND, case, "wrong", f"{after.outside} inputs out of bounds, {said}")
    return Found(KIND, case, "survived", said)
