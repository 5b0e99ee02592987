"""Quadratic programs as values, and the solvers that take them.

Residuals are computed here from the problem; what a solver says about itself is only a claim.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import qpsolvers
from proxsuite import proxqp
from scipy.linalg.lapack import dpotrf
from scipy.optimize import linprog

from ssmr_torch.status import Status

# ProxQP counts bounds of this size as absent.
INFINITY = 1e20
# A claim of success is refused when a recomputed residual exceeds the tolerance by this factor.
RESIDUAL_FACTOR = 10.0
# How much stricter the second attempt is.
RETRY_FACTOR = 1e-2
# Relative size of what rounding leaves of a residual, however tight the tolerance.
ROUNDING = 1e-12

PROXQP_STATUS = {
    proxqp.PROXQP_SOLVED: Status.SOLVED,
    proxqp.PROXQP_MAX_ITER_REACHED: Status.ITERATION_LIMIT,
    proxqp.PROXQP_PRIMAL_INFEASIBLE: Status.PRIMAL_INFEASIBLE,
    proxqp.PROXQP_SOLVED_CLOSEST_PRIMAL_FEASIBLE: Status.CLOSEST_FEASIBLE,
    proxqp.PROXQP_DUAL_INFEASIBLE: Status.DUAL_INFEASIBLE,
    proxqp.PROXQP_NOT_RUN: Status.NOT_RUN,
}


@dataclass(frozen=True, eq=False)
class QuadraticProgram:
    """min ½ xᵀH x + gᵀx  s.t.  lower ≤ x ≤ upper,  row_lower ≤ C x ≤ row_upper.

    H (d, d) symmetric, g, lower, upper (d,), C (r, d), row_lower, row_upper (r,); infinite bounds are absent
    ones. Without rows C is None. Raises ValueError when shapes disagree. The numbers themselves are judged by
    `defect`, because a controller must get an answer, not an exception, for what it measured.
    """

    H: np.ndarray
    g: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    C: np.ndarray | None = None
    row_lower: np.ndarray | None = None
    row_upper: np.ndarray | None = None

    def __post_init__(self):
        d = len(self.g)
        if not (self.H.shape == (d, d) and self.g.shape == self.lower.shape == self.upper.shape == (d,)):
            raise ValueError(f"H {self.H.shape}, g {self.g.shape}, lower {self.lower.shape}, "
                             f"upper {self.upper.shape} disagree; expected ({d}, {d}) and three times ({d},)")
        if self.C is None:
            if self.row_lower is not None or self.row_upper is not None:
                raise ValueError("bounds of rows are given without the rows C")
        elif self.row_lower is None or self.row_upper is None:
            raise ValueError(f"C has {len(self.C)} rows, but row_lower or row_upper is missing; "
                             "use -inf and inf")
        elif not (self.C.shape == (self.rows, d)
                  and self.row_lower.shape == self.row_upper.shape == (self.rows,)):
            raise ValueError(f"C {self.C.shape}, row_lower {self.row_lower.shape}, "
                             f"row_upper {self.row_upper.shape} disagree; "
                             f"expected ({self.rows}, {d}) and twice ({self.rows},)")

    @property
    def dim(self) -> int:
        return len(self.g)

    @property
    def rows(self) -> int:
        return 0 if self.C is None else len(self.C)

    def defect(self) -> Status | None:
        """Why no solver should be asked: NaN, crossed bounds, H not semidefinite; None where all is well."""
        finite = np.isfinite(self.H).all() and np.isfinite(self.g).all()
        if self.C is not None:
            finite = finite and np.isfinite(self.C).all()
        if not finite or any(np.isnan(bound).any() for bound in self._bounds()):
            return Status.NOT_FINITE
        crossed = (self.lower > self.upper).any()
        if crossed or (self.C is not None and (self.row_lower > self.row_upper).any()):
            return Status.PRIMAL_INFEASIBLE
        shifted = self.H.copy()
        shifted.flat[::self.dim + 1] += 1e-10 * max(1.0, np.abs(self.H).max())
        return None if dpotrf(shifted, overwrite_a=1)[1] == 0 else Status.DUAL_INFEASIBLE

    def failure(self) -> Status:
        """Why a solver found nothing, by two linear programs: no feasible point, or endless descent."""
        A, b = None, None
        if self.C is not None:
            A, b = np.vstack([self.C, -self.C]), np.concatenate([self.row_upper, -self.row_lower])
            A, b = A[np.isfinite(b)], b[np.isfinite(b)]
        if linprog(np.zeros(self.dim), A, b, bounds=np.stack([self.lower, self.upper], axis=1)).status == 2:
            return Status.PRIMAL_INFEASIBLE
        rays = np.stack([np.where(np.isinf(self.lower), -1.0, 0.0),
                         np.where(np.isinf(self.upper), 1.0, 0.0)], axis=1)
        still = None if A is None else np.zeros(len(A))
        steepest = linprog(self.g, A, still, self.H, np.zeros(self.dim), rays)
        endless = steepest.status == 0 and steepest.fun < -1e-9
        return Status.DUAL_INFEASIBLE if endless else Status.ITERATION_LIMIT

    def _bounds(self) -> tuple[np.ndarray, ...]:
        rows = () if self.C is None else (self.row_lower, self.row_upper)
        return (self.lower, self.upper, *rows)


@dataclass(frozen=True, eq=False)
class QPSolution:
    """x (d,) with multipliers w (d,) of the box and z (r,) of the rows, positive at upper bounds.

    primal_residual: largest violation of a bound.     dual_residual: ‖H x + g + w + Cᵀz‖_∞.
    gap: |xᵀH x + gᵀx + Σ bound · multiplier|, zero at a solution.     All infinite where nothing was found.
    """

    x: np.ndarray
    box_multipliers: np.ndarray
    row_multipliers: np.ndarray
    status: Status
    iterations: int
    primal_residual: float
    dual_residual: float
    gap: float

    @classmethod
    def none(cls, problem: QuadraticProgram, status: Status) -> QPSolution:
        """No solution, for this reason."""
        nan = np.full(problem.dim, np.nan)
        return cls(nan, nan, np.full(problem.rows, np.nan), status, 0, np.inf, np.inf, np.inf)

    @classmethod
    def judged(cls, problem: QuadraticProgram, x: np.ndarray, box: np.ndarray, rows: np.ndarray,
               claim: Status, iterations: int, tolerance: float) -> QPSolution:
        """The solution with its own residuals; a claim of success that they do not support is refused."""
        Hx = problem.H @ x
        stationarity = Hx + problem.g + box
        primal = max((problem.lower - x).max(), (x - problem.upper).max(), 0.0)
        gap = x @ (Hx + problem.g) + _support(problem.lower, problem.upper, box)
        if problem.C is not None:
            Cx = problem.C @ x
            stationarity += rows @ problem.C
            primal = max(primal, (problem.row_lower - Cx).max(), (Cx - problem.row_upper).max())
            gap += _support(problem.row_lower, problem.row_upper, rows)
        solution = cls(x, box, rows, claim, iterations, float(primal), float(np.abs(stationarity).max()),
                       float(abs(gap)))
        if claim.success and not solution._within(problem, RESIDUAL_FACTOR * tolerance):
            status = Status.RESIDUAL_TOO_LARGE if np.isfinite(x).all() else Status.NOT_FINITE
            return replace(solution, status=status)
        return solution

    def _within(self, problem: QuadraticProgram, tolerance: float) -> bool:
        """The gap is measured per unit of multiplier: the mean distance from the bounds that hold one."""
        parts = (self.x, self.box_multipliers, self.row_multipliers)
        weight = 1.0 + sum(np.abs(part).sum() for part in parts)
        return (self.primal_residual <= tolerance and self.gap <= tolerance * weight
                and self.dual_residual <= tolerance + ROUNDING * np.abs(problem.g).max())


class ProxQP:
    """ProxQP's dense backend [Bambade et al., RSS 2022] with one workspace for problems of one size.

    dim d variables, `rows` general rows.
    tolerance: absolute, on primal residual, dual residual and gap, so scale the problem first.
    warm: start from the last solution; it pays with general rows only.
    The preconditioner of the first problem serves all that follow until `reset`.
    """

    def __init__(self, dim: int, rows: int = 0, *, tolerance: float = 1e-6, max_iterations: int = 200,
                 warm: bool | None = None):
        if dim < 1 or rows < 0:
            raise ValueError(f"a problem of {dim} variables and {rows} rows; expected at least 1 and 0")
        if not tolerance > 0 or max_iterations < 1:
            raise ValueError(f"tolerance {tolerance} and max_iterations {max_iterations} must be positive")
        self.dim, self.rows = int(dim), int(rows)
        self.tolerance, self.max_iterations = float(tolerance), int(max_iterations)
        self.warm = rows > 0 if warm is None else warm
        self.reset()

    def reset(self, tolerance: float | None = None) -> None:
        """Forget the workspace: the same problems then give the same solutions again, to rounding."""
        tolerance = self.tolerance if tolerance is None else tolerance
        self._workspace, self._fresh = proxqp.dense.QP(self.dim, 0, self.rows, True), True
        settings = self._workspace.settings
        settings.eps_abs, settings.eps_rel = tolerance, 0.0
        # Its own certificates of infeasibility, at their usual tolerance, also condemn feasible problems.
        settings.eps_primal_inf = settings.eps_dual_inf = ROUNDING
        # Without its gap ProxQP calls points solved that keep a multiplier on a bound that they do not touch.
        settings.check_duality_gap = True
        settings.eps_duality_gap_abs, settings.eps_duality_gap_rel = tolerance, ROUNDING
        settings.max_iter = settings.max_iter_in = self.max_iterations

    def solve(self, problem: QuadraticProgram) -> QPSolution:
        """Never raises for the numbers in the problem; ValueError for a problem of another size."""
        if (problem.dim, problem.rows) != (self.dim, self.rows):
            raise ValueError(f"a problem of {problem.dim} variables and {problem.rows} rows; "
                             f"this workspace holds {self.dim} and {self.rows}")
        defect = problem.defect()
        if defect is not None:
            return QPSolution.none(problem, defect)
        solution = self._attempt(problem)
        if not solution.status.success:
            # What other problems left behind can mislead: a fresh, stricter start has the last word.
            self.reset(RETRY_FACTOR * self.tolerance)
            solution = self._attempt(problem)
            self.reset()
        if solution.status in (Status.ITERATION_LIMIT, Status.PRIMAL_INFEASIBLE, Status.DUAL_INFEASIBLE):
            solution = replace(solution, status=problem.failure())
        return solution

    def _attempt(self, problem: QuadraticProgram) -> QPSolution:
        shift = self._load(problem)
        self._workspace.solve()
        results = self._workspace.results
        z = results.z.copy()
        return QPSolution.judged(problem, results.x + shift, z[self.rows:], z[:self.rows],
                                 PROXQP_STATUS[results.info.status], results.info.iter, self.tolerance)

    def _load(self, problem: QuadraticProgram) -> np.ndarray:
        """Hand over the problem in x − shift, the middle of its box.

        On a bound at zero a multiplier of the wrong sign adds nothing to the gap: ProxQP calls that solved.
        """
        lower = np.clip(problem.lower, -INFINITY, INFINITY)
        upper = np.clip(problem.upper, -INFINITY, INFINITY)
        two_sided = np.isfinite(problem.lower) & np.isfinite(problem.upper)
        shift = np.where(two_sided, 0.5 * (lower + upper), 0.0)
        row_lower = row_upper = None
        if self.rows:
            offset = problem.C @ shift
            row_lower = np.clip(problem.row_lower - offset, -INFINITY, INFINITY)
            row_upper = np.clip(problem.row_upper - offset, -INFINITY, INFINITY)
        arguments = (problem.H, problem.g + problem.H @ shift, None, None, problem.C, row_lower, row_upper,
                     lower - shift, upper - shift)
        if self._fresh:
            self._workspace.init(*arguments)
            self._fresh = False
            return shift
        if self.warm:
            self._workspace.settings.initial_guess = proxqp.WARM_START_WITH_PREVIOUS_RESULT
        self._workspace.update(*arguments, update_preconditioner=False)
        return shift


class QPSolvers:
    """Any solver of the qpsolvers package by its name: for cross-checks, and where ProxQP is not wanted.

    It is set up anew for every problem, which costs more than the solution of a small one.
    Raises ValueError when that solver is not installed.
    """

    def __init__(self, name: str, *, tolerance: float = 1e-6, **options):
        if name not in qpsolvers.available_solvers:
            raise ValueError(f"solver {name!r} is not installed; "
                             f"available: {sorted(qpsolvers.available_solvers)}")
        self.name, self.tolerance, self.options = name, float(tolerance), options

    def reset(self) -> None:
        """Nothing is kept between problems."""

    def solve(self, problem: QuadraticProgram) -> QPSolution:
        """Never raises for the numbers in the problem."""
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
            return QPSolution.none(problem, problem.failure())
        rows = np.zeros(problem.rows)
        if G is not None:
            rows[upper] += found.z[:upper.sum()]
            rows[lower] -= found.z[upper.sum():]
        return QPSolution.judged(problem, found.x, found.z_box, rows, Status.SOLVED, 0, self.tolerance)


def _support(lower: np.ndarray, upper: np.ndarray, multiplier: np.ndarray) -> float:
    """Σ bound · multiplier; infinite where an absent bound holds a multiplier."""
    bound = np.where(multiplier > 0, upper, lower)
    used = multiplier != 0
    return float(bound[used] @ multiplier[used])
