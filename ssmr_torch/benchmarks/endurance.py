"""Memory and time of very many control steps; it fails where the memory grows.

One process follows the fast figure eight without end, on the instance of tracking_instance.py, with circles to avoid
where `obstacles` asks for them; every 1000th measurement is missing, so that fallbacks and fresh starts are in it. Ten
rows, each over a tenth of the steps. It fails when the memory grew by more than 5 MB after the first of them.
"""

from __future__ import annotations

import gc
import resource
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from time import thread_time

import numpy as np

from ssmr_torch.benchmarks.scaling import among_circles
from ssmr_torch.benchmarks.table import BenchmarkFailed
from ssmr_torch.benchmarks.tracking_instance import BOUNDS, ModelPlant, oscillators, perturbed, predictive
from ssmr_torch.checked_arguments import checked
from ssmr_torch.quantities import TEXT
from ssmr_torch.ranges import Whole

CHECKPOINTS, LIMIT, MISSING_EVERY = 10, 5.0, 1000
STATISTICS = Path("/proc/self/statm")


def memory() -> float:
    """Resident memory of this process, MB; its highest so far where the system does not tell the present one."""
    if STATISTICS.is_file():
        return int(STATISTICS.read_text(encoding="utf-8").split()[1]) * resource.getpagesize() / 1e6
    highest = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return highest / 1e6 if sys.platform == "darwin" else highest / 1e3


def endure(steps: int, horizon: int, obstacles: int, qp: str):
    """After every tenth of the steps: steps so far, memory in MB, CPU time of its steps in ms, fallbacks so far."""
    model, lap = oscillators(), 2 * np.pi / 4.0
    task = among_circles(obstacles, laps=2 + steps * 0.02 / lap)
    controller = predictive(model, task, BOUNDS, horizon=horizon, qp=qp)
    plant = ModelPlant(perturbed(model, 0.03))
    plant.model = replace(plant.model, substeps=1)  # a finer plant would take most of the time
    rng, observation, samples = np.random.default_rng(0), plant.reset(), round(0.02 / plant.timestep)
    cpu = np.full(steps // CHECKPOINTS, np.nan)
    for k in range(CHECKPOINTS * len(cpu)):
        for sample in range(samples):
            measured = observation + 3e-5 * rng.standard_normal(6)
            if sample == 0 and k % MISSING_EVERY == MISSING_EVERY - 1:
                measured[:] = np.nan
            start = thread_time()
            command = controller((samples * k + sample) * plant.timestep, measured)
            if sample == 0:
                cpu[k % len(cpu)] = 1e3 * (thread_time() - start)
            observation = plant.step(command.input)
        if (k + 1) % len(cpu) == 0:
            gc.collect()
            yield k + 1, memory(), cpu, sum(controller.fallbacks.values())


@checked(steps=Whole(10, 10**9), horizon=Whole(1, 500), obstacles=Whole(0, 1000), qp=TEXT)
def rows(*, steps: int = 100_000, horizon: int = 5, obstacles: int = 0, qp: str = "proxqp") -> Iterator[dict | str]:
    """One row per checkpoint: memory, CPU time of the steps since the last one, fallbacks so far.

    steps: control steps of 20 ms, at least 10.   obstacles: circles around the path.   qp: solver of the controller.
    Raises ValueError for fewer steps, and `BenchmarkFailed` where the memory grew.
    """
    if steps < CHECKPOINTS:
        raise ValueError(f"steps is {steps}; expected at least {CHECKPOINTS}")
    first = last = None
    for done, last, cpu, fallbacks in endure(steps, horizon, obstacles, qp):
        first = last if first is None else first
        median, late, later, largest = np.percentile(cpu, (50, 99, 99.9, 100)).tolist()
        yield {"steps": done, "memory, MB": last, "CPU median, ms": median, "CPU 99 %, ms": late,
               "CPU 99.9 %, ms": later, "CPU largest, ms": largest, "fallbacks": fallbacks}
    grown = f"{last - first:+.2f} MB after the first {steps // CHECKPOINTS} steps; at most {LIMIT:g} MB are accepted"
    yield grown
    if last - first > LIMIT:
        raise BenchmarkFailed(grown)
