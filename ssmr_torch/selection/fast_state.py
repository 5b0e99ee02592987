"""The fast state (fast fibre) of a slow-fast model: the deviation from the slow manifold, which only decays.

    f_0 = K [1, window, past inputs],   f⁺ = Λ f with |eig Λ| ≤ 0.9,   ξ = slow model + C f

K, Λ and C are identified from the residuals of the slow model's rollouts in their first samples, by the eigensystem
realization algorithm [Juang and Pappa 1985]. No input drives the fast state, so it cannot make the model unstable. For
a controller it is a known offset of the outputs.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ssmr_torch.models.batch_rollout import batch_of
from ssmr_torch.models.monomials import Monomials
from ssmr_torch.models.polynomial import PolynomialModel
from ssmr_torch.selection.folds_and_starts import FOLDS, Samples
from ssmr_torch.selection.least_squares import Moments
from ssmr_torch.selection.windows import longer_window

AHEAD, WINDOW = 12, 10    # number of residual samples that are explained; number of past samples that explain them
SLOWEST = 0.9             # largest modulus of the eigenvalues, per step
RIDGE = 1e-7


def with_fibre(model: PolynomialModel, samples: Samples, states: int, fold: int = FOLDS) -> PolynomialModel:
    """The model with this number of fast states, or fewer if the residuals determine fewer.

    fold: the rows that it holds out are not used. Raises LinAlgError or ValueError if the residuals determine none.
    """
    rows = samples.rows(AHEAD, decays=False)
    if fold < FOLDS:
        rows = rows[~samples.touching(rows, AHEAD)[fold]]
    longer = longer_window(model, min(WINDOW, samples.past))
    D = longer.delays
    windows, past = (array[rows[:, None] + np.arange(-D, last)] for array, last in ((samples.y, 1), (samples.u, 0)))
    latent = replace(longer, coordinates=None) if model.coordinates is not None else longer
    found = batch_of(latent).outputs(longer.encode(windows, past), samples.u[rows[:, None] + np.arange(AHEAD)])
    follows = samples.y[rows[:, None] + np.arange(1, AHEAD + 1)]
    left = (follows if model.coordinates is None else model.coordinates.forward(follows)) - found
    X = longer.chart_regressors(windows, past)
    usable = np.isfinite(left).all((1, 2))
    A, C, K = _realized(X[usable], left[usable] / samples.scale, states)
    return _joined(longer, A, samples.scale * C, K, np.abs(X[usable] @ K.T).max(0))


def _realized(X: np.ndarray, left: np.ndarray, states: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Λ (f, f), C (p', f) and K (f, ·) such that C Λʲ K x is the residual (N, J, p') j samples ahead, j = 1 … J."""
    N, J, p = left.shape
    moments = Moments.of(X, left.reshape(N, -1))
    explained = moments.solution(RIDGE)                                          # (J p', ·)
    weight = np.repeat(1.0 / np.maximum(np.sqrt(np.square(left).sum(2).mean(0)), 1e-12), p)[:, None]
    values, vectors = np.linalg.eigh(moments.regressors)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    U, sizes, _ = np.linalg.svd(weight * explained @ root, full_matrices=False)
    states = min(states, int((sizes > 1e-6 * sizes[0]).sum()), p * (J - 1))
    observability = U[:, :states] * np.sqrt(sizes[:states]) / weight
    A = np.linalg.lstsq((weight * observability)[:-p], weight[:-p] * observability[p:], rcond=None)[0]
    A, C = _decaying(A), observability[:p]
    ahead = np.concatenate([C @ np.linalg.matrix_power(A, j) for j in range(J)])
    K = np.linalg.lstsq(weight * ahead, weight * explained, rcond=None)[0]
    return A, C, np.linalg.lstsq(A, K, rcond=1e-6)[0]                            # f is advanced before its first use


def _decaying(A: np.ndarray) -> np.ndarray:
    """The matrix with every eigenvalue of modulus above `SLOWEST` moved onto that circle."""
    values, vectors = np.linalg.eig(A)
    size = np.abs(values)
    values = np.where(size > SLOWEST, values / np.maximum(size, 1e-300) * SLOWEST, values)
    return np.real(vectors @ np.diag(values) @ np.linalg.inv(vectors))


def _joined(model: PolynomialModel, A: np.ndarray, C: np.ndarray, K: np.ndarray,
            largest: np.ndarray) -> PolynomialModel:
    """The model with the fast states f appended to its state."""
    n, f, m, structure = model.state_dim, len(A), model.input_dim, model.structure
    moved = [tuple(k if k < n else k + f for k in row) for row in structure.dynamics.factors]
    fast = [(n + k,) for k in range(f)]
    dynamics = np.zeros((n + f, len(moved) + f))
    dynamics[:n, :len(moved)], dynamics[n:, len(moved):] = model.dynamics, A
    outputs = Monomials(n + f, [*structure.parametrization.factors, *fast])
    return replace(
        model, structure=structure._replace(dynamics=Monomials(n + f + m, [*moved, *fast]), parametrization=outputs),
        chart=np.concatenate([model.chart, K]), dynamics=dynamics,
        parametrization=np.concatenate([model.parametrization, C], axis=1),
        state_scale=np.concatenate([model.state_scale, np.maximum(largest, 1e-300)]))
