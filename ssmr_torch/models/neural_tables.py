"""A control-affine neural ODE as plain arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ssmr_torch.models.integrators import rk4_linearization, rk4_step
from ssmr_torch.models.tables import ModelTables


@dataclass(frozen=True, eq=False, kw_only=True)
class NeuralTables(ModelTables):
    """z = chart · window,   y = parametrization · z,   dz/dt = f(z) + G(z) u with

        [f, G] = [linear z, control · [1, z]] + diag(state_scale) · network(z / state_scale)   (per s),
        network(x) = last · h_L,   h_l = tanh(W_l h_{l-1} + b_l),   h_0 = x.

    chart (n, (n_d + 1) p), parametrization (p, n), linear (n, n), control (n, m (1 + n)), first_weight (w, n),
    hidden_weight (L - 1, w, w), biases (L, w), last (n (1 + m), w): float64, SI; `last` holds f before G, row by row.
    """

    chart: np.ndarray
    parametrization: np.ndarray
    linear: np.ndarray
    control: np.ndarray
    first_weight: np.ndarray
    hidden_weight: np.ndarray
    biases: np.ndarray
    last: np.ndarray
    substeps: int

    def encode(self, window: np.ndarray, inputs: np.ndarray) -> np.ndarray:
        return window.reshape(*window.shape[:-2], -1) @ self.chart.T

    def decode(self, z: np.ndarray) -> np.ndarray:
        return z @ self.parametrization.T

    def _network(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Values (..., n, 1 + m) of f and G, and their Jacobian (..., n, 1 + m, n), both without the linear part."""
        x, shape = z / self.state_scale, (self.state_dim, 1 + self.input_dim)
        h = np.tanh(x @ self.first_weight.T + self.biases[0])
        J = (1 - h**2)[..., None] * (self.first_weight / self.state_scale)
        for weight, bias in zip(self.hidden_weight, self.biases[1:]):
            h = np.tanh(h @ weight.T + bias)
            J = (1 - h**2)[..., None] * (weight @ J)
        values = (h @ self.last.T).reshape(*z.shape[:-1], *shape) * self.state_scale[:, None]
        return values, (self.last @ J).reshape(*z.shape[:-1], *shape, -1) * self.state_scale[:, None, None]

    def _fields(self, z: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """dz/dt (..., n), its Jacobian (..., n, n), and G (..., n, m)."""
        values, jacobians = self._network(z)
        bilinear = self.control.reshape(self.state_dim, 1 + self.state_dim, self.input_dim)
        G = bilinear[:, 0] + np.einsum("...q,nqm->...nm", z, bilinear[:, 1:]) + values[..., 1:]
        rate = z @ self.linear.T + values[..., 0] + (G @ u[..., None])[..., 0]
        jacobian = (self.linear + jacobians[..., 0, :] + np.einsum("nqm,...m->...nq", bilinear[:, 1:], u)
                    + np.einsum("...njq,...j->...nq", jacobians[..., 1:, :], u))
        return rate, jacobian, G

    def step(self, z: np.ndarray, u: np.ndarray) -> np.ndarray:
        return rk4_step(lambda x: self._fields(x, u)[0], z, self.timestep, self.substeps)

    def linearize(self, z: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        following, A, B = rk4_linearization(lambda x: self._fields(x, u)[0], lambda x: self._fields(x, u)[1:], z,
                                            np.eye(self.state_dim), self.timestep, self.substeps)
        return A, B, following - (A @ z[..., None])[..., 0] - (B @ u[..., None])[..., 0]

    def linearize_output(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        C = np.broadcast_to(self.parametrization, z.shape[:-1] + self.parametrization.shape)
        return C, np.zeros(z.shape[:-1] + (self.output_dim,))
