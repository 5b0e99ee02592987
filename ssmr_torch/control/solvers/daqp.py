"""DAQP, a dual active-set solver, as a `Workspace`. No other file imports daqp."""

from __future__ import annotations

import importlib

import numpy as np

from ssmr_torch.control.quadratic_program import QPSolution, QuadraticProgram, Workspace
from ssmr_torch.status import Status

EXIT_FLAGS = {1: Status.SOLVED, 2: Status.CLOSEST_FEASIBLE, -1: Status.PRIMAL_INFEASIBLE, -3: Status.DUAL_INFEASIBLE,
              -4: Status.ITERATION_LIMIT, -5: Status.DUAL_INFEASIBLE}


class DAQP(Workspace):
    """DAQP [Arnström, Bemporad, Axehill, IEEE TAC 2022] with one workspace for problems of one size.

    dim: d variables; `rows`: general rows. tolerance: absolute, on the primal residual. It is faster than ProxQP up to
    about 80 variables, and where many obstacle rows are inactive.
    Raises ImportError, with the package to install, where daqp is missing.
    """

    def __init__(self, dim: int, rows: int = 0, *, tolerance: float = 1e-6, max_iterations: int = 2000):
        try:
            self._library = importlib.import_module("daqp")
        except ImportError as error:
            raise ImportError("qp=daqp needs the package daqp: pip install 'ssmr_torch[daqp]'") from error
        super().__init__(dim, rows, tolerance, max_iterations)
        self._sense = np.zeros(self.dim + self.rows, dtype=np.int32)
        self._upper, self._lower = np.empty(self.dim + self.rows), np.empty(self.dim + self.rows)
        self._none = np.zeros((0, self.dim))
        self.reset()

    def reset(self) -> None:
        self._workspace = None

    def __getstate__(self) -> dict:
        """Without DAQP's workspace, which cannot be copied. Copy and original both start the next problem anew."""
        self.reset()
        return {name: value for name, value in self.__dict__.items() if name != "_library"}

    def __setstate__(self, state: dict) -> None:
        self.__dict__.update(state, _library=importlib.import_module("daqp"))

    def _solve(self, problem: QuadraticProgram) -> QPSolution:
        flag = self._load(problem)
        if flag >= 0:
            x, _, flag, info = self._workspace.solve()
        status = EXIT_FLAGS.get(flag, Status.ITERATION_LIMIT)
        if flag < 0:
            self.reset()
            return QPSolution.none(problem, self.explained(problem) if status is Status.ITERATION_LIMIT else status)
        multipliers = np.asarray(info["lam"])
        return QPSolution.judged(problem, np.asarray(x), multipliers[:self.dim], multipliers[self.dim:], status,
                                 info["iterations"], self.tolerance)

    def _load(self, problem: QuadraticProgram) -> int:
        """Give the problem to DAQP. Returns a negative number where DAQP refuses it; then there is nothing to solve."""
        self._upper[:self.dim], self._lower[:self.dim] = problem.upper, problem.lower
        C = self._none
        if self.rows:
            self._upper[self.dim:], self._lower[self.dim:], C = problem.row_upper, problem.row_lower, problem.C
        if not self.rows and self._workspace is not None:
            C = None  # DAQP's update does not accept an empty matrix
        arguments = (problem.H, problem.g, C, self._upper, self._lower, self._sense)
        if self._workspace is None:
            self._workspace = self._library.Model()
            self._workspace.settings = {"primal_tol": self.tolerance, "iter_limit": self.max_iterations}
            flag, _ = self._workspace.setup(*arguments)
        else:
            flag = self._workspace.update(*arguments)
        return 0 if flag is None else flag
