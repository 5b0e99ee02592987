"""ProxQP as a `Workspace`. No other file imports ProxSuite."""

from __future__ import annotations

import sys
from dataclasses import replace
from time import thread_time
from types import SimpleNamespace

import numpy as np

from ssmr_torch.control.quadratic_program import ROUNDING, QPSolution, QuadraticProgram, Workspace
from ssmr_torch.status import Status

INSTRUCTIONS = "proxsuite.instructionset"


def _without_wide_vectors():
    """ProxQP from ProxSuite's build without vector instructions, which gives the same digits every time.

    Its AVX builds sum in an order that depends on where their memory lies, which changes the last digits. The plain
    build was measured as fast up to 40 variables, and 20 % slower with 80. A program that imports proxsuite before this
    file gets the build that was chosen then, and perhaps different last digits.
    """
    if "proxsuite" not in sys.modules:
        sys.modules[INSTRUCTIONS] = SimpleNamespace(has_AVX512F=lambda: False, has_AVX2=lambda: False)
    try:
        from proxsuite import proxqp
    finally:
        if isinstance(sys.modules.get(INSTRUCTIONS), SimpleNamespace):
            del sys.modules[INSTRUCTIONS]
    return proxqp


proxqp = _without_wide_vectors()

# ProxQP treats bounds of this size as absent.
INFINITY = 1e20
# Initial penalty of each program. It takes fewer iterations than ProxQP's own 0.1, and hardly more on hard programs.
PENALTY = 3e-2
# The second attempt has this factor in its tolerance, and may take this many times as long.
RETRY_FACTOR, RETRY_TIME = 1e-2, 2.0
# Largest numbers of outer iterations, and of inner ones in each. The hardest of 5000 programs with obstacles and rate
# limits took 15 and fewer than 50. Programs that need more are not solved by 200 times 200 either.
OUTER, INNER = 25, 50

PROXQP_STATUS = {
    proxqp.PROXQP_SOLVED: Status.SOLVED,
    proxqp.PROXQP_MAX_ITER_REACHED: Status.ITERATION_LIMIT,
    proxqp.PROXQP_PRIMAL_INFEASIBLE: Status.PRIMAL_INFEASIBLE,
    proxqp.PROXQP_SOLVED_CLOSEST_PRIMAL_FEASIBLE: Status.CLOSEST_FEASIBLE,
    proxqp.PROXQP_DUAL_INFEASIBLE: Status.DUAL_INFEASIBLE,
    proxqp.PROXQP_NOT_RUN: Status.NOT_RUN,
}


class ProxQP(Workspace):
    """ProxQP's dense backend [Bambade et al., RSS 2022] with one workspace for problems of one size.

    dim: d variables; `rows`: general rows.
    tolerance: absolute, on primal residual, dual residual and gap; therefore scale the problem first.
    warm: start from the last solution, which is faster only with general rows.
    The preconditioner of the first problem is used for all later ones until `reset`.
    """

    def __init__(self, dim: int, rows: int = 0, *, tolerance: float = 1e-6, max_iterations: int = 200,
                 warm: bool | None = None):
        super().__init__(dim, rows, tolerance, max_iterations)
        self.warm = rows > 0 if warm is None else warm
        self._known = None, None, None
        self.reset()

    def reset(self, tolerance: float | None = None) -> None:
        """As in `Workspace`; tolerance: for this start only."""
        tolerance = self.tolerance if tolerance is None else tolerance
        self._workspace, self._fresh, self._beginning = proxqp.dense.QP(self.dim, 0, self.rows, True), True, None
        settings = self._workspace.settings
        settings.eps_abs, settings.eps_rel = tolerance, 0.0
        # With their usual tolerance, ProxQP's certificates of infeasibility also reject feasible problems.
        settings.eps_primal_inf = settings.eps_dual_inf = ROUNDING
        # Without the gap, ProxQP accepts points that have a multiplier on a bound which is not active.
        settings.check_duality_gap = True
        settings.eps_duality_gap_abs, settings.eps_duality_gap_rel = tolerance, ROUNDING
        settings.default_mu_in = PENALTY
        settings.max_iter, settings.max_iter_in = min(self.max_iterations, OUTER), min(self.max_iterations, INNER)

    def __getstate__(self) -> dict:
        """Without the workspace, whose own pickle loses the box. It is made again from its first problem."""
        results = None if self._fresh else (self._workspace.results.x.copy(), self._workspace.results.z.copy())
        kept = {name: value for name, value in self.__dict__.items() if name != "_workspace"}
        return kept | {"_results": results, "_known": (None, None, None)}

    def __setstate__(self, state: dict) -> None:
        results = state.pop("_results")
        self.__dict__.update(state)
        beginning = self._beginning
        self.reset()
        if results is not None:
            self._begin(beginning)
            self._workspace.results.x, self._workspace.results.z = results

    def advance(self, variables: np.ndarray, rows: np.ndarray) -> None:
        """Set warm starts: variable i begins at entry variables[i] (d,) of the last solution; rows (r,) likewise."""
        if self._fresh or not self.warm:
            return
        results = self._workspace.results
        z = results.z
        results.x, results.z = results.x[variables], np.concatenate([z[rows], z[self.rows:][variables]])

    def _solve(self, problem: QuadraticProgram) -> QPSolution:
        begun = thread_time()
        solution = self._attempt(problem)
        if not solution.status.success:
            # The memory of other problems can mislead the solver, so the last attempt is a fresh, stricter start.
            now = thread_time()
            if now + RETRY_TIME * (now - begun) <= self.deadline:
                self.reset(RETRY_FACTOR * self.tolerance)
                solution = self._attempt(problem)
            self.reset()
        if solution.status in (Status.ITERATION_LIMIT, Status.PRIMAL_INFEASIBLE, Status.DUAL_INFEASIBLE):
            solution = replace(solution, status=self.explained(problem))
        return solution

    def _attempt(self, problem: QuadraticProgram) -> QPSolution:
        shift = self._load(problem)
        self._workspace.solve()
        results = self._workspace.results
        z = results.z
        return QPSolution.judged(problem, results.x + shift, z[self.rows:], z[:self.rows],
                                 PROXQP_STATUS[results.info.status], results.info.iter, self.tolerance)

    def _load(self, problem: QuadraticProgram) -> np.ndarray:
        """Give the problem to ProxQP in x − shift, where shift is the middle of its box.

        With a bound at zero, a multiplier of the wrong sign adds nothing to the gap, and ProxQP would accept it.
        """
        lower, upper, shift = self._box(problem)
        row_lower = row_upper = None
        if self.rows:
            offset = problem.C @ shift
            row_lower = np.clip(problem.row_lower - offset, -INFINITY, INFINITY)
            row_upper = np.clip(problem.row_upper - offset, -INFINITY, INFINITY)
        arguments = (problem.H, problem.g + problem.H @ shift, None, None, problem.C, row_lower, row_upper, lower,
                     upper)
        if self._fresh:
            self._begin(arguments)
            return shift
        if self.warm:
            # ProxQP's "warm start" also keeps the last program's penalty, with which some take 150 iterations.
            self._workspace.settings.initial_guess = proxqp.COLD_START_WITH_PREVIOUS_RESULT
        self._workspace.update(*arguments, update_preconditioner=False)
        return shift

    def _begin(self, arguments: tuple) -> None:
        self._workspace.init(*arguments)
        self._beginning, self._fresh = arguments, False

    def _box(self, problem: QuadraticProgram) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Bounds relative to the middle of the box, and that middle. They are stored for bounds that cannot change."""
        if self._known[0] is problem.lower and self._known[1] is problem.upper:
            return self._known[2]
        lower = np.minimum(np.maximum(problem.lower, -INFINITY), INFINITY)
        upper = np.minimum(np.maximum(problem.upper, -INFINITY), INFINITY)
        two_sided = np.isfinite(problem.lower) & np.isfinite(problem.upper)
        shift = np.where(two_sided, 0.5 * (lower + upper), 0.0)
        box = lower - shift, upper - shift, shift
        if not (problem.lower.flags.writeable or problem.upper.flags.writeable):
            self._known = problem.lower, problem.upper, box
        return box
