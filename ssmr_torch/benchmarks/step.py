"""Time of one control step over the horizon, of our controller on one tracking problem.

The problem is that of tracking_instance.py.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from ssmr_torch.benchmarks.tracking_instance import measure
from ssmr_torch.checked_arguments import checked
from ssmr_torch.ranges import Each, Number, Whole


@checked(horizons=Each(Whole(1, 500), 1, 100), laps=Number(1e-2, 1e4))
def rows(*, horizons: Sequence[int] = (5, 10, 20), laps: float = 6.0) -> Iterator[dict]:
    """One row per horizon: CPU and wall time of its steps, ms, fallbacks, and what the loop was worth.

    horizons: control steps of 20 ms.   laps: of the figure eight, 79 control steps each.
    """
    for horizon in horizons:
        found = measure(horizon, laps)
        cpu, wall = np.percentile(found["cpu"], (50, 99)), np.percentile(found["wall"], (50, 99))
        yield {"N": horizon, "steps": found["steps"], "CPU median, ms": float(cpu[0]), "CPU 99 %, ms": float(cpu[1]),
               "wall median, ms": float(wall[0]), "wall 99 %, ms": float(wall[1]), "failures": found["failures"],
               "saturated, %": 100 * float(found["saturated"]), "RMSE, mm": float(found["rmse"])}
