"""A trajectory piecewise linear model as plain arrays."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ssmr_torch.models.integrators import whole_multiple
from ssmr_torch.models.kalman import Noise, filter_window
from ssmr_torch.models.tables import DiscreteTimeTables

NEGLIGIBLE = 1e-17  # of the greatest weight: a hundred such points change less than rounding does
BLOCK = 16


@dataclass(frozen=True, eq=False, kw_only=True)
class TPWLTables(DiscreteTimeTables):
    """z = [q̃, ṽ];   z⁺ = Σ_i w_i(q̃) (A_i z + B_i u + c_i);   y = C z + d;   chart: an extended Kalman filter.

    points (N, n/2): q̃_i, m.   A (N, n, n), B (N, n, m), c (N, n).   C (p, n), d (p,).   width: m, see `TPWL`.
    mean (n,), covariance (n, n), process (n, n), measurement (p, p): of the filter, see `Noise`.
    """

    points: np.ndarray
    A: np.ndarray
    B: np.ndarray
    c: np.ndarray
    C: np.ndarray
    d: np.ndarray
    mean: np.ndarray
    covariance: np.ndarray
    process: np.ndarray
    measurement: np.ndarray
    width: float

    def __post_init__(self):
        super().__post_init__()
        whole_multiple(self.window_timestep, self.base_timestep)

    def encode(self, window: np.ndarray, inputs: np.ndarray) -> np.ndarray:
        noise = Noise(self.mean, self.covariance, self.process, self.measurement)
        return filter_window(self, window, inputs, noise, whole_multiple(self.window_timestep, self.base_timestep),
                             np.linalg.solve)

    def decode(self, z: np.ndarray) -> np.ndarray:
        return z @ self.C.T + self.d

    def advance(self, z: np.ndarray, u: np.ndarray) -> np.ndarray:
        if self.width == 0.0:
            return self._at_nearest(z, u)[0]
        following = np.zeros_like(z)
        for weights, each, _ in self._blocks(z, u):
            following += (weights[..., None, :] @ each)[..., 0, :]
        return following

    def advance_jacobians(self, z: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return self.advance_linearization(z, u)[1:]

    def advance_linearization(self, z: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """z⁺, ∂z⁺/∂z = Σ_i w_i A_i + Σ_i (A_i z + B_i u + c_i) (∂w_i/∂z)ᵀ and ∂z⁺/∂u = Σ_i w_i B_i in one pass."""
        if self.width == 0.0:
            return self._at_nearest(z, u)
        n, q = self.state_dim, self.points.shape[1]
        following, A, B = np.zeros_like(z), np.zeros((*z.shape, n)), np.zeros((*z.shape, self.input_dim))
        mean, mixed = np.zeros((*z.shape[:-1], q)), np.zeros((*z.shape, q))
        for weights, each, (points, of_state, of_input) in self._blocks(z, u):
            following += (weights[..., None, :] @ each)[..., 0, :]
            A += np.tensordot(weights, of_state, 1)
            B += np.tensordot(weights, of_input, 1)
            mean += weights @ points
            mixed += each.swapaxes(-1, -2) @ (weights[..., None] * points)
        A[..., :q] += 2.0 / self.width ** 2 * (mixed - following[..., None] * mean[..., None, :])
        return following, A, B

    def linearize_output(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        C, d = (np.broadcast_to(table, z.shape[:-1] + table.shape) for table in (self.C, self.d))
        return C, d

    def _distances(self, z: np.ndarray) -> np.ndarray:
        """‖q̃ − q̃_i‖² − ‖q̃‖², (..., N)."""
        return (self.points ** 2).sum(-1) - 2.0 * (z[..., :self.points.shape[1]] @ self.points.T)

    def _at_nearest(self, z: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        nearest = self._distances(z).argmin(-1)
        A, B = self.A[nearest], self.B[nearest]
        return (A @ z[..., None] + B @ u[..., None])[..., 0] + self.c[nearest], A, B

    def _blocks(self, z: np.ndarray, u: np.ndarray) -> Iterator[tuple]:
        """Of `BLOCK` points at a time, so that a cache holds their matrices: weights (..., k), A_i z + B_i u + c_i
        (..., k, n), and q̃_i, A_i, B_i; without points of no weight.
        """
        distances = self._distances(z)
        weights = np.exp((distances.min(-1, keepdims=True) - distances) / self.width ** 2)
        counting = np.flatnonzero((weights > NEGLIGIBLE).reshape(-1, len(self.points)).any(0))
        weights = weights / weights.sum(-1, keepdims=True)
        for first in range(0, len(counting), BLOCK):
            block = counting[first:first + BLOCK]
            A, B = self.A[block], self.B[block]
            yield weights[..., block], _applied(A, z) + _applied(B, u) + self.c[block], (self.points[block], A, B)


def _applied(matrices: np.ndarray, x: np.ndarray) -> np.ndarray:
    """(k, n, m), (..., m) → (..., k, n)"""
    return (x @ matrices.reshape(-1, matrices.shape[-1]).T).reshape(*x.shape[:-1], *matrices.shape[:2])
