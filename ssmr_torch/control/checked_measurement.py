"""Measurements as they come: whatever was handed over becomes p numbers, and what cannot be is noticed."""

from __future__ import annotations

import numpy as np

# A displacement of more than this many times the recorded range is not believed to be one.
BEYOND = 2.0
# The range of an output is at least this share of the widest one's.
NARROWEST = 0.2


def read(observation, size: int) -> tuple[np.ndarray, bool]:
    """The observation as float64 (size,), a copy, and whether every value in it was a number.

    What is masked, or no number (None, a word, something complex), becomes NaN: a missing value.
    Raises ValueError for another shape.
    """
    if type(observation) is np.ndarray and observation.dtype == np.float64:
        found, readable = observation.copy(), True
    else:
        found, readable = _numbers(observation, size)
    if found.shape != (size,):
        raise ValueError(f"the observation has shape {found.shape}; expected ({size},)")
    return found, readable


def _numbers(observation, size: int) -> tuple[np.ndarray, bool]:
    if isinstance(observation, np.ma.MaskedArray):
        values, readable = _numbers(observation.data, size)
        return np.where(np.ma.getmaskarray(observation), np.nan, values), readable
    numeric = not isinstance(observation, np.ndarray) or observation.dtype.kind in "fiub"
    try:
        if numeric:
            return np.array(np.asarray(observation, dtype=np.float64)), True
    except (TypeError, ValueError, OverflowError, RuntimeError):
        pass  # not numbers alone: each is looked at below
    try:
        values = np.asarray(observation, dtype=object)
    except (TypeError, ValueError, RuntimeError):  # what refuses to be an array
        return np.full(tuple(getattr(observation, "shape", ())), np.nan), False
    return np.array([_number(value) for value in values.ravel()]).reshape(values.shape), False


def _number(value) -> float:
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError):
        return float("nan")


class RecordedRange:
    """How far every output went in the training: |y − w(0)| ≤ r,

        r_j = Σ_i max(|w_j(s_i e_i) − w_j(0)|, |w_j(−s_i e_i) − w_j(0)|),   s = state_scale,

    at least `NARROWEST` times the widest. center w(0) (p,), limit `BEYOND` r (p,), both m; the largest number there is
    where state_scale is not known.
    """

    def __init__(self, model):
        scale = np.asarray(model.state_scale, dtype=np.float64)
        self.center, self.limit = np.zeros(model.output_dim), np.full(model.output_dim, np.finfo(np.float64).max)
        if not np.isfinite(scale).all():
            return
        with np.errstate(all="ignore"):
            center = model.decode(np.zeros(len(scale)))
            ends = np.abs(model.decode(np.concatenate([np.diag(scale), np.diag(-scale)])) - center)
        reach = ends.reshape(2, len(scale), -1).max(axis=0).sum(axis=0)
        if np.isfinite(reach).all() and np.isfinite(center).all():
            self.center, self.limit = center, BEYOND * np.maximum(reach, NARROWEST * reach.max())

    def holds(self, observation: np.ndarray) -> np.ndarray:
        """(p,), False for an output that is missing or further away than any displacement can be."""
        return np.abs(observation - self.center) <= self.limit

    def complaint(self, observation: np.ndarray) -> str:
        """What is wrong with a first measurement that lies beyond, with both numbers."""
        excess = np.where(np.isfinite(observation), np.abs(observation - self.center) / self.limit, 0.0)
        worst = int(np.argmax(excess))
        return (f"output {worst} is {1e3 * observation[worst]:.4g} mm at the first measurement; the model was trained "
                f"within {1e3 * self.limit[worst] / BEYOND:.4g} mm. Expected displacements from rest: subtract the "
                "rest position from absolute ones, or record further out")
