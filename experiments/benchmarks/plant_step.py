"""Time and memory of one sample of the finite-element plants: `python experiments/benchmarks/plant_step.py`.

Each row is a process of its own on one thread: 300 steps under random tensions that change every 0.3 s, after 20 to
warm up. A sample lasts 10 ms, so a plant below that can stand in for a robot in real time.
"""

from __future__ import annotations

import os
import platform
import resource
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from time import perf_counter, thread_time

import numba
import numpy as np
import scipy

from ssmr_torch.plants.diamond import Diamond
from ssmr_torch.plants.trunk import Trunk

STEPS, WARM_UP = 300, 20
CONTINUUM = {"law": "neo_hookean", "mass_distribution": "volume", "scheme": "generalized_alpha"}
ROBOTS = {"trunk": Trunk, "trunk_coarse": Trunk, "diamond": Diamond, "diamond_coarse": Diamond}
ROWS = [(robot, {"linear_solver": solver}) for robot in ROBOTS for solver in ("block_ldl", "superlu", "pardiso")] + [
    (robot, CONTINUUM) for robot in ROBOTS]


def measure(robot: str, settings: dict) -> dict:
    """CPU and wall time of each step, ms, and the memory of the process, MB."""
    plant = ROBOTS[robot](robot, **settings)
    rng, inputs = np.random.default_rng(0), None
    cpu, wall = [], []
    for k in range(WARM_UP + STEPS):
        if k % 30 == 0:
            inputs = 0.5 * rng.uniform(*plant.input_bounds)
        starts = thread_time(), perf_counter()
        plant.step(inputs)
        cpu.append(1e3 * (thread_time() - starts[0]))
        wall.append(1e3 * (perf_counter() - starts[1]))
    return {"origin": plant.origin, "cpu": cpu[WARM_UP:], "wall": wall[WARM_UP:],
            "memory": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024, "period": 1e3 * plant.timestep}


def main() -> None:
    """One line per plant and solver."""
    os.environ |= {"OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    print(f"{platform.processor() or platform.machine()}, {os.cpu_count()} cores, 1 thread, Python "
          f"{platform.python_version()}, NumPy {np.__version__}, SciPy {scipy.__version__}, numba {numba.__version__}")
    print(f"{'plant':>15} {'nodes':>6} {'elements':>9} {'':>18} {'CPU median':>11} {'CPU p99':>9} {'wall median':>12} "
          f"{'of real time':>13} {'memory':>7}")
    for robot, settings in ROWS:
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as process:
            try:
                found = process.submit(measure, robot, settings).result()
            except ValueError as missing:
                print(f"{robot:>15} {settings['linear_solver']}: {missing}")
                continue
        (median, late), wall = np.percentile(found["cpu"], (50, 99)), np.median(found["wall"])
        print(f"{robot:>15} {found['origin']['nodes']:>6} {found['origin']['tetrahedra']:>9} "
              f"{settings.get('linear_solver', 'generalized_alpha'):>18} {median:>8.2f} ms {late:>6.2f} ms "
              f"{wall:>9.2f} ms {wall / found['period']:>12.2f}x {found['memory']:>4.0f} MB", flush=True)


if __name__ == "__main__":
    main()
