"""Spectral submanifold reduction: polynomial chart, parametrization, reduced dynamics and control field."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from ssmr_torch.models.base import ContinuousTimeModel, OutputLinearization, fill
from ssmr_torch.models.monomial_features import MonomialFeatures
from ssmr_torch.models.monomials import Monomials, count_monomials
from ssmr_torch.models.polynomial_tables import PolynomialTables


class SSMR(ContinuousTimeModel):
    """Dynamics on a spectral submanifold, seen through a delayed observable (paper, Eq. 3 and 7).

        z = v(ŷ) = chart · ŷ^{1:n_v},   ŷ = w(z) = parametrization · z^{1:n_w},
        dz/dt = drift · z^{1:n_r} + control · [u, z^{1:n_u} ⊗ u],

    with ŷ the window flattened oldest sample first. n_v = 1 gives the orthogonal chart Vᵀ; all degrees 1 give SSSR;
    control_degree n_u = 0 gives a constant input matrix. Monomials are those of `Monomials`, degree-graded.

    Raises ValueError when the window holds fewer values than state_dim: no chart of that dimension exists.
    """

    def __init__(self, state_dim: int, input_dim: int, output_dim: int, delays: int = 1, *,
                 parametrization_degree: int = 1, dynamics_degree: int = 1, control_degree: int = 1,
                 chart_degree: int = 1, timestep: float = 0.01, window_timestep: float | None = None,
                 substeps: int = 1):
        super().__init__(state_dim, input_dim, output_dim, delays, timestep,
                         timestep if window_timestep is None else window_timestep, substeps)
        if self.window_dim < state_dim:
            raise ValueError(f"a window of {delays + 1} samples of {output_dim} outputs holds {self.window_dim} "
                             f"values, fewer than the {state_dim} reduced coordinates; use at least "
                             f"{-(-state_dim // output_dim) - 1} delays or a smaller state_dim")
        degrees = {"parametrization_degree": parametrization_degree, "dynamics_degree": dynamics_degree,
                   "chart_degree": chart_degree}
        for name, degree in degrees.items():
            if degree < 1:
                raise ValueError(f"{name} is {degree}; expected 1 or more")
        if control_degree < 0:
            raise ValueError(f"control_degree is {control_degree}; expected 0 (constant) or more")
        self.parametrization_degree, self.dynamics_degree = parametrization_degree, dynamics_degree
        self.control_degree, self.chart_degree = control_degree, chart_degree

        def table(rows: int, columns: int) -> nn.Parameter:
            return nn.Parameter(torch.zeros(rows, columns, dtype=torch.float64))

        n, m, window = self.state_dim, self.input_dim, self.window_dim
        self.chart = table(n, count_monomials(window, 1, chart_degree))
        self.parametrization = table(window, count_monomials(n, 1, parametrization_degree))
        self.drift_table = table(n, count_monomials(n, 1, dynamics_degree))
        self.control_table = table(n, m * (1 + count_monomials(n, 1, control_degree)))
        self.chart_features = MonomialFeatures(Monomials(window, 1, chart_degree))
        self.parametrization_features = MonomialFeatures(Monomials(n, 1, parametrization_degree))
        self.drift_features = MonomialFeatures(Monomials(n, 1, dynamics_degree))
        self.control_features = MonomialFeatures(Monomials(n, 1, control_degree))

    @property
    def arguments(self) -> dict:
        return {name: getattr(self, name) for name in (
            "state_dim", "input_dim", "output_dim", "delays", "parametrization_degree", "dynamics_degree",
            "control_degree", "chart_degree", "timestep", "window_timestep", "substeps")}

    def encode(self, window: Tensor, inputs: Tensor | None = None) -> Tensor:
        return self.chart_regressors(window, inputs) @ self.chart.T

    def chart_regressors(self, window: Tensor, inputs: Tensor | None = None) -> Tensor:
        """ŷ^{1:n_v}, such that encode = chart · regressors."""
        return self.chart_features(window.flatten(-2))

    def decode(self, z: Tensor) -> Tensor:
        return self.parametrization_features(z) @ self.parametrization[-self.output_dim:].T

    def decode_window(self, z: Tensor) -> Tensor:
        """The whole window w(z), (..., n) → (..., n_d + 1, p)."""
        window = self.parametrization_features(z) @ self.parametrization.T
        return window.unflatten(-1, (self.delays + 1, self.output_dim))

    def drift(self, z: Tensor) -> Tensor:
        return self.drift_features(z) @ self.drift_table.T

    def control_regressors(self, z: Tensor, u: Tensor) -> Tensor:
        """[u, z^{1:n_u} ⊗ u], (..., m (1 + q)), such that control_field(z) u = control_table · regressors."""
        products = self.control_features(z)[..., :, None] * u[..., None, :]
        return torch.cat([u, products.flatten(-2)], dim=-1)

    def dynamics_regressors(self, z: Tensor, u: Tensor) -> Tensor:
        """[z^{1:n_r}, u, z^{1:n_u} ⊗ u], such that rate = [drift, control] · regressors."""
        return torch.cat([self.drift_features(z), self.control_regressors(z, u)], dim=-1)

    def control_field(self, z: Tensor) -> Tensor:
        weights = torch.cat([torch.ones_like(z[..., :1]), self.control_features(z)], dim=-1)
        return torch.einsum("...q,nqm->...nm", weights, self._control_by_monomial())

    def rate(self, z: Tensor, u: Tensor) -> Tensor:
        return self.drift(z) + self.control_regressors(z, u) @ self.control_table.T

    def rate_jacobian(self, z: Tensor, u: Tensor) -> Tensor:
        jacobian = self.drift_table @ self.drift_features.jacobian(z)
        if self.control_degree == 0:
            return jacobian
        weighted = torch.einsum("nqm,...m->...nq", self._control_by_monomial()[:, 1:], u)
        return jacobian + weighted @ self.control_features.jacobian(z)

    def linearize_output(self, z: Tensor) -> OutputLinearization:
        C = self.parametrization[-self.output_dim:] @ self.parametrization_features.jacobian(z)
        return OutputLinearization(C, self.decode(z) - (C @ z[..., None])[..., 0])

    def tables(self) -> PolynomialTables:
        arrays = {"chart": self.chart, "parametrization": self.parametrization, "drift": self.drift_table,
                  "control": self.control_table, "state_scale": self.state_scale}
        return PolynomialTables(**{name: value.detach().cpu().numpy() for name, value in arrays.items()},
                                **{name: getattr(self, name) for name in PolynomialTables.scalar_names()})

    @classmethod
    def from_tables(cls, tables: PolynomialTables) -> SSMR:
        model = cls(tables.state_dim, **{name: getattr(tables, name) for name in tables.scalar_names()})
        fill(((model.chart, tables.chart), (model.parametrization, tables.parametrization),
              (model.drift_table, tables.drift), (model.control_table, tables.control),
              (model.state_scale, tables.state_scale)))
        return model

    def _control_by_monomial(self) -> Tensor:
        return self.control_table.unflatten(-1, (-1, self.input_dim))
