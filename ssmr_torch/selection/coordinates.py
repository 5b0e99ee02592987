"""Output coordinates that the data suggest: constant-curvature arcs from bases inferred out of displacements alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ssmr_torch.models.output_coordinates import ConstantCurvature, OutputCoordinates

ROWS = 800            # samples of which a base is inferred
STEADIER = 0.6        # largest spread of the arc length, of the spread of the axial displacement
FARTHEST = 30.0       # of the largest displacement that a base may be away
FAR = 100.0            # of the largest displacement: the base of a marker without one of its own
DISTANCES = (1.5, 3.0, 8.0)
STRAIGHT = 3.1        # rad; an arc beyond has no length


def offered(y: np.ndarray) -> dict[str, OutputCoordinates | None]:
    """Coordinates by name for displacements y (S, p): the identity, None, and constant-curvature arcs where the columns
    are markers of 3 (or 2) coordinates and the base of the one that moves most is plausible. A marker whose own is not
    gets a base far away along the same axis, which leaves it nearly as it is.
    """
    found: dict[str, OutputCoordinates | None] = {"identity": None}
    size = 3 if y.shape[1] % 3 == 0 else 2 if y.shape[1] % 2 == 0 else 0
    if not size:
        return found
    markers = [y[:, first:first + size] for first in range(0, y.shape[1], size)]
    extents = [float(np.linalg.norm(marker, axis=1).max()) for marker in markers]
    bases = [inferred_base(marker) for marker in markers]
    farthest = bases[int(np.argmax(extents))]
    if farthest is not None:
        away = tuple((FAR * max(extents) / np.linalg.norm(farthest) * np.array(farthest)).tolist())
        found["constant_curvature"] = ConstantCurvature(tuple(away if base is None else base for base in bases))
    return found


def inferred_base(y: np.ndarray) -> tuple[float, ...] | None:
    """Vector c from base to marker at rest that leaves the arc length ‖c + y‖ a / sin a most constant, y (S, q) in m.

    None where the arc length varies hardly less than the displacement along c, or the base is far away.
    """
    from scipy.optimize import least_squares

    y = y[np.random.default_rng(0).permutation(len(y))[:ROWS]]
    size = float(np.linalg.norm(y, axis=1).max())
    if size == 0:
        return None
    axis = np.linalg.svd(y, full_matrices=False)[2][-1]

    def spread(c):
        lengths = arc_length(y + c, c)
        return (lengths - lengths.mean()) / size

    fits = [least_squares(spread, sign * far * size * axis, x_scale=size, max_nfev=60)
            for sign in (1, -1) for far in DISTANCES]
    best = min((fit for fit in fits if np.isfinite(fit.cost)), key=lambda fit: fit.cost, default=None)
    if best is None:
        return None
    c, along = best.x, y @ best.x / np.linalg.norm(best.x)
    steadiness = np.sqrt(2 * best.cost / len(y)) * size / (along.std() + 1e-300)
    plausible = steadiness < STEADIER and np.linalg.norm(c) < FARTHEST * size
    return tuple(c.tolist()) if plausible else None


def arc_length(P: np.ndarray, c: Sequence[float]) -> np.ndarray:
    """Length of the arc from a base along c to P, both from the base, (S, q) → (S,)."""
    e = np.asarray(c) / np.linalg.norm(c)
    along = P @ e
    lateral = np.linalg.norm(P - along[:, None] * e, axis=1)
    return np.linalg.norm(P, axis=1) / np.sinc(np.minimum(np.arctan2(lateral, along), STRAIGHT) / np.pi)
