"""A solver of one's own for quadratic programs: SciPy's bounded least squares."""

import numpy as np
from scipy.optimize import lsq_linear

from ssmr_torch.control.quadratic_program import QPSolution, QuadraticProgram, Workspace
from ssmr_torch.status import Status


class BoundedLeastSquares(Workspace):
    """min ½ ‖Lᵀ x + L⁻¹ g‖² with H = L Lᵀ between the bounds on x. Raises ValueError for programs with further rows."""

    def __init__(self, dim: int, rows: int = 0, *, tolerance: float = 1e-6, max_iterations: int = 200):
        super().__init__(dim, rows, tolerance, max_iterations)
        if rows:
            raise ValueError(f"{rows} rows of constraints; this solver knows bounds on the inputs alone")

    def reset(self) -> None:
        """Nothing is kept between programs."""

    def _solve(self, problem: QuadraticProgram) -> QPSolution:
        L = np.linalg.cholesky(problem.H)
        found = lsq_linear(L.T, -np.linalg.solve(L, problem.g), (problem.lower, problem.upper), method="bvls",
                           tol=1e-14, max_iter=self.max_iterations)
        held = np.where(found.active_mask != 0, -(problem.H @ found.x + problem.g), 0.0)
        return QPSolution.judged(problem, found.x, held, np.zeros(0), Status.SOLVED, found.nit, self.tolerance)
