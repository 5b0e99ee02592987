"""Checks of input bounds, and of an input that must lie within them."""

from __future__ import annotations

import numpy as np


def changed_bounds(bounds, shape: tuple[int, int]) -> np.ndarray:
    """New input bounds (2, m) for a controller with bounds of this shape; equal ones fix the input of a dead actuator.

    Raises ValueError, with both numbers, for bounds that are not finite or crossed, and for another shape.
    """
    bounds = np.array(bounds, dtype=np.float64)
    if bounds.shape != shape:
        raise ValueError(f"input_bounds has shape {bounds.shape}; expected {shape}: lowest and highest input")
    for place, (lower, upper) in enumerate(bounds.T):
        if not (np.isfinite(lower) and np.isfinite(upper) and lower <= upper):
            raise ValueError(f"input {place} is bounded by {lower} and {upper}; expected finite numbers, the lower one "
                             "not above the upper one")
    return bounds


def admissible_input(name: str, given, bounds: np.ndarray) -> np.ndarray:
    """The given input (m,); None: the input within the bounds (2, m) that is nearest to zero.

    Raises ValueError, with the name of the setting, where it is not m numbers within the bounds.
    """
    lower, upper = bounds
    found = np.clip(0.0, lower, upper) if given is None else np.array(given, dtype=np.float64)
    if found.shape != lower.shape or not ((lower <= found) & (found <= upper)).all():
        raise ValueError(f"{name} is {found.tolist()}; expected {len(lower)} numbers between {lower.tolist()} and "
                         f"{upper.tolist()}")
    return found
