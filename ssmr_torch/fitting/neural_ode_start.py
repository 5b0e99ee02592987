"""Closed-form fit of the linear and bilinear part of a neural ODE, from which its training starts."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import nn

from ssmr_torch.data.windows import Segment
from ssmr_torch.fitting.ssmr_least_squares import Regression, SSMRLeastSquares
from ssmr_torch.fitting.streamed_least_squares import Solution
from ssmr_torch.models.neural_ode import NeuralODE
from ssmr_torch.models.ssmr import SSSR


class NeuralODEStart(nn.Module):
    """Fits coordinates, linear drift and bilinear control field of a `NeuralODE` by the closed-form fit of SSSR.

    The network does not change. If its last layer is zero, the model is then equal to SSSR. options: those of
    `SSMRLeastSquares`.
    """

    names = SSMRLeastSquares.names

    def __init__(self, model: NeuralODE, **options):
        super().__init__()
        # not a submodule: the fit that contains this procedure also contains the model, and saves it only once
        self.__dict__["model"] = model
        linear = SSSR(model.state_dim, model.input_dim, model.output_dim, model.delays, timestep=model.timestep,
                      window_timestep=model.window_timestep)
        self.sssr = SSMRLeastSquares(linear, **options)
        self.stages, self.before, self.after = self.sssr.stages, self.sssr.before, self.sssr.after

    @property
    def singular_values(self) -> torch.Tensor:
        return self.sssr.singular_values

    def regressions(self, segment: Segment, stage: str) -> dict[str, Regression]:
        """The rows of SSSR's regressions."""
        return self.sssr.regressions(segment, stage)

    @torch.no_grad()
    def assign(self, stage: str, solutions: Mapping[str, Solution]) -> None:
        """Write the solutions of SSSR into the model."""
        self.sssr.assign(stage, solutions)
        found, model = self.sssr.model, self.model
        model.chart.copy_(found.chart)
        model.parametrization.copy_(found.parametrization[-model.output_dim:])
        model.linear.copy_(found.drift_table)
        model.control.copy_(found.control_table)
