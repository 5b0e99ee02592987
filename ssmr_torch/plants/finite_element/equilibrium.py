"""Static equilibrium: M g + H(q) u = f(q)."""

from __future__ import annotations

import numpy as np
from scipy.sparse import diags_array
from scipy.sparse.linalg import splu

from ssmr_torch.plants.finite_element.structure import Structure
from ssmr_torch.plants.finite_element.time_stepping import DivergenceError

ITERATIONS = 500
TOLERANCE = 1e-11           # of the weight and the tensions
FIRST, LONGEST = 0.02, 1e6  # s
FARTHEST = 0.05             # of the body's size: the largest step
WORST = 100.0               # of the previous residual: the largest residual of an accepted step


def equilibrium(structure: Structure, tensions: np.ndarray, guess: np.ndarray | None = None) -> np.ndarray:
    """Positions (N, 3) m at rest under tensions (m,) N, by pseudo-transient continuation.

    (M / h² + K) δ = r = M g + H u − f(q), q += δ, with the exact tangent K. The step h grows as the residual falls,
    h₊ = 2 h ‖r‖ / ‖r₊‖ but at most 2 h (Kelley and Keyes, SIAM J. Numer. Anal. 35, 1998). So it begins damped and ends
    as Newton's method. A step that is too long, or makes the residual much larger, is repeated with h / 4.
    guess: (N, 3), default: the undeformed body.   Raises DivergenceError.
    """
    positions = structure.mesh.nodes.copy() if guess is None else guess.copy()
    tolerance = TOLERANCE * (structure.weight + np.abs(tensions).sum()) + structure.rounding
    sparsity, h = structure.sparsity, FIRST
    left, tangent = structure.forces(positions, tensions), structure.tangent(positions, tensions)
    for _ in range(ITERATIONS):
        size = np.linalg.norm(left)
        if size <= tolerance:
            return positions
        with np.errstate(all="ignore"):  # a step that is too long is refused below
            step = splu((tangent + diags_array(structure.mass / h ** 2)).tocsc()).solve(left)
            moved = sparsity.scatter(sparsity.gather(positions) + step, positions)
            force = structure.forces(moved, tensions)
        found = np.linalg.norm(force)
        # Any comparison with NaN is false, so a NaN is refused, too.
        if np.abs(step).max() <= FARTHEST * structure.mesh.size and found < WORST * size:
            positions, left, tangent = moved, force, structure.tangent(moved, tensions)
            h = min(LONGEST, 2 * h * min(1.0, max(0.5, size / max(found, 1e-300))))
        else:
            h /= 4
    raise DivergenceError(f"no equilibrium under the tensions {tensions.tolist()} N in {ITERATIONS} iterations: the "
                          f"residual is {size:.3g} N, expected {tolerance:.3g} N; use lower tensions or a stiffer body")
