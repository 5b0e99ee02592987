"""Time and memory of one sample of the finite-element plants, for every linear solver.

Each row is a process of its own on one thread: `steps` steps under random tensions that change every 0.3 s, after 20 to
warm up. A sample lasts 10 ms, so a plant below that can stand in for a robot in real time.
"""

from __future__ import annotations

import os
import resource
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from time import perf_counter, thread_time

import numpy as np

from ssmr_torch.benchmarks.machine import THREADS
from ssmr_torch.checked_arguments import checked
from ssmr_torch.plants.diamond import Diamond
from ssmr_torch.plants.trunk import Trunk
from ssmr_torch.quantities import TEXT
from ssmr_torch.ranges import Each, OrNone, Whole

WARM_UP = 20
CONTINUUM = {"law": "neo_hookean", "mass_distribution": "volume", "scheme": "generalized_alpha"}
ROBOTS = {"trunk": Trunk, "trunk_coarse": Trunk, "diamond": Diamond, "diamond_coarse": Diamond}
CASES = [(robot, {"linear_solver": solver}) for robot in ROBOTS for solver in ("block_ldl", "superlu", "pardiso")] + [
    (robot, CONTINUUM) for robot in ROBOTS]


def measure(robot: str, settings: dict, steps: int) -> dict:
    """CPU and wall time of each step, ms, and the memory of the process, MB."""
    plant = ROBOTS[robot](robot, **settings)
    rng, inputs = np.random.default_rng(0), None
    cpu, wall = [], []
    for k in range(WARM_UP + steps):
        if k % 30 == 0:
            inputs = 0.5 * rng.uniform(*plant.input_bounds)
        starts = thread_time(), perf_counter()
        plant.step(inputs)
        cpu.append(1e3 * (thread_time() - starts[0]))
        wall.append(1e3 * (perf_counter() - starts[1]))
    return {"origin": plant.origin, "cpu": cpu[WARM_UP:], "wall": wall[WARM_UP:],
            "memory": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024, "period": 1e3 * plant.timestep}


@checked(steps=Whole(1, 10**7), robots=OrNone(Each(TEXT, 0, 1000)))
def rows(*, steps: int = 300, robots: Sequence[str] | None = None) -> Iterator[dict | str]:
    """One row per plant and linear solver; a remark where the solver is not installed.   robots: None: all.

    Raises ValueError for a robot that is none.
    """
    robots = list(ROBOTS) if robots is None else list(robots)
    unknown = sorted(set(robots) - set(ROBOTS))
    if unknown:
        raise ValueError(f"robots has {', '.join(unknown)}; known are {', '.join(ROBOTS)}")
    os.environ |= dict.fromkeys(THREADS, "1")
    for robot, settings in (case for case in CASES if case[0] in robots):
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as process:
            try:
                found = process.submit(measure, robot, settings, steps).result()
            except ValueError as missing:
                yield f"{robot} {settings['linear_solver']}: {missing}"
                continue
        (median, late), wall = np.percentile(found["cpu"], (50, 99)).tolist(), float(np.median(found["wall"]))
        yield {"plant": robot, "solver": settings.get("linear_solver", "generalized_alpha"),
               "nodes": found["origin"]["nodes"], "elements": found["origin"]["tetrahedra"], "CPU median, ms": median,
               "CPU 99 %, ms": late, "wall median, ms": wall, "of real time": wall / found["period"],
               "memory, MB": found["memory"]}
