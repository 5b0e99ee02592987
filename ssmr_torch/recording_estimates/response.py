"""A simple linear model of the effect of the inputs, whose residuals show drift, offset and friction."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ssmr_torch.recording_estimates.modes import Modes
from ssmr_torch.trajectory import Trajectory

SAMPLES_A_PERIOD = 12   # samples per period that are kept of each run
MOST_MODES = 3
SHORTEST = 4            # smallest length of a run, relative to the memory of the modes
MOST_ROWS = 6000


class Response(NamedTuple):
    """Coefficients (columns, p), m, of each requested regressor, and their standard errors. gain: (m, p), m per unit of
    input, of the static linear part at zero input.
    """

    coefficients: dict[str, np.ndarray]
    errors: dict[str, np.ndarray]
    gain: np.ndarray
    residual: np.ndarray


def response(runs: Sequence[Trajectory], modes: Modes, more, delay: int = 0, where=None,
             shortest: float = SHORTEST) -> Response | None:
    """Least squares of y on the inputs, filtered by the slow modes, and on `more`.

    Each input is filtered by x' = λ (x − u) for the slow rates λ; products of two inputs as well, if there are enough
    rows. y is linear in Re x and Im x. more(run, number, count) → {name: columns (T, k)} are further regressors.
    where(run) → (T,): the samples that count. Standard errors take the correlation of the residuals into account.
    delay: number of samples by which inputs act late. Returns None if no run lasts `shortest` times the modes' memory.
    """
    memory, fastest = modes.memory, modes.fastest
    if memory is None:
        return None
    long = [run for run in runs if run.length * run.timestep > shortest * memory]
    if not long:
        return None
    rates = modes.rates[np.argsort(-modes.share)][:MOST_MODES]
    timestep = long[0].timestep
    total = sum(run.length for run in long)
    every = int(max(1, 2 * np.pi / abs(fastest) / SAMPLES_A_PERIOD / timestep, total / MOST_ROWS))
    begins = round(memory / timestep)
    squares = (total // every) > 10 * 2 * len(rates) * _pairs(long[0].input.shape[1])
    unit = np.abs(np.concatenate([run.input for run in long])).max(axis=0)
    unit[unit == 0] = 1.0
    parts, targets, edges = [], [], []
    for number, run in enumerate(long):
        rows = np.arange(begins, run.length, every)
        rows = rows if where is None else rows[where(run)[rows]]
        seen, static = _seen(run.input / unit, rates, timestep, squares, delay)
        named = {"inputs": seen[rows]}
        named |= {name: np.asarray(columns)[rows] for name, columns in more(run, number, len(long)).items()}
        parts.append(named)
        targets.append(run.observation[rows])
        edges.append(len(targets[-1]))
    found = _solved(parts, np.concatenate(targets), edges)
    gain = found.coefficients["inputs"][static].sum(axis=0) / unit[:, None]
    return found._replace(gain=gain)


def filtered(u: np.ndarray, rates: np.ndarray, timestep: float) -> np.ndarray:
    """(T, columns): each input (T, m) filtered by x' = λ (x - u) for each rate λ, 1/s; Re and Im."""
    return _seen(u, rates, timestep, False, 0)[0]


def _pairs(inputs: int) -> int:
    return inputs + inputs * (inputs + 1) // 2


def _seen(u: np.ndarray, rates: np.ndarray, timestep: float, squares: bool,
          delay: int) -> tuple[np.ndarray, np.ndarray]:
    """Filtered inputs (T, columns), Re and Im for each mode, and (modes, m), the columns with a gain at rest."""
    from scipy.signal import lfilter

    if delay:
        u = np.vstack([np.repeat(u[:1], delay, axis=0), u[:-delay]]) if delay > 0 else np.vstack(
            [u[-delay:], np.repeat(u[-1:], -delay, axis=0)])
    rows, columns = np.triu_indices(u.shape[1])
    signals = np.hstack([u, u[:, rows] * u[:, columns]]) if squares else u
    found, static = [], []
    for rate in rates:
        static.append(sum(each.shape[1] for each in found) + np.arange(u.shape[1]))
        keeps = np.exp(rate * timestep)
        start = (signals[0] * keeps)[None].astype(complex)
        passed, _ = lfilter([0.0, 1.0 - keeps], [1.0, -keeps], signals.astype(complex), axis=0, zi=start)
        found += [passed.real, passed.imag] if abs(rate.imag) > 1e-9 else [passed.real]
    return np.hstack(found), np.array(static)


def _solved(parts, targets, edges) -> Response:
    widths = {name: columns.shape[1] for name, columns in parts[0].items()}
    features = np.concatenate([np.hstack(list(part.values())) for part in parts])
    norms = np.linalg.norm(features, axis=0)
    norms[norms == 0] = 1.0
    scaled = features / norms
    left, singular, basis = np.linalg.svd(scaled, full_matrices=False)
    kept = singular > 1e-6 * singular[0]
    inverse = (basis[kept].T / singular[kept]) @ left[:, kept].T
    solved = inverse @ targets
    residual = targets - scaled @ solved
    freedom = max(1, len(targets) - kept.sum())
    spread = np.sqrt(np.sum(inverse ** 2, axis=1))[:, None] * np.sqrt(
        np.sum(residual ** 2, axis=0) / freedom * _correlation(residual, edges))
    solved, spread = solved / norms[:, None], spread / norms[:, None]
    bounds = np.cumsum([0, *widths.values()])
    coefficients, errors = ({name: table[low:high] for name, low, high in zip(widths, bounds, bounds[1:])}
                            for table in (solved, spread))
    return Response(coefficients, errors, np.empty(0), residual)


def _correlation(residual: np.ndarray, edges: Sequence[int]) -> np.ndarray:
    """(p,), number of correlated residuals that count as one: 1 + 2 Σ ρ, summed until the correlation has decayed."""
    factors = np.ones(residual.shape[1])
    for column in range(residual.shape[1]):
        spectrum, longest = 0.0, max(edges)
        size = 2 * longest
        for part in np.split(residual[:, column], np.cumsum(edges)[:-1]):
            spectrum = spectrum + np.abs(np.fft.rfft(part, size)) ** 2
        correlation = np.fft.irfft(spectrum)[:longest]
        correlation = correlation / (correlation[0] or 1.0)
        ends = np.flatnonzero(correlation < 0.05)
        factors[column] = 1 + 2 * correlation[1:ends[0] if len(ends) else longest].sum()
    return factors
