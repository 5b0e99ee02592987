"""Estimate of the white measurement noise from recordings."""

from __future__ import annotations

from collections.abc import Sequence
from math import comb
from typing import NamedTuple

import numpy as np

from ssmr_torch.trajectory import Trajectory

ORDERS = (3, 4, 5, 6)  # orders of the differences
WINDOW = 48         # samples in a window
QUIETEST = 0.2      # share of the windows that are used
FEWEST = 12         # smallest number of windows
AGREEMENT = 1.15    # largest ratio between two orders of differences if only white noise remains


class Noise(NamedTuple):
    """std: (p,), m, standard deviation of the white noise; step: (p,), m, step of the rounding, 0 if none is visible.
    bound: whether motion is still visible in the differences, so that std is only an upper bound.
    """

    std: np.ndarray
    step: np.ndarray
    bound: bool


def measurement_noise(runs: Sequence[Trajectory]) -> Noise:
    """White noise by differences of order q in quiet windows: var(Δ^q y) = C(2q, q) σ².

    Differences of a smooth motion become smaller with the order; those of white noise do not. The order is therefore
    raised until two orders agree. Quiet windows are those with little slow motion, a mean over many samples, which does
    not depend on their noise; windows with the smallest differences would give a σ that is too small. The median over
    windows is corrected to the mean of its χ² distribution, with the degrees of freedom of correlated differences.
    """
    outputs = runs[0].observation.shape[1]
    std, step, bound = np.zeros(outputs), np.zeros(outputs), False
    for column in range(outputs):
        step[column] = rounding([run.observation[:, column] for run in runs])
        settled, lowest = _settled(_by_quietness([run.observation[:, column] for run in runs]))
        std[column] = max(lowest, step[column] / np.sqrt(12))
        bound |= not settled
    return Noise(std, step, bound)


def _settled(windows: np.ndarray) -> tuple[bool, float]:
    """Whether two orders of differences agree in the quietest windows, and the estimate by the lower order."""
    chosen = windows[:max(FEWEST, int(QUIETEST * len(windows)))]
    found = [_of_order(order, chosen) for order in ORDERS] if len(chosen) else [0.0]
    for early, late in zip(found, found[1:]):
        if early <= AGREEMENT * late:
            return True, early
    return False, found[-1]


def _by_quietness(columns: Sequence[np.ndarray]) -> np.ndarray:
    """All windows (n, WINDOW), the slowest motion first."""
    windows, speeds = [], []
    length = int(min(WINDOW, max(len(y) for y in columns)))
    for y in columns:
        for start in range(0, len(y) - length + 1, length):
            part = y[start:start + length]
            windows.append(part)
            speeds.append(np.ptp(part[:length - length % 4].reshape(4, -1).mean(axis=1)) if length >= 4 else 0.0)
    return np.array(windows)[np.argsort(speeds, kind="stable")] if length > max(ORDERS) else np.empty((0, length))


def _of_order(order: int, windows: np.ndarray) -> float:
    differences = np.diff(windows, order, axis=1)
    variance = np.mean(differences ** 2, axis=1) / comb(2 * order, order)
    # a mean square of correlated numbers varies like one of k independent numbers: relative variance 2 / k
    correlation = np.array([comb(2 * order, order + lag) for lag in range(order + 1)]) / comb(2 * order, order)
    freedom = differences.shape[1] / (1 + 2 * np.sum(correlation[1:] ** 2))
    return float(np.sqrt(np.median(variance) / (1 - 2 / (9 * freedom)) ** 3))


def rounding(columns: Sequence[np.ndarray]) -> float:
    """The step to which these values are rounded, m; 0 if they are not rounded."""
    moves = np.concatenate([np.abs(np.diff(y)) for y in columns])
    moves = moves[moves > 0]
    if len(moves) < 50:
        return 0.0
    smallest = np.quantile(moves, 0.001)
    step = float(np.median(moves[moves < 1.5 * smallest]))
    whole = moves / step
    return step if np.mean(np.abs(whole - np.round(whole)) < 0.02) > 0.99 and np.mean(whole < 20.5) > 0.05 else 0.0
