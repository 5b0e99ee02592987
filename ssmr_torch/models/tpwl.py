"""Trajectory piecewise linear models: linearizations of a robot's own equations, switched or blended by distance."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from ssmr_torch.models.base import DiscreteTimeModel, OutputLinearization, fill
from ssmr_torch.models.integrators import whole_multiple
from ssmr_torch.models.kalman import Noise, filter_window
from ssmr_torch.models.tpwl_tables import TPWLTables


class TPWL(DiscreteTimeModel):
    """Trajectory piecewise linear model of a finite-element robot [Rewieński and White 2003; Tonkens et al. 2021]:

        z = [q̃, ṽ],   z⁺ = Σ_i w_i(q̃) (A_i z + B_i u + c_i),   y = C z + d,

    q̃ and ṽ the coordinates of the displacements and velocities of all nodes in one basis of `modes` vectors, (A_i, B_i,
    c_i) a step linearized at one of `points` states. width 0 takes the nearest point; another, m, blends them,

        w_i = exp(−‖q̃ − q̃_i‖² / width²) / Σ_j exp(−‖q̃ − q̃_j‖² / width²).

    Only q̃ chooses: given the positions, a step is linear in velocities and inputs. The chart is an extended Kalman
    filter that runs through the window, `Noise` its assumptions.
    state_dim = 2 modes. A fit sets modes, points and width. Raises ValueError for sizes that cannot be, or a
    window_timestep that is no multiple of base_timestep.
    """

    def __init__(self, input_dim: int, output_dim: int, delays: int = 10, *, modes: int = 1, points: int = 1,
                 width: float = 0.0, timestep: float = 0.01, window_timestep: float | None = None,
                 base_timestep: float | None = None):
        if modes < 1 or points < 1 or not 0 <= width < float("inf"):
            raise ValueError(f"{modes} modes, {points} points and a width of {width} m; expected 1 or more of each, "
                             "and a width of 0 (nearest point) or more")
        super().__init__(2 * modes, input_dim, output_dim, delays, timestep,
                         timestep if window_timestep is None else window_timestep, base_timestep)
        self._window_steps = whole_multiple(self.window_timestep, self.base_timestep)
        self.register_buffer("d", torch.zeros(self.output_dim, dtype=torch.float64))
        self.register_buffer("measurement", torch.eye(self.output_dim, dtype=torch.float64))
        self.resize(modes, points, width)

    def resize(self, modes: int, points: int, width: float) -> None:
        """Make room for another basis and other points; the tables start at zero."""
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
        return {name: getattr(self, name) for name in (
            "input_dim", "output_dim", "delays", "modes", "width", "timestep", "window_timestep",
            "base_timestep")} | {"points": self.count}

    def encode(self, window: Tensor, inputs: Tensor) -> Tensor:
        noise = Noise(self.mean, self.covariance, self.process, self.measurement)
        return filter_window(self, window, inputs, noise, self._window_steps, torch.linalg.solve)

    def decode(self, z: Tensor) -> Tensor:
        return z @ self.C.T + self.d

    def advance(self, z: Tensor, u: Tensor) -> Tensor:
        A, B, c = self._maps(z)
        return (A @ z[..., None] + B @ u[..., None])[..., 0] + c

    def advance_jacobians(self, z: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
        A, B, c = self._maps(z)
        if self.width == 0.0:
            return A, B
        weights = self._weights(z)
        following = (A @ z[..., None] + B @ u[..., None])[..., 0] + c
        each = torch.einsum("kij,...j->...ki", self.A, z) + torch.einsum("kim,...m->...ki", self.B, u) + self.c
        mixed = each.swapaxes(-1, -2) @ (weights[..., None] * self.points)
        slope = mixed - following[..., None] * (weights @ self.points)[..., None, :]
        return A + torch.cat([2.0 / self.width ** 2 * slope, torch.zeros_like(slope)], dim=-1), B

    def linearize_output(self, z: Tensor) -> OutputLinearization:
        return OutputLinearization(self.C.expand(*z.shape[:-1], -1, -1), self.d.expand(*z.shape[:-1], -1))

    def _distances(self, z: Tensor) -> Tensor:
        """‖q̃ − q̃_i‖² − ‖q̃‖², (..., N)."""
        return self.points.square().sum(-1) - 2.0 * (z[..., :self.modes] @ self.points.T)

    def _weights(self, z: Tensor) -> Tensor:
        return torch.softmax(-self._distances(z) / self.width ** 2, dim=-1)

    def _maps(self, z: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Σ_i w_i A_i (..., n, n), Σ_i w_i B_i (..., n, m), Σ_i w_i c_i (..., n)."""
        if self.width == 0.0:
            nearest = self._distances(z).argmin(-1, keepdim=True)  # under vmap, an index must not be a scalar
            return tuple(table[nearest].squeeze(z.dim() - 1) for table in (self.A, self.B, self.c))
        weights = self._weights(z)
        return tuple(torch.tensordot(weights, table, 1) for table in (self.A, self.B, self.c))

    def tables(self) -> TPWLTables:
        arrays = {name: getattr(self, name).detach().cpu().numpy() for name in TPWLTables.array_names()}
        return TPWLTables(**arrays, **{name: getattr(self, name) for name in TPWLTables.scalar_names()})

    @classmethod
    def from_tables(cls, tables: TPWLTables) -> TPWL:
        model = cls(**{name: getattr(tables, name) for name in tables.scalar_names()},
                    modes=tables.points.shape[1], points=len(tables.points))
        fill([(getattr(model, name), getattr(tables, name)) for name in tables.array_names()])
        return model
