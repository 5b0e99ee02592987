"""Control-augmented spectral submanifold: reduced dynamics in the joint space of state and input."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from ssmr_torch.models.base import DiscreteTimeModel, OutputLinearization, fill
from ssmr_torch.models.control_augmented_tables import ControlAugmentedTables, joint_monomials
from ssmr_torch.models.monomial_features import MonomialFeatures
from ssmr_torch.models.monomials import Monomials, count_monomials
from ssmr_torch.models.saturation import saturated


class ControlAugmentedSSMR(DiscreteTimeModel):
    """Dynamics on the spectral submanifold of the robot with its input as a further state, held over a step:

        z = v(ŷ, û) = chart · [ŷ, û],   y = w(z) = parametrization · z^{1:n_w},
        z⁺ = z + h · dynamics · (z, u)^{1:n_r},   u⁺ = u,

    with the window ŷ and the inputs û held between its samples, flattened oldest first, h = base_timestep, and the
    monomials of z and u together of a degree up to n_u in u (default: n_r). The manifold then bends with the input,
    so that nothing is left to calibrate [Wolff et al., Learning actuator-aware spectral submanifolds for precise
    control of continuum robots, 2026]; a chart that sees the inputs takes their direct effect out of the window.

    state_degree: largest degree in z (default: n_r); 1 makes the linear counterpart, bilinear in state and input.
    saturated: beyond the largest training states, `state_scale`, the nonlinear terms stay what they are there, see
    `saturation`; within them nothing changes.
    Raises ValueError when window and inputs hold fewer values than state_dim.
    """

    def __init__(self, state_dim: int, input_dim: int, output_dim: int, delays: int = 1, *,
                 parametrization_degree: int = 1, dynamics_degree: int = 2, input_degree: int | None = None,
                 state_degree: int | None = None, saturated: bool = False, timestep: float = 0.01,
                 window_timestep: float | None = None, base_timestep: float | None = None):
        super().__init__(state_dim, input_dim, output_dim, delays, timestep,
                         timestep if window_timestep is None else window_timestep, base_timestep)
        seen = self.window_dim + self.delays * self.input_dim
        if seen < state_dim:
            raise ValueError(f"a window of {delays + 1} samples of {output_dim} outputs and the inputs between them "
                             f"hold {seen} values, fewer than the {state_dim} reduced coordinates; use more delays or "
                             "a smaller state_dim")
        input_degree = dynamics_degree if input_degree is None else input_degree
        for name, degree in (("parametrization_degree", parametrization_degree), ("dynamics_degree", dynamics_degree),
                             ("input_degree", input_degree), ("state_degree", state_degree or dynamics_degree)):
            if degree < 1:
                raise ValueError(f"{name} is {degree}; expected 1 or more")
        self.parametrization_degree, self.dynamics_degree = parametrization_degree, dynamics_degree
        self.input_degree, self.state_degree, self.saturated = input_degree, state_degree, bool(saturated)
        n, m = self.state_dim, self.input_dim
        self.parametrization_features = MonomialFeatures(Monomials(n, 1, parametrization_degree))
        self.dynamics_features = MonomialFeatures(joint_monomials(n, m, dynamics_degree, input_degree, state_degree))

        def table(rows: int, columns: int) -> nn.Parameter:
            return nn.Parameter(torch.zeros(rows, columns, dtype=torch.float64))

        self.chart = table(n, seen)
        self.parametrization = table(self.output_dim, count_monomials(n, 1, parametrization_degree))
        self.dynamics_table = table(n, len(self.dynamics_features))

    @property
    def arguments(self) -> dict:
        return {name: getattr(self, name) for name in (
            "state_dim", "input_dim", "output_dim", "delays", "parametrization_degree", "dynamics_degree",
            "input_degree", "state_degree", "saturated", "timestep", "window_timestep", "base_timestep")}

    def chart_regressors(self, window: Tensor, inputs: Tensor) -> Tensor:
        """[ŷ, û], (..., (n_d + 1) p + n_d m), such that encode = chart · regressors."""
        return torch.cat([window.flatten(-2), inputs.flatten(-2)], dim=-1)

    def encode(self, window: Tensor, inputs: Tensor) -> Tensor:
        return self.chart_regressors(window, inputs) @ self.chart.T

    def decode(self, z: Tensor) -> Tensor:
        return self.parametrization_features(z) @ self.parametrization.T

    def joint(self, z: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
        """(s(z), u) and the slopes of s."""
        within, slopes = saturated(z, self.edge, torch.tanh)
        return torch.cat([within, u], dim=-1), slopes

    @property
    def edge(self) -> Tensor:
        """Of the range within which nothing saturates, (n,)."""
        limited = (self.state_scale > 0) & self.saturated
        return torch.where(limited, self.state_scale, torch.inf)

    def dynamics_regressors(self, z: Tensor, u: Tensor) -> Tensor:
        """[z, u, (s(z), u)^{2:n_r}], (..., q), such that advance = z + h · dynamics · regressors."""
        nonlinear = self.dynamics_features(self.joint(z, u)[0])[..., self.state_dim:]
        return torch.cat([z, nonlinear], dim=-1)

    def advance(self, z: Tensor, u: Tensor) -> Tensor:
        return z + self.base_timestep * (self.dynamics_regressors(z, u) @ self.dynamics_table.T)

    def advance_jacobians(self, z: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
        n, (joint, slopes) = self.state_dim, self.joint(z, u)
        jacobian = self.dynamics_table @ self.dynamics_features.jacobian(joint)
        by_state, linear = slopes[..., None, :] * jacobian[..., :n], self.dynamics_table[:, :n]
        identity = torch.eye(n, dtype=z.dtype, device=z.device)
        A = identity + self.base_timestep * (by_state + (1.0 - slopes)[..., None, :] * linear)
        return A, self.base_timestep * jacobian[..., n:]

    def linearize_output(self, z: Tensor) -> OutputLinearization:
        C = self.parametrization @ self.parametrization_features.jacobian(z)
        return OutputLinearization(C, self.decode(z) - (C @ z[..., None])[..., 0])

    def tables(self) -> ControlAugmentedTables:
        arrays = {"chart": self.chart, "parametrization": self.parametrization, "dynamics": self.dynamics_table,
                  "state_scale": self.state_scale}
        return ControlAugmentedTables(**{name: value.detach().cpu().numpy() for name, value in arrays.items()},
                                      **{name: getattr(self, name) for name in ControlAugmentedTables.scalar_names()})

    @classmethod
    def from_tables(cls, tables: ControlAugmentedTables) -> ControlAugmentedSSMR:
        model = cls(tables.state_dim, **{name: getattr(tables, name) for name in tables.scalar_names()})
        fill(((model.chart, tables.chart), (model.parametrization, tables.parametrization),
              (model.dynamics_table, tables.dynamics), (model.state_scale, tables.state_scale)))
        return model
