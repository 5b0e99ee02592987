"""Memory and time of very many control steps: `python experiments/benchmarks/control_endurance.py --steps 100000`.

One process follows the fast figure eight without end, on the instance of control_step.py with circles to avoid where
--obstacles asks for them; every 1000th measurement is missing, so that fallbacks and fresh starts are in it. Ten lines,
each over a tenth of the steps. Exit status 1 when the memory grew by more than 5 MB after the first of them.
"""

from __future__ import annotations

import argparse
import gc
import resource
import sys
from dataclasses import replace
from pathlib import Path
from time import thread_time

import numpy as np
from control_scaling import among_circles
from control_step import BOUNDS, ModelPlant, machine, oscillators, perturbed, predictive

CHECKPOINTS, LIMIT, MISSING_EVERY = 10, 5.0, 1000
STATISTICS = Path("/proc/self/statm")


def memory() -> float:
    """Resident memory of this process, MB; its highest so far where the system does not tell the present one."""
    if STATISTICS.is_file():
        return int(STATISTICS.read_text().split()[1]) * resource.getpagesize() / 1e6
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


def main(arguments: list[str] | None = None) -> int:
    """One line per checkpoint; 1 where the memory grew."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--steps", type=int, default=100_000, help="control steps of 20 ms, at least 10")
    parser.add_argument("--horizon", type=int, default=5)
    parser.add_argument("--obstacles", type=int, default=0, help="circles around the path")
    parser.add_argument("--qp", default="proxqp", help="solver of the controller")
    given = parser.parse_args(arguments)
    if given.steps < CHECKPOINTS:
        parser.error(f"--steps is {given.steps}; expected at least {CHECKPOINTS}")
    print(machine("numba", "proxsuite"))
    print(f"{'steps':>8} {'memory':>11} {'CPU median':>11} {'CPU 99 %':>11} {'CPU 99.9 %':>11} {'CPU max':>11} "
          f"{'fallbacks':>10}")
    first = last = None
    for steps, last, cpu, fallbacks in endure(given.steps, given.horizon, given.obstacles, given.qp):
        first = last if first is None else first
        times = " ".join(f"{value:>8.3f} ms" for value in np.percentile(cpu, (50, 99, 99.9, 100)))
        print(f"{steps:>8} {last:>8.2f} MB {times} {fallbacks:>10}", flush=True)
    print(f"{last - first:+.2f} MB after the first {given.steps // CHECKPOINTS} steps; at most {LIMIT:g} are accepted")
    return int(last - first > LIMIT)


if __name__ == "__main__":
    sys.exit(main())
