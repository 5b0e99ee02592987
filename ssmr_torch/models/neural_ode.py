"""Neural ordinary differential equation, affine in the input."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn
from torch.nn.functional import linear

from ssmr_torch.models.base import ContinuousTimeModel, OutputLinearization, fill
from ssmr_torch.models.integrators import rk4_step
from ssmr_torch.models.neural_tables import NeuralTables


class NeuralODE(ContinuousTimeModel):
    """dz/dt = f(z) + G(z) u with multilayer perceptrons beside a linear and bilinear part [Chen et al. 2018]:

        z = chart · ŷ,   y = parametrization · z,
        [f, G] = [linear z, control · [1, z]] + diag(state_scale) · network(z / state_scale)   (per s),

    `depth` hidden layers of `width` tanh units, the last layer zero at first, so that training starts from whatever
    linear model the other tables hold. The scale makes the network's inputs and outputs of order one. chart and
    parametrization are linear: of the windows' leading directions, or learned with the rest. Steps are of order four
    with a fixed size: the input jumps at each, where an adaptive method starts anew (dopri5 of torchdiffeq takes twice
    the evaluations for the same error, 4e-4 mm in 1 s on the trunk).
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

    def _operators(self) -> tuple[Tensor, Tensor, Tensor]:
        """W_1 diag(state_scale)⁻¹, and table (n (1 + m), n + w), constant (n (1 + m),) of [f, G] = table · [z, h_L] +
        constant.
        """
        n, m = self.state_dim, self.input_dim
        affine = self.control.unflatten(-1, (1 + n, m)).transpose(1, 2)
        linear = torch.cat([self.linear[:, None], affine[..., 1:]], dim=1)
        constant = torch.cat([torch.zeros_like(affine[:, :1, 0]), affine[..., 0]], dim=1)
        network = self.last.unflatten(0, (n, 1 + m)) * self.state_scale[:, None, None]
        return (self.first_weight / self.state_scale, torch.cat([linear, network], dim=-1).flatten(0, 1),
                constant.flatten())

    def _layers(self, z: Tensor, first: Tensor) -> list[Tensor]:
        layers = [torch.tanh(linear(z, first, self.biases[0]))]
        for weight, bias in zip(self.hidden_weight, self.biases[1:]):
            layers.append(torch.tanh(linear(layers[-1], weight, bias)))
        return layers

    def _affine(self, z: Tensor, operators: tuple[Tensor, Tensor, Tensor]) -> Tensor:
        """[f, G], (..., n, 1 + m)."""
        first, table, constant = operators
        values = linear(torch.cat([z, self._layers(z, first)[-1]], dim=-1), table, constant)
        return values.unflatten(-1, (self.state_dim, 1 + self.input_dim))

    def drift(self, z: Tensor) -> Tensor:
        return self._affine(z, self._operators())[..., 0]

    def control_field(self, z: Tensor) -> Tensor:
        return self._affine(z, self._operators())[..., 1:]

    def rate(self, z: Tensor, u: Tensor) -> Tensor:
        return self._rate(z, _with_one(u), self._operators())

    def _rate(self, z: Tensor, weights: Tensor, operators: tuple[Tensor, Tensor, Tensor]) -> Tensor:
        return (self._affine(z, operators) @ weights)[..., 0]

    def step(self, z: Tensor, u: Tensor) -> Tensor:
        # put together once for all stages of the step
        weights, operators = _with_one(u), self._operators()
        return rk4_step(lambda x: self._rate(x, weights, operators), z, self.timestep, self.substeps)

    def rate_jacobian(self, z: Tensor, u: Tensor) -> Tensor:
        first, table, _ = self._operators()
        layers = self._layers(z, first)
        J = (1 - layers[0] ** 2)[..., None] * first
        for layer, weight in zip(layers[1:], self.hidden_weight):
            J = (1 - layer**2)[..., None] * (weight @ J)
        table = table.unflatten(0, (self.state_dim, 1 + self.input_dim)).transpose(1, 2)
        held = (table @ _with_one(u)[..., None, :, :])[..., 0]
        return held[..., :self.state_dim] + held[..., self.state_dim:] @ J

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


def _with_one(u: Tensor) -> Tensor:
    """[1, u] as a column, (..., m) → (..., 1 + m, 1)."""
    return torch.cat([torch.ones_like(u[..., :1]), u], dim=-1)[..., None]
