"""Direct solvers for the linear system of one step."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from scipy.sparse.linalg import splu

from ssmr_torch.plants.finite_element.block_ldl import BlockLDL
from ssmr_torch.plants.finite_element.sparsity import Sparsity


class LinearSolver(Protocol):
    """A solver that is made from a `Sparsity`; `solve` may be called with other entries each time."""

    def solve(self, data: np.ndarray, right: np.ndarray) -> np.ndarray:
        """x (n,) with A x = right. A is symmetric; its entries are in the order of the sparsity pattern."""


class SuperLU:
    """SciPy's LU without pivoting, on a pattern that already is in a fill-reducing order."""

    def __init__(self, sparsity: Sparsity):
        self.sparsity = sparsity

    def solve(self, data: np.ndarray, right: np.ndarray) -> np.ndarray:
        factor = splu(self.sparsity.matrix(data), permc_spec="NATURAL", diag_pivot_thresh=0.0,
                      options={"SymmetricMode": True, "Equil": False})
        return factor.solve(right)


def linear_solver(name: str, sparsity: Sparsity) -> LinearSolver:
    """The solver "block_ldl" (of this package, by numba), "superlu" (SciPy) or "pardiso" (MKL, the extra `pardiso`).

    Raises ValueError for another name, and when MKL is not installed.
    """
    if name == "pardiso":
        from ssmr_torch.plants.finite_element.pardiso import Pardiso

        return Pardiso(sparsity)
    solvers = {"block_ldl": BlockLDL, "superlu": SuperLU}
    if name not in solvers:
        raise ValueError(f"linear_solver is {name!r}; expected one of {(*solvers, 'pardiso')}")
    return solvers[name](sparsity)
