"""A polynomial reduced model as plain arrays: what a controller runs, without Torch."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ssmr_torch.models.integrators import rk4_linearization, rk4_step
from ssmr_torch.models.monomials import Monomials
from ssmr_torch.models.tables import ModelTables


@dataclass(frozen=True, eq=False, kw_only=True)
class PolynomialTables(ModelTables):
    """z = chart · window^{1:n_v},   window = parametrization · z^{1:n_w},
    dz/dt = drift · z^{1:n_r} + control · [u, z^{1:n_u} ⊗ u].

    chart (n, ·), parametrization ((n_d + 1) p, ·), drift (n, ·), control (n, m (1 + ·)), state_scale (n,): float64, SI.
    A window is (..., n_d + 1, p), oldest sample first, `window_timestep` s apart; `timestep` is that of `step`.
    """

    chart: np.ndarray
    parametrization: np.ndarray
    drift: np.ndarray
    control: np.ndarray
    chart_degree: int
    parametrization_degree: int
    dynamics_degree: int
    control_degree: int
    substeps: int

    @property
    def affine(self) -> bool:
        return self.dynamics_degree == 1 and self.control_degree == 0 and self.parametrization_degree == 1

    @property
    def geometry(self) -> str:
        p, n = len(self.parametrization), self.state_dim
        if p == n:
            shape = f"p = n = {n}: the parametrization is linear, all nonlinearity sits in the dynamics"
        elif self.parametrization_degree == 1:
            shape = f"p = {p} > n = {n}, parametrization of degree 1: a flat manifold"
        else:
            shape = f"p = {p} > n = {n}, parametrization of degree {self.parametrization_degree}: a curved manifold"
        return f"{super().geometry}; {shape}"

    @cached_property
    def chart_monomials(self) -> Monomials:
        return Monomials(self.parametrization.shape[0], 1, self.chart_degree)

    @cached_property
    def parametrization_monomials(self) -> Monomials:
        return Monomials(self.state_dim, 1, self.parametrization_degree)

    @cached_property
    def drift_monomials(self) -> Monomials:
        return Monomials(self.state_dim, 1, self.dynamics_degree)

    @cached_property
    def control_monomials(self) -> Monomials:
        return Monomials(self.state_dim, 1, self.control_degree)

    @cached_property
    def _control_by_monomial(self) -> np.ndarray:
        """(n, 1 + q, m): slice 0 is B, the others multiply z^{1:n_u}."""
        return self.control.reshape(self.state_dim, -1, self.input_dim)

    @cached_property
    def _newest(self) -> np.ndarray:
        return self.parametrization[-self.output_dim:]

    def encode(self, window: np.ndarray, inputs: np.ndarray) -> np.ndarray:
        """Chart z = v(window): (..., n_d + 1, p) → (..., n); the inputs (..., n_d, m) are not needed."""
        flat = window.reshape(*window.shape[:-2], -1)
        return (flat if self.chart_degree == 1 else self.chart_monomials(flat)) @ self.chart.T

    def decode(self, z: np.ndarray) -> np.ndarray:
        """Newest sample of w(z): (..., n) → (..., p)."""
        return self.parametrization_monomials(z) @ self._newest.T

    def control_field(self, z: np.ndarray) -> np.ndarray:
        """b_r(z), (..., n) → (..., n, m)."""
        field = self._control_by_monomial
        if self.control_degree == 0:
            return np.broadcast_to(field[:, 0], z.shape[:-1] + field[:, 0].shape)
        return field[:, 0] + np.einsum("...q,nqm->...nm", self.control_monomials(z), field[:, 1:])

    def rate(self, z: np.ndarray, u: np.ndarray) -> np.ndarray:
        """dz/dt with input u, (..., n)."""
        return self.drift_monomials(z) @ self.drift.T + (self.control_field(z) @ u[..., None])[..., 0]

    def rate_jacobian(self, z: np.ndarray, u: np.ndarray) -> np.ndarray:
        """∂(dz/dt)/∂z, (..., n, n)."""
        jacobian = self.drift @ self.drift_monomials.jacobian(z)
        if self.control_degree > 0:
            jacobian = jacobian + ((self._control_by_monomial[:, 1:] @ u[..., None, :, None])[..., 0]
                                   @ self.control_monomials.jacobian(z))
        return jacobian

    def step(self, z: np.ndarray, u: np.ndarray) -> np.ndarray:
        """State one timestep later with u held, (..., n)."""
        return rk4_step(lambda x: self.rate(x, u), z, self.timestep, self.substeps)

    def linearize(self, z: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """A (..., n, n), B (..., n, m), c (..., n) of z⁺ ≈ A z + B u + c."""
        following, A, B = rk4_linearization(
            lambda x: self.rate(x, u), lambda x: (self.rate_jacobian(x, u), self.control_field(x)),
            z, np.eye(self.state_dim), self.timestep, self.substeps)
        return A, B, following - (A @ z[..., None])[..., 0] - (B @ u[..., None])[..., 0]

    def linearize_output(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """C (..., p, n), d (..., p) of y ≈ C z + d."""
        C = self._newest @ self.parametrization_monomials.jacobian(z)
        return C, self.decode(z) - (C @ z[..., None])[..., 0]
