"""Rows that were allocated and never written: blocks of exact zeros in every column."""

from __future__ import annotations

import numpy as np

from ssmr_torch.recording_faults.continuity import CERTAIN, smallest_step
from ssmr_torch.recording_faults.recording import Recording
from ssmr_torch.recording_faults.treatment import treated

SHORTEST = 3        # rows; fewer can be outliers


def unwritten_rows(recording: Recording, rule: str, reach: float) -> Recording:
    """The recording without blocks of rows that are exactly zero in all observations and inputs.

    A robot at rest at zero is no such block: it comes to rest, so that the row next to the block is near zero as well.
    The block counts if that row is farther away than a robot comes in one ordinary step.
    """
    y = recording.observation
    zero = (y == 0).all(axis=1) & (recording.input == 0).all(axis=1)
    if zero.sum() < SHORTEST or zero.all():
        return recording
    edges = np.flatnonzero(np.diff(np.r_[False, zero, False].astype(int)))
    moved = np.abs(np.diff(y[~zero], axis=0))
    ordinary = np.median(moved, axis=0) if len(moved) else np.zeros(y.shape[1])
    far = np.maximum(np.maximum(2 * CERTAIN * smallest_step(y[~zero]), ordinary), 0.02 * reach)
    bad = np.zeros_like(zero)
    for first, stop in zip(edges[::2], edges[1::2]):
        beside = [k for k in (first - 1, stop) if 0 <= k < len(y)]
        jumps = [(np.abs(y[k]) > far).any() for k in beside]
        driven = any(recording.input[k].any() for k in beside) and stop == len(y)
        bad[first:stop] = stop - first >= SHORTEST and (any(jumps) or driven and _swings(y, first, reach))
    if not bad.any():
        return recording
    return treated(recording, np.repeat(bad[:, None], y.shape[1], axis=1), "unwritten_rows", rule,
                   "every column is exactly 0, as if never written,")


def _swings(y: np.ndarray, first: int, reach: float) -> bool:
    """Whether the robot still moved in the ten rows before the block."""
    before = y[max(0, first - 10):first]
    return len(before) > 1 and np.ptp(before, axis=0).max() > 0.05 * reach
