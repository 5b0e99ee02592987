"""A trajectory piecewise linear model as plain arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ssmr_torch.models.integrators import whole_multiple
from ssmr_torch.models.kalman import Noise, filter_window
from ssmr_torch.models.tables import DiscreteTimeTables


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
        A, B, c = self._maps(z)
        return (A @ z[..., None] + B @ u[..., None])[..., 0] + c

    def advance_jacobians(self, z: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        A, B, c = self._maps(z)
        if self.width == 0.0:
            return A, B
        weights, size = self._weights(z), self.points.shape[1]
        following = (A @ z[..., None] + B @ u[..., None])[..., 0] + c
        each = np.einsum("kij,...j->...ki", self.A, z) + np.einsum("kim,...m->...ki", self.B, u) + self.c
        mixed = each.swapaxes(-1, -2) @ (weights[..., None] * self.points)
        slope = mixed - following[..., None] * (weights @ self.points)[..., None, :]
        return A + np.concatenate([2.0 / self.width ** 2 * slope, np.zeros(A.shape[:-1] + (size,))], axis=-1), B

    def linearize_output(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        C, d = (np.broadcast_to(table, z.shape[:-1] + table.shape) for table in (self.C, self.d))
        return C, d

    def _distances(self, z: np.ndarray) -> np.ndarray:
        """‖q̃ − q̃_i‖² − ‖q̃‖², (..., N)."""
        return (self.points ** 2).sum(-1) - 2.0 * (z[..., :self.points.shape[1]] @ self.points.T)

    def _weights(self, z: np.ndarray) -> np.ndarray:
        distances = self._distances(z)
        weights = np.exp((distances.min(-1, keepdims=True) - distances) / self.width ** 2)
        return weights / weights.sum(-1, keepdims=True)

    def _maps(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Σ_i w_i A_i (..., n, n), Σ_i w_i B_i (..., n, m), Σ_i w_i c_i (..., n)."""
        if self.width == 0.0:
            nearest = self._distances(z).argmin(-1)
            return self.A[nearest], self.B[nearest], self.c[nearest]
        weights = self._weights(z)
        return tuple(np.tensordot(weights, table, 1) for table in (self.A, self.B, self.c))
