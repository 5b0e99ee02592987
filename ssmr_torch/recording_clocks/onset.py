"""The onset of a response: how many samples after a command the robot moves first."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

Signals = tuple[np.ndarray, np.ndarray]  # observation (T, p) and input (T, m) at even times

EARLIEST, LATEST = -40, 40  # samples
PAST = 6                    # number of past outputs from which the prediction is made
AHEAD = (1, 3, 8)           # numbers of samples that it predicts ahead
ROWS = 8000
SIGNIFICANT = 0.005         # share of the residual that the inputs of one lag must explain
TELLING = 0.05              # share that the inputs of the most informative lag must explain; else they are too smooth
ONSET = 0.1                 # share of what the most informative lag explains
FLOOR = 1e-12               # smallest residual, relative to the motion
LAST = 4                    # last lags, which stand for all earlier inputs and are not judged
CHANCE = 6.0                # multiple of the mean that an input explains by chance


class Onset(NamedTuple):
    """samples: number of samples between a command and the first motion; 0 if input[k] already acts on
    observation[k + 1]; None if it cannot be estimated. gain: (lags, ratio), by which factor the inputs up to each lag
    reduce the residual.
    """

    samples: int | None
    lags: np.ndarray
    residual: np.ndarray


def onset_of(runs: Sequence[Signals], earliest: int = EARLIEST) -> Onset:
    """The smallest lag at which inputs matter: y[k+s] is regressed on the past of y and on inputs u[k+s-1-j].

    The inputs are added from the earliest to the latest, one block per lag j. The residuals of all these nested
    regressions come from one QR decomposition. The delay is the smallest lag that still lowers the residual by more
    than `SIGNIFICANT`, by more than chance, and by more than `ONSET` of the most informative lag. The smallest delay
    over several steps s ahead counts, because noise can only hide an effect. Lags from `earliest` on are looked at.
    """
    runs = [(y, u) for y, u in runs if len(y) > LATEST + 4 * PAST and np.ptp(u, axis=0).max(initial=0.0) > 0]
    lags = np.arange(earliest, LATEST + 1)
    if not runs:
        return Onset(None, lags, np.full(len(lags), np.nan))
    best, shown = None, None
    for ahead in AHEAD:
        residual, chance = _nested(runs, ahead, lags)
        drop = (residual[1:] / residual[:-1] - 1)[:-LAST]  # share that the inputs of lag j explain
        matters = np.flatnonzero(drop > max(SIGNIFICANT, chance, ONSET * drop.max()))
        found = None if not len(matters) or drop.max() < TELLING else int(lags[matters[0]])
        if found is not None and (best is None or found < best):
            best, shown = found, residual
        shown = residual if shown is None else shown
    return Onset(best, lags, shown / shown[0])


def _nested(runs: Sequence[Signals], ahead: int, lags: np.ndarray) -> tuple[np.ndarray, float]:
    """Residual with the inputs of lag j and later, for each j, and its expected change by chance."""
    scale = np.std(np.concatenate([y for y, _ in runs]), axis=0)
    known, targets = [], []
    for observation, inputs in runs:
        first, last = lags[-1] + PAST + ahead, len(observation) + min(lags[0], 0) - 1
        rows = np.arange(first, last)  # rows of the target
        every = max(1, sum(len(y) for y, _ in runs) // ROWS)
        rows = rows[::every]
        y = observation / scale
        past = y[(rows - ahead)[:, None] - np.arange(PAST)].reshape(len(rows), -1)
        commands = [inputs[rows - 1 - lag] for lag in lags[::-1]]
        known.append(np.hstack([past, np.ones((len(rows), 1)), *commands]))
        targets.append(y[rows] - y[rows - ahead])
    known, targets = np.concatenate(known), np.concatenate(targets)
    known = known + 1e-9 * np.std(known, axis=0) * np.random.default_rng(0).normal(size=known.shape)
    width, columns = known.shape[1], runs[0][1].shape[1]
    if len(known) < 2 * width:
        return np.ones(len(lags)), np.inf
    triangle = np.linalg.qr(np.hstack([known, targets]), mode="r")
    explained = np.sum(triangle[:width, width:] ** 2, axis=1)
    rest = np.sum(triangle[width:, width:] ** 2) + FLOOR * np.sum(targets ** 2)
    remaining = rest + np.sum(explained) - np.cumsum(explained)
    before = width - columns * len(lags)
    return remaining[before + columns - 1::columns][::-1], CHANCE * columns / len(known)
