"""Closed-form fit of a linear model, from which the gradient training of any other model starts."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor, nn

from ssmr_torch.data.windows import Segment
from ssmr_torch.fitting.polynomial_least_squares import PolynomialLeastSquares
from ssmr_torch.fitting.ssmr_least_squares import Regression
from ssmr_torch.fitting.streamed_least_squares import Solution
from ssmr_torch.models.monomials import graded
from ssmr_torch.models.structure import Structure
from ssmr_torch.models.torch_model import PolynomialTorchModel, TorchModel, table


class LinearModel(PolynomialTorchModel):
    """z = chart · [ŷ, û],   y = parametrization · z,   f = A z + B u, which is dz/dt for a flow, z⁺ for a map."""

    tables = {"chart": ("chart",), "parametrization": ("parametrization",), "dynamics": ("A", "B")}

    def __init__(self, state_dim: int, input_dim: int, output_dim: int, delays: int, *, flow: bool, timestep: float,
                 window_timestep: float | None = None):
        super().__init__(state_dim, input_dim, output_dim, delays, timestep, window_timestep)
        self.flow, seen = flow, self.window_dim + self.delays * self.input_dim
        self.structure = Structure(graded(seen, 1, 1), tuple(range(seen)), graded(state_dim, 1, 1),
                                   graded(state_dim + input_dim, 1, 1), "runge_kutta" if flow else "map")
        self.chart, self.parametrization = table(state_dim, seen), table(output_dim, state_dim)
        self.A, self.B = table(state_dim, state_dim), table(state_dim, input_dim)


class LinearStart(nn.Module):
    """Fits a `LinearModel` with as many states in closed form, and passes it to the method `begin` of the model.

    options: those of `PolynomialLeastSquares`. Raises ValueError for a model that has no method `begin`.
    """

    names = PolynomialLeastSquares.names

    def __init__(self, model: TorchModel, **options):
        super().__init__()
        if type(model).begin is TorchModel.begin:
            raise ValueError(f"{type(model).__name__} cannot start from a linear model, because it has no method "
                             "`begin(chart, parametrization, A, B)`; write that method, or choose another fit")
        # not a submodule: the fit that contains this procedure also contains the model, and saves it only once
        self.__dict__["model"] = model
        self.linear = PolynomialLeastSquares(
            LinearModel(model.state_dim, model.input_dim, model.output_dim, model.delays, flow=model.reduced.flow,
                        timestep=model.timestep, window_timestep=model.window_timestep), **options)
        self.stages, self.before, self.after = self.linear.stages, self.linear.before, self.linear.after

    @property
    def singular_values(self) -> Tensor:
        return self.linear.singular_values

    def sampled_every(self, timestep: float) -> None:
        """Set the data's sampling time, s; see `PolynomialLeastSquares`."""
        self.linear.sampled_every(timestep)

    def regressions(self, segment: Segment, stage: str) -> dict[str, Regression]:
        """The rows of the linear model's regressions."""
        return self.linear.regressions(segment, stage)

    @torch.no_grad()
    def assign(self, stage: str, solutions: Mapping[str, Solution]) -> None:
        """Pass the solutions to the linear model, and the linear model to the model that starts from it."""
        self.linear.assign(stage, solutions)
        found = self.linear.model
        self.model.begin(found.chart, found.parametrization, found.A, found.B)
