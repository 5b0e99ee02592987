"""How late inputs stand against the outputs that they move: the shift with which they predict them best."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ssmr_torch.recording_clocks.onset import Signals, onset_of

PAST = 6                # past outputs from which a prediction starts
AHEAD, AHEAD_S = 4, 0.02    # samples that it predicts ahead at least, and s
REACH = 0.6             # s, of lags to either side
MOST = 90               # candidate lags to either side; beyond, every other sample, or fewer, is a candidate
ROWS = 8000
STRETCHES = 12          # that are held out in turn
TELLING = 0.05          # share of the error that the inputs of the best lag must explain
CLEAR, CLEAR_ONE = 0.05, 0.5    # share of the error by which the best lag must be better than none; one of 1 sample
SURE = 3.0              # standard errors over the stretches, of what is significant
LIKE = 2.0              # standard errors within which a lag is as good as the best
NEAR = 12               # samples before the lag at which the motion may begin
RIDGE = 1e-9


class Lag(NamedTuple):
    """samples: by which the inputs stand late (negative: early); None where the recordings do not tell. low, high:
    lags that explain the motion as well. significant: whether it differs from 0. lags, error: (n,), the error of the
    prediction at each candidate, relative to that without inputs.
    """

    samples: int | None
    low: int
    high: int
    significant: bool
    lags: np.ndarray
    error: np.ndarray


def lag_of(runs: Sequence[Signals], interval: float, reach: float = REACH) -> Lag:
    """The lag of the inputs in runs that were sampled every `interval` s, within `reach` s.

    For each candidate L the outputs h samples on (`AHEAD`) are predicted by least squares, from the last `PAST` outputs
    and the inputs that were held on the way, u[k+L], …, u[k+L+h-1]. So a robot's own dynamics are in the model, and the
    lag is what remains. The error is that of stretches which were left out of the fit. A delay of the actuator is a
    negative lag: it cannot be told from inputs that were logged early.
    """
    farthest = max(2, round(reach / interval))
    runs = [(y, u) for y, u in runs if len(y) > 4 * PAST and len(u) and np.ptp(u, axis=0).max(initial=0.0) > 0]
    runs = [(y, u) for y, u in runs if len(y) >= max(len(each[0]) for each in runs) / 4]
    farthest = min([farthest, *((len(y) - 4 * PAST) // 3 for y, _ in runs)])
    every = max(1, -(-farthest // MOST))
    lags = np.arange(-(farthest // every), farthest // every + 1)
    if not runs or farthest < 2:
        return Lag(None, 0, 0, False, lags, np.ones(len(lags)))
    ahead = max(AHEAD, round(AHEAD_S / interval))
    found = _best(lags, *_errors([_thinned(y, u, every) for y, u in runs], lags, max(AHEAD, ahead // every)))
    if every == 1:
        return _without_slow_response(runs, found)
    if found.samples is None:
        return found._replace(lags=every * lags)
    at = every * found.samples
    near = np.arange(max(-farthest, at - 2 * every), min(farthest, at + 2 * every) + 1)
    exact = _best(near, *_errors(runs, near, ahead))
    significant = found.significant or exact.significant
    return _without_slow_response(runs, exact._replace(significant=significant, lags=every * lags, error=found.error))


def _without_slow_response(runs: Sequence[Signals], found: Lag) -> Lag:
    """The lag at which the motion begins, where it grows over some samples after each input.

    An actuator that follows slowly looks like a delay, but answers at once: the inputs at the lag are not all that act.
    """
    if not found.significant:
        return found
    moved = [_moved(y, u, found.samples) for y, u in runs]
    before = onset_of(moved, -NEAR).samples
    if before is None or before >= 0:
        return found
    begins = found.samples - before
    crossed = found.samples < 0 <= begins
    return found._replace(samples=0 if crossed else begins, high=max(found.high, begins), significant=not crossed)


def _moved(y: np.ndarray, u: np.ndarray, lag: int) -> Signals:
    """The signals with the inputs shifted to where they act."""
    first, last = max(0, -lag), len(y) - max(0, lag)
    return y[first:last], u[first + lag:last + lag]


def _thinned(y: np.ndarray, u: np.ndarray, every: int) -> Signals:
    """Every so many samples, inputs averaged between them."""
    count = len(y) // every
    means = u[:count * every].reshape(count, every, -1).mean(axis=1)
    return y[:count * every:every], means


def _errors(runs: Sequence[Signals], lags: np.ndarray, ahead: int) -> tuple[np.ndarray, np.ndarray]:
    """(stretches, lags) squared errors at each lag, and (stretches,) without inputs."""
    blocks = [_regressors(y, u, lags, ahead, max(1, sum(len(each[0]) for each in runs) // ROWS)) for y, u in runs]
    known, offered, targets = (np.concatenate([block[place] for block in blocks]) for place in range(3))
    scale = np.std(targets, axis=0)
    targets = targets / np.where(scale > 0, scale, 1.0)
    basis = np.linalg.qr(known + 0.0)[0]
    offered = offered - basis @ (basis.T @ offered)
    targets = targets - basis @ (basis.T @ targets)
    sizes = [len(block[0]) for block in blocks]
    edges = _edges(sizes)
    grams, moments, powers = [], [], []
    for first, last in zip(edges, edges[1:]):
        some, wanted = offered[first:last], targets[first:last]
        grams.append(some.T @ some)
        moments.append(some.T @ wanted)
        powers.append(np.sum(wanted ** 2))
    whole, moment = sum(grams), sum(moments)
    inputs = runs[0][1].shape[1]
    shifts = offered.shape[1] // inputs
    errors = np.empty((len(grams), len(lags)))
    for place, lag in enumerate(lags):
        first = int(lag - lags[0])
        columns = (np.arange(first, first + ahead)[:, None] + shifts * np.arange(inputs)).ravel()
        part = np.ix_(columns, columns)
        ridge = RIDGE * np.trace(whole[part]) * np.eye(len(columns)) + 1e-300 * np.eye(len(columns))
        for fold, (gram, of) in enumerate(zip(grams, moments)):
            weights = np.linalg.solve(whole[part] - gram[part] + ridge, moment[columns] - of[columns])
            errors[fold, place] = powers[fold] - 2 * np.sum(weights * of[columns]) + np.sum(
                weights * (gram[part] @ weights))
    return errors, np.array(powers)


def _regressors(y: np.ndarray, u: np.ndarray, lags: np.ndarray, ahead: int, every: int) -> tuple[np.ndarray, ...]:
    """Past outputs and a constant, all shifted inputs (one input after the other), and what is to be predicted."""
    first = max(PAST - 1, -int(lags[0]))
    last = min(len(y) - ahead, len(y) - ahead + 1 - int(lags[-1]))
    rows = np.arange(first, last)[::every]
    past = y[rows[:, None] - np.arange(PAST)].reshape(len(rows), -1)
    shifts = np.arange(lags[0], lags[-1] + ahead)
    offered = u[np.clip(rows[:, None] + shifts, 0, len(u) - 1)].transpose(0, 2, 1).reshape(len(rows), -1)
    return np.hstack([past, np.ones((len(rows), 1))]), offered, y[rows + ahead] - y[rows]


def _edges(sizes: Sequence[int]) -> np.ndarray:
    """Rows at which stretches begin, some in each run."""
    each = max(2, -(-STRETCHES // len(sizes)))
    starts = np.r_[0, np.cumsum(sizes)]
    return np.unique(np.concatenate([np.linspace(first, last, each + 1).astype(int)
                                     for first, last in zip(starts, starts[1:])]))


def _best(lags: np.ndarray, errors: np.ndarray, without: np.ndarray) -> Lag:
    total = errors.sum(axis=0)
    relative = total / max(without.sum(), 1e-300)
    best = int(np.argmin(total))
    if relative[best] > 1 - TELLING:
        return Lag(None, 0, 0, False, lags, relative)
    worse = errors - errors[:, [best]]
    spread = np.std(worse, axis=0, ddof=1) / np.sqrt(len(errors)) + 1e-300
    mean = worse.mean(axis=0)
    alike = (mean <= LIKE * spread) | (total <= 1.001 * total[best])
    low = high = best
    while low > 0 and alike[low - 1]:
        low -= 1
    while high < len(lags) - 1 and alike[high + 1]:
        high += 1
    none = int(np.argmin(np.abs(lags)))
    needed = CLEAR if abs(lags[best]) > 1 else CLEAR_ONE
    clear = lags[none] == 0 and total[none] > (1 + needed) * total[best] and mean[none] > SURE * spread[none]
    return Lag(int(lags[best]), int(lags[low]), int(lags[high]), bool(clear and best != none), lags, relative)


def error_of(run: Signals, interval: float) -> float:
    """The error at lag 0, on stretches that were left out, relative to that without inputs."""
    errors, without = _errors([run], np.array([0]), max(AHEAD, round(AHEAD_S / interval)))
    return float(errors.sum() / max(without.sum(), 1e-300))
