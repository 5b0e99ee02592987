"""Output coordinates that suit the data: constant-curvature arcs, whose bases are estimated from displacements only."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ssmr_torch.models.output_coordinates import ConstantCurvature, OutputCoordinates

ROWS = 800             # number of samples from which a base is estimated
STEADIER = 0.6         # largest spread of the arc length, relative to the spread of the axial displacement
FARTHEST = 30.0        # largest distance of a base, relative to the largest displacement
FAR = 100.0            # distance of the base of a marker without an estimated one, relative to the largest displacement
DISTANCES = (1.5, 3.0, 8.0)
STRAIGHT = 3.1        # rad; an arc that bends more has no length


def offered(y: np.ndarray) -> dict[str, OutputCoordinates | None]:
    """Coordinates by name for displacements y (S, p): the identity (None), and constant-curvature arcs.

    Arcs need columns that are markers of 3 (or 2) coordinates, and a plausible base of the marker that moves most. A
    marker without a plausible base gets one far away along the same axis, which hardly changes its coordinates.
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
    """Vector c from the base to the marker at rest for which the arc length ‖c + y‖ a / sin a varies least; y (S, q),
    m.

    None if the arc length varies almost as much as the displacement along c, or if the base is far away.
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
    """Length of the arc that starts at the base along c and ends at P (relative to the base): (S, q) → (S,)."""
    e = np.asarray(c) / np.linalg.norm(c)
    along = P @ e
    lateral = np.linalg.norm(P - along[:, None] * e, axis=1)
    return np.linalg.norm(P, axis=1) / np.sinc(np.minimum(np.arctan2(lateral, along), STRAIGHT) / np.pi)
