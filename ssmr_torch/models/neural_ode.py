"""Neural ordinary differential equation, affine in the input, as a Torch module for training."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

from ssmr_torch.checked_arguments import checked
from ssmr_torch.models.neural import NeuralModel
from ssmr_torch.models.torch_model import TorchModel, check_degrees
from ssmr_torch.quantities import DELAYS, MODEL_TIMESTEP, STATES, SUBSTEPS, TIMESTEP
from ssmr_torch.ranges import OrNone, Whole


class NeuralODE(TorchModel):
    """dz/dt = f(z) + G(z) u as a multilayer perceptron plus a linear and a bilinear part [Chen et al. 2018]:

        z = chart · ŷ,   y = parametrization · z,
        [f, G] = [linear z, control · [1, z]] + diag(state_scale) · network(z / state_scale)   (per s),

    The network has `depth` hidden layers of `width` tanh units. Its last layer is zero at first, so that training
    starts from the linear model in the other tables; see `NeuralModel`. The scale makes the network's inputs and
    outputs of order one. chart and parametrization are linear: the leading principal directions of the windows, or
    learned with the rest. Steps are Runge-Kutta steps of order four and of fixed size. The input jumps at every step,
    so that an adaptive method would have to restart there (dopri5 of torchdiffeq takes twice the evaluations for the
    same error, 4e-4 mm in 1 s on the trunk).
    Raises ValueError for fewer window values than state_dim, or a width or depth below 1.
    """

    @checked(state_dim=STATES, delays=DELAYS, timestep=MODEL_TIMESTEP, window_timestep=OrNone(TIMESTEP),
             width=Whole(1, 4096), depth=Whole(1, 50), substeps=SUBSTEPS)
    def __init__(self, state_dim: int, input_dim: int, output_dim: int, delays: int = 1, *, width: int = 64,
                 depth: int = 1, timestep: float = 0.01, window_timestep: float | None = None, substeps: int = 1):
        super().__init__(state_dim, input_dim, output_dim, delays, timestep, window_timestep)
        if self.window_dim < state_dim:
            raise ValueError(f"a window of {delays + 1} samples of {output_dim} outputs holds {self.window_dim} "
                             f"values, fewer than the {state_dim} reduced coordinates; use more delays or a smaller "
                             "state_dim")
        check_degrees(width=width, depth=depth, substeps=substeps)
        self.width, self.depth, self.substeps = int(width), int(depth), int(substeps)
        n, m, width, depth = self.state_dim, self.input_dim, self.width, self.depth

        def random_table(*shape: int, spread: float = 0.0) -> nn.Parameter:
            return nn.Parameter(spread * torch.randn(shape, dtype=torch.float64))

        self.chart, self.parametrization = random_table(n, self.window_dim), random_table(self.output_dim, n)
        self.linear, self.control = random_table(n, n), random_table(n, m * (1 + n))
        self.first_weight = random_table(width, n, spread=1 / math.sqrt(n))
        self.hidden_weight = random_table(depth - 1, width, width, spread=1 / math.sqrt(width))
        self.biases, self.last = random_table(depth, width, spread=0.1), random_table(n * (1 + m), width)

    @torch.no_grad()
    def scales(self) -> dict[str, Tensor]:
        """Step sizes of the coefficients, see `TorchModel.scales`.

        A step of relative size ε in all coefficients of a row changes a coordinate or an output by ε times its largest
        value. In one coefficient of a rate it changes the rate by ε times the coordinate's largest value per s, which
        is also its effect in the network.
        """
        state = self.state_scale.clamp_min(1e-300)
        output = self.parametrization.abs() @ state
        output = torch.maximum(output, 1e-3 * output.max()).clamp_min(1e-300)
        with_constant = torch.cat([state.new_ones(1), state]).repeat_interleave(self.input_dim)
        return {"chart": state[:, None] / output.repeat(self.delays + 1) / self.window_dim,
                "parametrization": output[:, None] / state / self.state_dim,
                "linear": state[:, None] / state, "control": state[:, None] / with_constant}

    @property
    def reduced(self) -> NeuralModel:
        tables = {name: getattr(self, name) for name in NeuralModel.array_names()}
        return NeuralModel(**(self.sizes | tables), substeps=self.substeps)
