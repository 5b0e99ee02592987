"""Trajectory piecewise linear (TPWL) models as Torch modules: linearizations of a robot's equations, blended."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from ssmr_torch.checked_arguments import checked
from ssmr_torch.models.piecewise_linear import PiecewiseLinearModel
from ssmr_torch.models.torch_model import TorchModel
from ssmr_torch.periods import whole_multiple
from ssmr_torch.quantities import DELAYS, MODEL_TIMESTEP, TIMESTEP
from ssmr_torch.ranges import OrNone


class TPWL(TorchModel):
    """Trajectory piecewise linear model of a finite-element robot [Rewieński and White 2003; Tonkens et al. 2021]:

        z = [q̃, ṽ],   z⁺ = Σ_i w_i(q̃) (A_i z + B_i u + c_i),   y = C z + d,

    q̃ and ṽ are the coordinates of the displacements and velocities of all nodes in one basis of `modes` vectors.
    (A_i, B_i, c_i) is a step linearized at one of `points` states. The weights w_i are those of `PiecewiseLinearModel`;
    for width 0 only the nearest point has weight. They depend on q̃ only, because for given positions a step is linear
    in velocities and inputs. The chart is an extended Kalman filter that runs through the window.
    state_dim = 2 modes. A fit sets modes, points and width. Raises ValueError for sizes below 1, a negative or infinite
    width, or a window_timestep that is not a multiple of base_timestep.
    """

    given = (*TorchModel.given, "modes", "points", "width")

    @checked(delays=DELAYS, timestep=MODEL_TIMESTEP, window_timestep=OrNone(TIMESTEP), base_timestep=OrNone(TIMESTEP))
    def __init__(self, input_dim: int, output_dim: int, delays: int = 10, *, modes: int = 1, points: int = 1,
                 width: float = 0.0, timestep: float = 0.01, window_timestep: float | None = None,
                 base_timestep: float | None = None):
        if modes < 1 or points < 1 or not 0 <= width < float("inf"):
            raise ValueError(f"{modes} modes, {points} points and a width of {width} m; expected 1 or more modes and "
                             "points, and a finite width of 0 (nearest point only) or more")
        super().__init__(2 * modes, input_dim, output_dim, delays, timestep, window_timestep)
        self.base_timestep = self.timestep if base_timestep is None else float(base_timestep)
        whole_multiple("the model's window_timestep", self.window_timestep, "its base_timestep", self.base_timestep)
        self.register_buffer("d", torch.zeros(self.output_dim, dtype=torch.float64))
        self.register_buffer("measurement", torch.eye(self.output_dim, dtype=torch.float64))
        self.resize(modes, points, width)
        _ = self.reduced  # raises an error if timestep is not a whole multiple of base_timestep

    def resize(self, modes: int, points: int, width: float) -> None:
        """Change the number of modes and points, and the width. All tables become zero."""
        self.modes, self.count, self.width, self.state_dim = int(modes), int(points), float(width), 2 * int(modes)
        n = self.state_dim

        def zeros(*shape: int) -> Tensor:
            return torch.zeros(shape, dtype=torch.float64, device=self.d.device)

        self.A, self.B, self.c = (nn.Parameter(zeros(points, *shape)) for shape in ((n, n), (n, self.input_dim), (n,)))
        for name, shape in (("points", (points, modes)), ("C", (self.output_dim, n)), ("mean", (n,)),
                            ("covariance", (n, n)), ("process", (n, n))):
            self.register_buffer(name, zeros(*shape))
        self.state_scale = zeros(n) + torch.inf

    @property
    def arguments(self) -> dict:
        return super().arguments | {"points": self.count}

    @property
    def reduced(self) -> PiecewiseLinearModel:
        tables = {name: getattr(self, name) for name in PiecewiseLinearModel.array_names()}
        return PiecewiseLinearModel(**(self.sizes | tables), width=self.width, base_timestep=self.base_timestep)
