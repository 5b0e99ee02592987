"""Neural ODE as a reduced model without Torch: a network plus a linear and a bilinear part, affine in the input."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

from ssmr_torch.models.arrays import Array, identity, namespace
from ssmr_torch.models.base import Linearization, Model, OutputLinearization, around
from ssmr_torch.models.integrators import rk4_linearization, rk4_step
from ssmr_torch.models.sizes import check_steps


@dataclass(frozen=True, eq=False, kw_only=True)
class NeuralModel(Model):
    """z = chart · window,   y = parametrization · z,   dz/dt = f(z) + G(z) u with

        [f, G] = [linear z, control · [1, z]] + diag(state_scale) · network(z / state_scale)   (per s),
        network(x) = last · h_L,   h_l = tanh(W_l h_{l-1} + b_l),   h_0 = x.

    chart (n, (n_d + 1) p), parametrization (p, n), linear (n, n), control (n, m (1 + n)), first_weight (w, n),
    hidden_weight (L - 1, w, w), biases (L, w), last (n (1 + m), w): float64, SI; `last` holds f before G, row by row.
    substeps: Runge-Kutta steps within a timestep.
    """

    c_source: ClassVar[str] = "ssmr_torch.deployment.c.neural:neural"

    chart: Array
    parametrization: Array
    linear: Array
    control: Array
    first_weight: Array
    hidden_weight: Array
    biases: Array
    last: Array
    substeps: int = 1

    def __post_init__(self):
        super().__post_init__()
        check_steps("substeps", self.substeps)

    @property
    def kind(self) -> str:
        return "neural ODE"

    @property
    def flow(self) -> bool:
        return True

    @property
    def takes_past_inputs(self) -> bool:
        return False

    def encode(self, window: Array, inputs: Array | None = None) -> Array:
        return window.reshape(*window.shape[:-2], -1) @ self.chart.T

    def decode(self, z: Array) -> Array:
        return z @ self.parametrization.T

    @cached_property
    def operators(self) -> tuple[Array, Array, Array]:
        """W_1 diag(state_scale)⁻¹, and table (n, 1 + m, n + w), constant (n, 1 + m) of [f, G] = table · [z, h_L] +
        constant.
        """
        xp, n, m = namespace(self.linear), self.state_dim, self.input_dim
        affine = self.control.reshape(n, 1 + n, m).swapaxes(1, 2)
        linear = xp.concatenate([self.linear[:, None], affine[..., 1:]], 1)
        constant = xp.concatenate([xp.zeros_like(affine[:, :1, 0]), affine[..., 0]], 1)
        network = self.last.reshape(n, 1 + m, -1) * self.state_scale[:, None, None]
        return self.first_weight / self.state_scale, xp.concatenate([linear, network], -1), constant

    def _layers(self, z: Array) -> list[Array]:
        xp = namespace(z)
        layers = [xp.tanh(z @ self.operators[0].T + self.biases[0])]
        for weight, bias in zip(self.hidden_weight, self.biases[1:]):
            layers.append(xp.tanh(layers[-1] @ weight.T + bias))
        return layers

    def _affine(self, z: Array) -> Array:
        """[f, G], (..., n, 1 + m)."""
        _, table, constant = self.operators
        features = namespace(z).concatenate([z, self._layers(z)[-1]], -1)
        values = features @ table.reshape(-1, table.shape[-1]).T
        return values.reshape(*z.shape[:-1], *constant.shape) + constant

    def rate(self, z: Array, u: Array) -> Array:
        """dz/dt, (..., n)."""
        return self._rate(z, _with_one(u))

    def _rate(self, z: Array, weights: Array) -> Array:
        """dz/dt for weights [1, u], (..., 1 + m, 1), which are constant while u is held."""
        return (self._affine(z) @ weights)[..., 0]

    def _jacobians(self, z: Array, held: Array) -> tuple[Array, Array]:
        """∂(dz/dt)/∂z (..., n, n) and G (..., n, m); held (..., n, n + w): the table weighted by [1, u]."""
        layers = self._layers(z)
        J = (1 - layers[0] ** 2)[..., None] * self.operators[0]
        for layer, weight in zip(layers[1:], self.hidden_weight):
            J = (1 - layer ** 2)[..., None] * (weight @ J)
        n = self.state_dim
        return held[..., :n] + held[..., n:] @ J, self._affine(z)[..., 1:]

    def step(self, z: Array, u: Array) -> Array:
        weights = _with_one(u)
        return rk4_step(lambda x: self._rate(x, weights), z, self.timestep, self.substeps)

    def step_jacobians(self, z: Array, u: Array) -> tuple[Array, Array, Array]:
        """`step`, ∂z⁺/∂z (..., n, n) and ∂z⁺/∂u (..., n, m)."""
        weights = _with_one(u)
        held = (self.operators[1].swapaxes(1, 2) @ weights[..., None, :, :])[..., 0]
        return rk4_linearization(lambda x: self._rate(x, weights), lambda x: self._jacobians(x, held), z,
                                 identity(z, self.state_dim), self.timestep, self.substeps)

    def linearize(self, z: Array, u: Array) -> Linearization:
        return around(*self.step_jacobians(z, u), z, u)

    def linearize_output(self, z: Array) -> OutputLinearization:
        xp = namespace(z)
        C = xp.broadcast_to(self.parametrization, (*z.shape[:-1], *self.parametrization.shape))
        return OutputLinearization(C, xp.zeros_like(z[..., :1]) + xp.zeros_like(self.parametrization[:, 0]))


def _with_one(u: Array) -> Array:
    """[1, u] as a column, (..., m) → (..., 1 + m, 1)."""
    xp = namespace(u)
    return xp.concatenate([xp.ones_like(u[..., :1]), u], -1)[..., None]
