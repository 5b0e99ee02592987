"""A control-affine neural ODE as plain arrays."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

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

    @cached_property
    def operators(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """W_1 diag(state_scale)⁻¹, and table (n, 1 + m, n + w), constant (n, 1 + m) of [f, G] = table · [z, h_L] +
        constant.
        """
        n, m = self.state_dim, self.input_dim
        affine = self.control.reshape(n, 1 + n, m).swapaxes(1, 2)
        linear = np.concatenate([self.linear[:, None], affine[..., 1:]], axis=1)
        constant = np.concatenate([np.zeros((n, 1)), affine[..., 0]], axis=1)
        network = self.last.reshape(n, 1 + m, -1) * self.state_scale[:, None, None]
        return self.first_weight / self.state_scale, np.concatenate([linear, network], axis=-1), constant

    def _layers(self, z: np.ndarray) -> list[np.ndarray]:
        layers = [np.tanh(z @ self.operators[0].T + self.biases[0])]
        for weight, bias in zip(self.hidden_weight, self.biases[1:]):
            layers.append(np.tanh(layers[-1] @ weight.T + bias))
        return layers

    def _affine(self, z: np.ndarray) -> np.ndarray:
        """[f, G], (..., n, 1 + m)."""
        _, table, constant = self.operators
        features = np.concatenate([z, self._layers(z)[-1]], axis=-1)
        return (features @ table.reshape(constant.size, -1).T).reshape(*z.shape[:-1], *constant.shape) + constant

    def _rate(self, z: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """dz/dt (..., n) with weights [1, u] (..., 1 + m, 1)."""
        return (self._affine(z) @ weights)[..., 0]

    def _jacobians(self, z: np.ndarray, held: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """∂(dz/dt)/∂z (..., n, n) and G (..., n, m); held (..., n, n + w): the table weighted by [1, u]."""
        layers = self._layers(z)
        J = (1 - layers[0] ** 2)[..., None] * self.operators[0]
        for layer, weight in zip(layers[1:], self.hidden_weight):
            J = (1 - layer**2)[..., None] * (weight @ J)
        n = self.state_dim
        return held[..., :n] + held[..., n:] @ J, self._affine(z)[..., 1:]

    def step(self, z: np.ndarray, u: np.ndarray) -> np.ndarray:
        weights = _with_one(u)
        return rk4_step(lambda x: self._rate(x, weights), z, self.timestep, self.substeps)

    def linearize(self, z: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        weights = _with_one(u)
        held = (self.operators[1].swapaxes(1, 2) @ weights[..., None, :, :])[..., 0]
        following, A, B = rk4_linearization(lambda x: self._rate(x, weights), lambda x: self._jacobians(x, held), z,
                                            np.eye(self.state_dim), self.timestep, self.substeps)
        return A, B, following - (A @ z[..., None])[..., 0] - (B @ u[..., None])[..., 0]

    def linearize_output(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        C = np.broadcast_to(self.parametrization, z.shape[:-1] + self.parametrization.shape)
        return C, np.zeros(z.shape[:-1] + (self.output_dim,))


def _with_one(u: np.ndarray) -> np.ndarray:
    """[1, u] as a column, (..., m) → (..., 1 + m, 1)."""
    return np.concatenate([np.ones_like(u[..., :1]), u], axis=-1)[..., None]
