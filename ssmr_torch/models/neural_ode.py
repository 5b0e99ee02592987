"""Neural ordinary differential equation, affine in the input."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

from ssmr_torch.models.base import ContinuousTimeModel, OutputLinearization, fill
from ssmr_torch.models.neural_tables import NeuralTables


class NeuralODE(ContinuousTimeModel):
    """dz/dt = f(z) + G(z) u with multilayer perceptrons beside a linear and bilinear part [Chen et al. 2018]:

        z = chart · ŷ,   y = parametrization · z,
        [f, G] = [linear z, control · [1, z]] + diag(state_scale) · network(z / state_scale)   (per s),

    `depth` hidden layers of `width` tanh units, the last layer zero at first, so that training starts from whatever
    linear model the other tables hold. Coordinates are the n leading directions of the windows; the scale makes the
    network's inputs and outputs of order one. Runge-Kutta steps of order four: these robots move slowly against the
    step, and adaptive ones (torchdiffeq) give the same to 1e-6 at more cost.
    Raises ValueError for fewer window values than state_dim, or a width or depth below 1.
    """

    def __init__(self, state_dim: int, input_dim: int, output_dim: int, delays: int = 1, *, width: int = 64,
                 depth: int = 2, timestep: float = 0.01, window_timestep: float | None = None, substeps: int = 1):
        super().__init__(state_dim, input_dim, output_dim, delays, timestep,
                         timestep if window_timestep is None else window_timestep, substeps)
        if self.window_dim < state_dim:
            raise ValueError(f"a window of {delays + 1} samples of {output_dim} outputs holds {self.window_dim} "
                             f"values, fewer than the {state_dim} reduced coordinates; use more delays or a smaller "
                             "state_dim")
        if width < 1 or depth < 1:
            raise ValueError(f"width {width} and depth {depth}; expected 1 or more of each")
        self.width, self.depth = int(width), int(depth)
        n, m = self.state_dim, self.input_dim

        def table(*shape: int, spread: float = 0.0) -> nn.Parameter:
            return nn.Parameter(spread * torch.randn(shape, dtype=torch.float64))

        self.chart, self.parametrization = table(n, self.window_dim), table(self.output_dim, n)
        self.linear, self.control = table(n, n), table(n, m * (1 + n))
        self.first_weight = table(width, n, spread=1 / math.sqrt(n))
        self.hidden_weight = table(depth - 1, width, width, spread=1 / math.sqrt(width))
        self.biases, self.last = table(depth, width, spread=0.1), table(n * (1 + m), width)

    @property
    def arguments(self) -> dict:
        return {name: getattr(self, name) for name in (
            "state_dim", "input_dim", "output_dim", "delays", "width", "depth", "timestep", "window_timestep",
            "substeps")}

    def encode(self, window: Tensor, inputs: Tensor | None = None) -> Tensor:
        return window.flatten(-2) @ self.chart.T

    def decode(self, z: Tensor) -> Tensor:
        return z @ self.parametrization.T

    def _layers(self, z: Tensor) -> list[Tensor]:
        layers = [torch.tanh(z / self.state_scale @ self.first_weight.T + self.biases[0])]
        for layer in range(self.depth - 1):
            layers.append(torch.tanh(layers[-1] @ self.hidden_weight[layer].T + self.biases[layer + 1]))
        return layers

    def _network(self, z: Tensor) -> Tensor:
        """f and G without their linear part, (..., n, 1 + m)."""
        values = self._layers(z)[-1] @ self.last.T
        return values.unflatten(-1, (self.state_dim, 1 + self.input_dim)) * self.state_scale[:, None]

    def _linear_control(self, z: Tensor) -> Tensor:
        table = self.control.unflatten(-1, (1 + self.state_dim, self.input_dim))
        return table[:, 0] + torch.einsum("...q,nqm->...nm", z, table[:, 1:])

    def drift(self, z: Tensor) -> Tensor:
        return z @ self.linear.T + self._network(z)[..., 0]

    def control_field(self, z: Tensor) -> Tensor:
        return self._linear_control(z) + self._network(z)[..., 1:]

    def rate(self, z: Tensor, u: Tensor) -> Tensor:
        values = self._network(z)
        field = self._linear_control(z) + values[..., 1:]
        return z @ self.linear.T + values[..., 0] + (field @ u[..., None])[..., 0]

    def rate_jacobian(self, z: Tensor, u: Tensor) -> Tensor:
        layers = self._layers(z)
        J = (1 - layers[0] ** 2)[..., None] * (self.first_weight / self.state_scale)
        for layer in range(1, self.depth):
            J = (1 - layers[layer] ** 2)[..., None] * (self.hidden_weight[layer - 1] @ J)
        J = (self.last @ J).unflatten(-2, (self.state_dim, 1 + self.input_dim)) * self.state_scale[:, None, None]
        table = self.control.unflatten(-1, (1 + self.state_dim, self.input_dim))[:, 1:]
        return (self.linear + J[..., 0, :] + torch.einsum("nqm,...m->...nq", table, u)
                + torch.einsum("...njq,...j->...nq", J[..., 1:, :], u))

    def linearize_output(self, z: Tensor) -> OutputLinearization:
        C = self.parametrization.expand(*z.shape[:-1], -1, -1)
        return OutputLinearization(C, z.new_zeros(*z.shape[:-1], self.output_dim))

    def tables(self) -> NeuralTables:
        arrays = {name: getattr(self, name).detach().cpu().numpy() for name in NeuralTables.array_names()}
        return NeuralTables(**arrays, **{name: getattr(self, name) for name in NeuralTables.scalar_names()})

    @classmethod
    def from_tables(cls, tables: NeuralTables) -> NeuralODE:
        scalars = {name: getattr(tables, name) for name in tables.scalar_names()}
        model = cls(tables.state_dim, width=len(tables.first_weight), depth=len(tables.biases), **scalars)
        fill([(getattr(model, name), getattr(tables, name)) for name in tables.array_names()])
        return model
