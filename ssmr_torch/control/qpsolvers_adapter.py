"""All solvers of the qpsolvers package. No other file imports it."""

from __future__ import annotations

import ssmr_torch.control.solvers.proxqp  # noqa: F401, before qpsolvers, which would choose another build of it

# isort: split
import numpy as np
import qpsolvers

from ssmr_torch.control.quadratic_program import QPSolution, QuadraticProgram
from ssmr_torch.status import Status


class QPSolvers:
    """Any solver of the qpsolvers package by its name, for cross-checks, and in place of ProxQP.

    It is set up again for every problem, which costs more than the solution of a small one.
    Raises ValueError when that solver is not installed.
    """

    def __init__(self, name: str, *, tolerance: float = 1e-6, **options):
        if name not in qpsolvers.available_solvers:
            raise ValueError(f"the solver {name!r} is not installed; "
                             f"expected one of {sorted(qpsolvers.available_solvers)}")
        self.name, self.tolerance, self.options = name, float(tolerance), options

    # as in `Workspace`
    deadline = np.inf

    def reset(self) -> None:
        """Do nothing, because nothing is kept between problems."""

    def solve(self, problem: QuadraticProgram) -> QPSolution:
        """Solve the program. Any numbers in it are accepted."""
        defect = problem.defect()
        if defect is not None:
            return QPSolution.none(problem, defect)
        G = h = upper = lower = None
        if problem.C is not None:
            upper, lower = np.isfinite(problem.row_upper), np.isfinite(problem.row_lower)
            G = np.vstack([problem.C[upper], -problem.C[lower]])
            h = np.concatenate([problem.row_upper[upper], -problem.row_lower[lower]])
        found = qpsolvers.solve_problem(
            qpsolvers.Problem(problem.H, problem.g, G, h, lb=problem.lower, ub=problem.upper),
            self.name, **self.options)
        if not found.found:
            return QPSolution.none(problem, problem.failure() if self.deadline == np.inf else Status.ITERATION_LIMIT)
        rows = np.zeros(problem.rows)
        if G is not None:
            rows[upper] += found.z[:upper.sum()]
            rows[lower] -= found.z[upper.sum():]
        return QPSolution.judged(problem, found.x, found.z_box, rows, Status.SOLVED, 0, self.tolerance)
