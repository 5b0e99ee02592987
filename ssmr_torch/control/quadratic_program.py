"""Quadratic programs and their solutions as values, and the interface of the solvers.

Residuals are computed here from the problem. What a solver reports about its own solution is not trusted.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cache

import numpy as np

from ssmr_torch.control import program_checks
from ssmr_torch.status import Status

# A solution is rejected when a recomputed residual exceeds the tolerance by this factor.
RESIDUAL_FACTOR = 10.0
# For larger entries of the cost, rounding alone exceeds the accepted residual at a tolerance of 1e-6.
LARGEST = RESIDUAL_FACTOR * 1e-6 / np.finfo(np.float64).eps
# Relative size of the rounding error in a residual, for any tolerance.
ROUNDING = 1e-12


@dataclass(frozen=True, eq=False)
class QuadraticProgram:
    """min ½ xᵀH x + gᵀx  s.t.  lower ≤ x ≤ upper,  row_lower ≤ C x ≤ row_upper.

    H (d, d) symmetric, g, lower, upper (d,), C (r, d), row_lower, row_upper (r,); an infinite bound means no bound.
    Without rows C is None. convex: H is known to be positive definite, so that this is not tested.
    Raises ValueError when shapes disagree. The numbers themselves are judged by `defect`, because a controller must
    get an answer, and not an exception, for any measurement.
    """

    H: np.ndarray
    g: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    C: np.ndarray | None = None
    row_lower: np.ndarray | None = None
    row_upper: np.ndarray | None = None
    convex: bool = False

    def __post_init__(self):
        d = len(self.g)
        if not (self.H.shape == (d, d) and self.g.shape == self.lower.shape == self.upper.shape == (d,)):
            raise ValueError(f"H has shape {self.H.shape}, g {self.g.shape}, lower {self.lower.shape}, "
                             f"upper {self.upper.shape}; expected ({d}, {d}) and three times ({d},)")
        if self.C is None:
            if self.row_lower is not None or self.row_upper is not None:
                raise ValueError("bounds of rows are given, but C is None; give the rows C as well")
        elif self.row_lower is None or self.row_upper is None:
            raise ValueError(f"C has {len(self.C)} rows, but row_lower or row_upper is missing; "
                             "give both, with -inf and inf where there is no bound")
        elif not (self.C.shape == (self.rows, d)
                  and self.row_lower.shape == self.row_upper.shape == (self.rows,)):
            raise ValueError(f"C has shape {self.C.shape}, row_lower {self.row_lower.shape}, "
                             f"row_upper {self.row_upper.shape}; "
                             f"expected ({self.rows}, {d}) and twice ({self.rows},)")

    @property
    def dim(self) -> int:
        return len(self.g)

    @property
    def rows(self) -> int:
        return 0 if self.C is None else len(self.C)

    def defect(self) -> Status | None:
        """Why the program should not be given to a solver; None where it is well posed.

        Defects are NaN, crossed bounds, H not semidefinite, and a cost so large that solutions cannot be told apart to
        a tolerance of 1e-6, as for a state far outside the model's range. Solvers would spend all iterations on it.
        """
        found = program_checks.soundness(*self._parts(), LARGEST)
        if found != program_checks.SOUND:
            return {program_checks.NOT_FINITE: Status.NOT_FINITE, program_checks.CROSSED: Status.PRIMAL_INFEASIBLE}.get(
                found, Status.OUT_OF_RANGE)
        if self.convex:
            return None
        try:
            np.linalg.cholesky(self.H + 1e-10 * max(1.0, np.abs(self.H).max()) * np.eye(self.dim))
        except np.linalg.LinAlgError:
            return Status.DUAL_INFEASIBLE
        return None

    def failure(self) -> Status:
        """Why a solver found nothing, by two linear programs: no feasible point, or a cost without lower bound.

        Where SciPy is not installed, as on a robot, the status only says that nothing was found.
        """
        try:
            from scipy.optimize import linprog
        except ImportError:
            return Status.ITERATION_LIMIT
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

    def _parts(self) -> tuple[np.ndarray, ...]:
        """All arrays; the rows have length zero where there are none."""
        if self.C is None:
            return self.H, self.g, self.lower, self.upper, *_no_rows(self.dim)
        return self.H, self.g, self.lower, self.upper, self.C, self.row_lower, self.row_upper


@cache
def _no_rows(dim: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return np.zeros((0, dim)), np.zeros(0), np.zeros(0)


@dataclass(frozen=True, eq=False)
class QPSolution:
    """x (d,) with multipliers w (d,) of the box and z (r,) of the rows, positive at upper bounds.

    primal_residual: largest violation of a bound.     dual_residual: ‖H x + g + w + Cᵀz‖_∞.
    gap: |xᵀH x + gᵀx + Σ bound · multiplier|, zero at a solution.     All are infinite where nothing was found.
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
        """The result without a solution, with the reason."""
        nan = np.full(problem.dim, np.nan)
        return cls(nan, nan, np.full(problem.rows, np.nan), status, 0, np.inf, np.inf, np.inf)

    @classmethod
    def judged(cls, problem: QuadraticProgram, x: np.ndarray, box: np.ndarray, rows: np.ndarray,
               claim: Status, iterations: int, tolerance: float) -> QPSolution:
        """The solution with recomputed residuals. It is a success only if these agree with the solver's claim.

        Multipliers of absent bounds come from rounding and are set to zero.
        """
        box, rows = box.copy(), rows.copy()
        primal, dual, gap, weight = program_checks.kkt_residuals(*problem._parts(), x, box, rows)
        if claim.success:
            limit = RESIDUAL_FACTOR * tolerance
            # The gap per unit of multiplier is the mean distance from the active bounds.
            near = primal <= limit and gap <= limit * weight
            if not (near and dual <= limit + ROUNDING * np.abs(problem.g).max()):
                claim = Status.RESIDUAL_TOO_LARGE if np.isfinite(x).all() else Status.NOT_FINITE
        return cls(x, box, rows, claim, iterations, primal, dual, gap)


class Workspace(ABC):
    """A solver with memory for programs of dim variables and `rows` general rows, solved one after the other.

    tolerance: absolute.   max_iterations: of one program.   Raises ValueError for numbers that are not positive.
    """

    def __init__(self, dim: int, rows: int, tolerance: float, max_iterations: int):
        if dim < 1 or rows < 0:
            raise ValueError(f"the problem has {dim} variables and {rows} rows; expected 1 or more and 0 or more")
        if not tolerance > 0 or max_iterations < 1:
            raise ValueError(f"tolerance is {tolerance} and max_iterations {max_iterations}; expected positive numbers")
        self.dim, self.rows = int(dim), int(rows)
        self.tolerance, self.max_iterations = float(tolerance), int(max_iterations)

    # CPU time of this thread in s, as `time.thread_time` gives it, after which no new attempt may begin.
    deadline = np.inf

    @abstractmethod
    def reset(self) -> None:
        """Forget the workspace: the same problems then give the same solutions again, to the last bit."""

    def solve(self, problem: QuadraticProgram) -> QPSolution:
        """Solve the program. Any numbers in it are accepted; ValueError for a problem of another size."""
        if (problem.dim, problem.rows) != (self.dim, self.rows):
            raise ValueError(f"the problem has {problem.dim} variables and {problem.rows} rows; "
                             f"expected {self.dim} and {self.rows}, as in this workspace")
        defect = problem.defect()
        return self._solve(problem) if defect is None else QPSolution.none(problem, defect)

    def explained(self, problem: QuadraticProgram) -> Status:
        """Why nothing was found. Under a deadline there is no time to find out, so it is ITERATION_LIMIT."""
        return problem.failure() if self.deadline == np.inf else Status.ITERATION_LIMIT

    @abstractmethod
    def _solve(self, problem: QuadraticProgram) -> QPSolution:
        """Solve a problem without a defect."""
