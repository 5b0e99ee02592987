"""Our control step against other solvers on one instance, at several horizons.

The instance of tracking_instance.py, the same noise for each solver, one process, one thread. Times are CPU time of the
calling thread per control step, from the measurement to the input; where the wall time is much longer, the machine was
busy or the solver worked in other threads. With "qp:prepared" the step begins where the program is linearized and
condensed, as `prepare` does on a robot between two measurements. The cost is that of the plant in closed loop.
Needs `pip install 'ssmr_torch[benchmarks]'`; a solver that is not installed is left out, and a remark says so.
A short run: ssmr benchmark comparison horizons=[5] laps=1 solvers=[proxqp,ipopt]
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np

from ssmr_torch.benchmarks.other_solvers import Acados, Unavailable, casadi_rti, ipopt
from ssmr_torch.benchmarks.tracking_instance import measure, predictive
from ssmr_torch.checked_arguments import checked
from ssmr_torch.control.mpc import ModelPredictiveController
from ssmr_torch.control.qpsolvers_adapter import QPSolvers, qpsolvers
from ssmr_torch.quantities import TEXT
from ssmr_torch.ranges import Each, Number, OrNone, Whole

# Tight enough for the residuals of 1e-5 that we accept; what the solvers do by themselves differs widely.
PRECISE = {
    "osqp": {"eps_abs": 1e-6, "eps_rel": 0.0, "max_iter": 20_000},
    "piqp": {"eps_abs": 1e-6, "eps_rel": 0.0},
    "proxqp": {"eps_abs": 1e-6, "eps_rel": 0.0, "backend": "dense", "check_duality_gap": True,
               "eps_duality_gap_abs": 1e-6, "eps_duality_gap_rel": 0.0},
    "clarabel": {"tol_gap_abs": 1e-10, "tol_gap_rel": 1e-10, "tol_feas": 1e-10},
}
PREPARED = ":prepared"  # linearized and condensed between two measurements, outside the step
OTHERS = {"ipopt": ipopt, "casadi_rti": casadi_rti, "casadi_rti_c": partial(casadi_rti, compiled=True),
          "acados": Acados}


def ours(model, task, bounds, *, horizon: int, qp: str) -> ModelPredictiveController:
    """Our controller with a solver that it keeps between steps. Raises Unavailable where that is not installed."""
    try:
        return predictive(model, task, bounds, horizon=horizon, qp=qp)
    except ImportError as error:
        raise Unavailable(str(error)) from error


def ours_through_qpsolvers(model, task, bounds, *, horizon: int, name: str) -> ModelPredictiveController:
    """Our controller, its programs solved by a solver of the qpsolvers package, set up anew for each."""
    if name not in qpsolvers.available_solvers:
        raise Unavailable(f"{name} is not installed: pip install 'ssmr_torch[benchmarks]'")
    solver = QPSolvers(name, **PRECISE.get(name, {}))
    return predictive(model, task, bounds, horizon=horizon, solver=solver)


def known() -> dict:
    """Name → build(model, task, bounds, horizon=N); ours first, to which the others are compared."""
    found = {f"{qp}{prepared}": partial(ours, qp=qp) for prepared in ("", PREPARED) for qp in ("proxqp", "daqp")}
    return found | OTHERS | {f"qpsolvers:{name}": partial(ours_through_qpsolvers, name=name)
                    for name in sorted(qpsolvers.available_solvers)}


@checked(horizons=Each(Whole(1, 500), 1, 100), laps=Number(1e-2, 1e4), solvers=OrNone(Each(TEXT, 0, 1000)))
def rows(*, horizons: Sequence[int] = (5, 10, 20), laps: float = 6.0,
         solvers: Sequence[str] | None = None) -> Iterator[dict | str]:
    """One row per horizon and solver, and a remark for each that was left out.

    horizons: control steps of 20 ms.   laps: of the figure eight, 79 control steps each.   solvers: names of `known`,
    None: all; the first is the one that the others are compared to.   Raises ValueError for a name that is none.
    """
    built, left_out = known(), {}
    chosen = list(built) if solvers is None else list(solvers)
    unknown = [name for name in chosen if name not in built]
    if unknown:
        raise ValueError(f"solvers has {', '.join(unknown)}; known are {', '.join(built)}")
    for horizon in horizons:
        found: dict[str, dict] = {}
        for name in chosen:
            try:
                with warnings.catch_warnings():
                    warnings.filterwarnings("ignore", message="Converted matrix")
                    found[name] = measure(horizon, laps, built[name], prepare=name.endswith(PREPARED))
            except Unavailable as reason:
                left_out[name] = str(reason)
        first, optimum = next(iter(found.values()), None), found.get("ipopt")
        yield from (_row(name, each, first, optimum) for name, each in found.items())
    yield from (f"{name} left out: {reason}" for name, reason in left_out.items())


def _row(name: str, found: dict, first: dict, optimum: dict | None) -> dict:
    median, late = np.percentile(found["cpu"], (50, 99))
    above = None if optimum is None else float(100 * (found["cost"] / optimum["cost"] - 1))
    return {"N": found["N"], "solver": name, "CPU median, ms": float(median), "CPU 99 %, ms": float(late),
            "wall median, ms": float(np.median(found["wall"])),
            "times the first": float(median / np.median(first["cpu"])), "failures": found["failures"],
            "steps": found["steps"], "RMSE, mm": float(found["rmse"]), "cost above IPOPT, %": above}
