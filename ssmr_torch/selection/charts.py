"""Charts of a slow-fast model: slow coordinates z = V [1, window, past inputs], and the known part of their step."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ssmr_torch.selection.folds_and_starts import Samples
from ssmr_torch.selection.least_squares import Moments
from ssmr_torch.selection.specification import Specification

QUIET = 1e-4      # relative noise below which the predictive chart must also predict the newest sample
SPANNED = 0.02    # relative to the largest singular value: directions of z above it span the outputs
TINY_RIDGE, OUTPUT_RIDGE = 1e-11, 1e-9


@dataclass(frozen=True)
class Chart:
    """z = V past,  z⁺ = L z + E (fitted part),  and ξ = exact · z if the outputs are among the coordinates.

    V (n, 1 + (d + 1) p' + d m): over the constant, the window and the past inputs, both oldest first. leading: number
    of first coordinates that span the outputs. follows: number of coordinates after them that are velocities.
    """

    V: np.ndarray
    L: np.ndarray
    E: np.ndarray
    leading: int
    follows: int
    exact: np.ndarray | None = None


def past_of(samples: Samples, name: str, delays: int, at: np.ndarray) -> np.ndarray:
    """[1, window, past inputs], scaled, at the samples `at`: (R, 1 + (d + 1) p' + d m)."""
    xi, at = samples.latent(name), at[:, None]
    inputs = (samples.u[at + np.arange(-delays, 0)] - samples.input_mean) / samples.input_scale
    window = xi[at + np.arange(-delays, 1)]
    return np.concatenate([np.ones((len(at), 1)), window.reshape(len(at), -1), inputs.reshape(len(at), -1)], axis=1)


def delay_chart(delays: int, directions: np.ndarray, inputs: int) -> Chart:
    """Chart of the newest sample along its principal directions (p', p'), and of the differences between samples,
    newest first.
    """
    d, p = delays, len(directions)
    n = (d + 1) * p
    differences = np.zeros((d + 1, d + 1))
    differences[0, -1] = 1.0
    for j in range(1, d + 1):
        differences[j, d - j + 1], differences[j, d - j] = 1.0, -1.0
    V = np.zeros((n, 1 + n + d * inputs))
    V[:, 1:1 + n] = np.kron(differences, directions)
    L, E = np.zeros((n, n)), np.zeros((n, p))
    L[:p, :p] = E[:p] = np.eye(p)
    if d:
        E[p:2 * p] = np.eye(p)
        L[2 * p:, p:-p] = np.eye((d - 1) * p)
    exact = np.zeros((p, n))
    exact[:, :p] = directions.T
    return Chart(V, L, E, p, p if d else 0, exact)


def predictive_targets(samples: Samples, specification: Specification, rows: np.ndarray, noise: float) -> np.ndarray:
    """Targets of the predictive chart: the scored outputs of the next samples, and of this one if it has no noise."""
    ahead = np.arange(0 if noise < QUIET * samples.scale else 1, specification.future + 1)
    xi = samples.latent(specification.coordinates)[rows[:, None] + ahead]
    columns = samples.targets if xi.shape[-1] == samples.output_dim else slice(None)
    return xi[..., columns].reshape(len(rows), -1)


def future_inputs(samples: Samples, future: int, rows: np.ndarray) -> np.ndarray:
    """Inputs that act during the next samples, scaled, (R, future m)."""
    held = samples.u[rows[:, None] + np.arange(future)]
    return ((held - samples.input_mean) / samples.input_scale).reshape(len(rows), -1)


def predictive_chart(moments: Moments, seen: int, newest: slice, states: int) -> Chart:
    """Chart from the moments of [past, future inputs] and the targets.

    The part of the targets that the past explains, a projection along the future inputs, has `states` leading
    directions [subspace identification: Van Overschee and De Moor 1994].
    seen: number of columns of past; newest: the columns of the newest sample.
    """
    explained = moments.solution(TINY_RIDGE)[:, :seen]
    past = moments.regressors[:seen, :seen]
    directions = leading_directions(explained @ past @ explained.T, states)
    return _turned(directions @ explained, past, newest)


def tangent_chart(decays: np.ndarray, past: np.ndarray, window: slice, newest: slice, states: int) -> Chart:
    """Chart of the leading directions of the decays' windows. decays, past: second moments of [1, window, past inputs].
    """
    V = np.zeros((states, len(past)))
    V[:, window] = leading_directions(decays[window, window], states)
    return _turned(V, past, newest)


def leading_directions(matrix: np.ndarray, count: int) -> np.ndarray:
    """Eigenvectors of a symmetric matrix as rows, the largest eigenvalues first."""
    return np.linalg.eigh(0.5 * (matrix + matrix.T))[1][:, ::-1][:, :count].T


def _turned(V: np.ndarray, past: np.ndarray, newest: slice) -> Chart:
    """Chart with z transformed so that its first coordinates are the leading directions of the outputs, and all have
    variance 1.
    """
    n = len(V)
    spread = V @ past @ V.T
    root = np.linalg.cholesky(spread + 1e-12 * np.trace(spread) / n * np.eye(n)).T
    joint = np.concatenate([np.eye(1, len(past)), V])
    outputs = Moments(joint @ past @ joint.T, joint @ past[:, newest], 1).solution(OUTPUT_RIDGE)[:, 1:]
    values, turn = np.linalg.svd(outputs @ root.T, full_matrices=True)[1:]
    leading = min(int((values > SPANNED * values[0]).sum()), n)
    return Chart(turn @ np.linalg.inv(root).T @ V, np.zeros((n, n)), np.eye(n), leading, n - leading)
