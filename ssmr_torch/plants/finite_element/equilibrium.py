"""Static equilibrium: M g + H(q) u = f(q)."""

from __future__ import annotations

import numpy as np
from scipy.sparse import diags_array
from scipy.sparse.linalg import splu

from ssmr_torch.plants.finite_element.structure import Structure
from ssmr_torch.plants.finite_element.time_stepping import DivergenceError

ITERATIONS = 100
TOLERANCE = 1e-9            # of the weight and the tensions
FIRST, LONGEST = 0.05, 1e6  # s


def equilibrium(structure: Structure, tensions: np.ndarray, guess: np.ndarray | None = None) -> np.ndarray:
    """Positions (N, 3) m at rest under tensions (m,) N, by pseudo-transient continuation.

    (M / h² + K) δ = r = M g + H u − f(q), q += δ, K the exact tangent, with a step h that grows as the residual falls,
    h₊ = 2 h ‖r‖ / ‖r₊‖ (Kelley and Keyes, SIAM J. Numer. Anal. 35, 1998): a damped start, Newton's method in the end.
    guess: (N, 3), default the undeformed body.   Raises DivergenceError.
    """
    positions = structure.mesh.nodes.copy() if guess is None else guess.copy()
    tolerance = TOLERANCE * (np.linalg.norm(structure.mass) * np.linalg.norm(structure.mechanics.gravity)
                             + np.abs(tensions).sum())
    sparsity, h = structure.sparsity, FIRST
    left = structure.forces(positions, tensions)
    for _ in range(ITERATIONS):
        size = np.linalg.norm(left)
        if size <= tolerance:
            return positions
        matrix = structure.tangent(positions, tensions) + diags_array(structure.mass / h ** 2)
        with np.errstate(all="ignore"):  # a step too far is refused below
            moved = sparsity.scatter(sparsity.gather(positions) + splu(matrix.tocsc()).solve(left), positions)
            force = structure.forces(moved, tensions)
        found = np.linalg.norm(force)
        if found < 1e3 * size:  # false for NaN too
            positions, left = moved, force
            h = min(LONGEST, 2 * h * max(0.5, size / max(found, 1e-300)))
        else:
            h /= 4
    raise DivergenceError(f"no equilibrium under the tensions {tensions.tolist()} N within {ITERATIONS} iterations: "
                          f"the residual is {size:.3g} N, expected {tolerance:.3g} N; lower them or stiffen the body")
