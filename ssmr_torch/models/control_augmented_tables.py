"""A control-augmented SSM model as plain arrays."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ssmr_torch.models.monomials import Monomials
from ssmr_torch.models.saturation import saturated
from ssmr_torch.models.tables import DiscreteTimeTables


@dataclass(frozen=True, eq=False, kw_only=True)
class ControlAugmentedTables(DiscreteTimeTables):
    """z = chart · [window, inputs held within it],   y = parametrization · z^{1:n_w},
    z⁺ = z + base_timestep · dynamics · (z, u)^{1:n_r}, the monomials with degree ≤ n_u in u and ≤ state_degree in z;
    those beyond the linear ones of s(z) in place of z where `saturated`, see `saturation`.

    chart (n, (n_d + 1) p + n_d m), parametrization (p, ·), dynamics (n, ·): float64, SI.
    """

    chart: np.ndarray
    parametrization: np.ndarray
    dynamics: np.ndarray
    parametrization_degree: int
    dynamics_degree: int
    input_degree: int
    state_degree: int | None = None
    saturated: bool = False

    @property
    def affine(self) -> bool:
        return self.dynamics_degree == 1 and self.parametrization_degree == 1

    @cached_property
    def parametrization_monomials(self) -> Monomials:
        return Monomials(self.state_dim, 1, self.parametrization_degree)

    @cached_property
    def dynamics_monomials(self) -> Monomials:
        return joint_monomials(self.state_dim, self.input_dim, self.dynamics_degree, self.input_degree,
                               self.state_degree)

    def encode(self, window: np.ndarray, inputs: np.ndarray) -> np.ndarray:
        leading = window.shape[:-2]
        return np.concatenate([window.reshape(*leading, -1), inputs.reshape(*leading, -1)], axis=-1) @ self.chart.T

    def decode(self, z: np.ndarray) -> np.ndarray:
        return self.parametrization_monomials(z) @ self.parametrization.T

    @cached_property
    def edge(self) -> np.ndarray:
        """Of the range within which nothing saturates, (n,)."""
        return np.where((self.state_scale > 0) & self.saturated, self.state_scale, np.inf)

    def joint(self, z: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(s(z), u) and the slopes of s."""
        within, slopes = saturated(z, self.edge, np.tanh)
        return np.concatenate([within, u], axis=-1), slopes

    def advance(self, z: np.ndarray, u: np.ndarray) -> np.ndarray:
        regressors = self.dynamics_monomials(self.joint(z, u)[0])
        regressors[..., :self.state_dim] = z
        return z + self.base_timestep * (regressors @ self.dynamics.T)

    def advance_jacobians(self, z: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        n, (joint, slopes) = self.state_dim, self.joint(z, u)
        jacobian = self.base_timestep * (self.dynamics @ self.dynamics_monomials.jacobian(joint))
        linear = self.base_timestep * self.dynamics[:, :n]
        by_state = slopes[..., None, :] * jacobian[..., :n] + (1.0 - slopes)[..., None, :] * linear
        return np.eye(n) + by_state, jacobian[..., n:]

    def linearize_output(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        C = self.parametrization @ self.parametrization_monomials.jacobian(z)
        return C, self.decode(z) - (C @ z[..., None])[..., 0]


def joint_monomials(state_dim: int, input_dim: int, degree: int, input_degree: int,
                    state_degree: int | None = None) -> Monomials:
    """(z, u)^{1:degree}, z before u, without those of a degree above `input_degree` in u or `state_degree` in z."""
    everything = Monomials(state_dim + input_dim, 1, degree)
    in_state, in_input = everything.exponents[:, :state_dim].sum(1), everything.exponents[:, state_dim:].sum(1)
    return everything.selected((in_input <= input_degree) & (in_state <= (state_degree or degree)))
