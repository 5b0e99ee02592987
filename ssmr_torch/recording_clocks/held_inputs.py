"""Inputs that are held between their own times, as means over the intervals of another clock."""

from __future__ import annotations

import numpy as np


def mean_of_held(time: np.ndarray, inputs: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Means over [edges[k], edges[k+1]] of inputs held from time[j] to time[j+1]; (K, m).

    The first input is held before time[0], and the last beyond time[-1].
    """
    begin = min(edges[0], time[0])
    end = max(edges[-1], time[-1]) + np.diff(edges).min()
    knots, held = (np.r_[time, end], inputs) if begin == time[0] else (
        np.r_[begin, time[1:], end], inputs)
    impulse = np.r_[np.zeros((1, held.shape[1])), np.cumsum(held * np.diff(knots)[:, None], axis=0)]
    at_edges = np.stack([np.interp(edges, knots, column) for column in impulse.T], axis=1) \
        if held.shape[1] else np.empty((len(edges), 0))
    return np.diff(at_edges, axis=0) / np.diff(edges)[:, None]
