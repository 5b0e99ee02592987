"""Our control step against other solvers on one instance: `python experiments/benchmarks/control_comparison.py`.

The instance of control_step.py, the same noise for each, one process, set OMP_NUM_THREADS=1. Times are CPU time of the
calling thread per control step, from the measurement to the input; where the wall time is much longer, the machine was
busy or the solver worked in other threads. Behind "qp:prepared" the step begins where the program is linearized and
condensed, as `prepare` does on a robot between two measurements. The cost is that of the plant in closed loop.
Needs `pip install 'ssmr_torch[benchmarks]'`; what is not installed is left out, and said.
A short run: --horizons 5 --laps 1 --solvers proxqp ipopt.
"""

from __future__ import annotations

import argparse
import warnings
from functools import partial
from importlib.util import find_spec

import numpy as np
import qpsolvers
from contenders import Acados, Unavailable, casadi_rti, ipopt
from control_step import machine, measure, predictive

from ssmr_torch.control.mpc import ModelPredictiveController
from ssmr_torch.control.solvers_of_qpsolvers import QPSolvers

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
LIBRARIES = {"ipopt": "casadi", "casadi_rti": "casadi", "casadi_rti_c": "casadi"}


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


def solvers() -> dict:
    """Name → build(model, task, bounds, horizon=N); ours first, to which the others are compared."""
    found = {f"{qp}{prepared}": partial(ours, qp=qp) for prepared in ("", PREPARED) for qp in ("proxqp", "daqp")}
    return found | OTHERS | {f"qpsolvers:{name}": partial(ours_through_qpsolvers, name=name)
                    for name in sorted(qpsolvers.available_solvers)}


def compare(horizon: int, laps: float, chosen: list[str]) -> tuple[dict, dict]:
    """Results of `measure` and reasons of those that were left out, by name."""
    results, skipped = {}, {}
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Converted matrix")
        for name in chosen:
            try:
                results[name] = measure(horizon, laps, solvers()[name], prepare=name.endswith(PREPARED))
            except Unavailable as reason:
                skipped[name] = str(reason)
    return results, skipped


def row(name: str, result: dict, first: dict, optimum: dict | None) -> str:
    median, p99 = np.percentile(result["cpu"], (50, 99))
    ratio = median / np.median(first["cpu"])
    cost = f"{100 * (result['cost'] / optimum['cost'] - 1):+8.2f} %" if optimum else f"{'–':>10}"
    return (f"{result['N']:>3} {name:<20} {median:>8.3f} ms {p99:>8.3f} ms {np.median(result['wall']):>8.3f} ms "
            f"{ratio:>7.2f} {result['failures']:>6} of {result['steps']:<5} {result['rmse']:>7.4f} mm {cost}")


def libraries(names) -> list[str]:
    """The installed packages behind these solvers, for the header."""
    behind = {LIBRARIES.get(name, name.removeprefix("qpsolvers:").removesuffix(PREPARED)) for name in names}
    behind -= {"proxqp", "acados"}
    return ["numba", "proxsuite", "qpsolvers", *sorted(name for name in behind if find_spec(name))]


def main(arguments: list[str] | None = None) -> None:
    """One line per horizon and solver."""
    names = list(solvers())
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--horizons", type=int, nargs="+", default=[5, 10, 20], help="control steps of 20 ms")
    parser.add_argument("--laps", type=float, default=6.0, help="of the figure eight, 79 control steps each")
    parser.add_argument("--solvers", nargs="+", default=names, choices=names, metavar="NAME",
                        help="%(choices)s; the first is the one that the others are compared to")
    given = parser.parse_args(arguments)
    print(machine(*libraries(given.solvers)))
    print(f"{'N':>3} {'solver':<20} {'CPU median':>11} {'CPU p99':>11} {'wall median':>11} {'ratio':>7} "
          f"{'failures':>15} {'RMSE':>10} {'cost/IPOPT':>10}")
    for horizon in given.horizons:
        results, skipped = compare(horizon, given.laps, given.solvers)
        for name, result in results.items():
            print(row(name, result, next(iter(results.values())), results.get("ipopt")), flush=True)
    for name, reason in skipped.items():
        print(f"{name} left out: {reason}")


if __name__ == "__main__":
    main()
