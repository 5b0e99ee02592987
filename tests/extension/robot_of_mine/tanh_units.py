"""A model that is not polynomial, as plain arrays: this is what an artifact holds and a robot runs, without Torch."""

from __future__ import annotations

from dataclasses import dataclass

from ssmr_torch.models.arrays import Array, identity, namespace
from ssmr_torch.models.base import Linearization, Model, OutputLinearization, around
from ssmr_torch.models.integrators import rk4_linearization, rk4_step


@dataclass(frozen=True, eq=False, kw_only=True)
class TanhUnits(Model):
    """One unit per state:

        z = chart · [ŷ, û],   y = parametrization · z,   dz/dt = A z + B u + K tanh(z / state_scale).

    chart (n, (n_d + 1) p + n_d m), parametrization (p, n), A, K (n, n), B (n, m).
    """

    chart: Array
    parametrization: Array
    A: Array
    B: Array
    K: Array

    @property
    def flow(self) -> bool:
        return True

    def encode(self, window: Array, inputs: Array) -> Array:
        leading = window.shape[:-2]
        seen = [window.reshape(*leading, -1), inputs.reshape(*leading, -1)]
        return namespace(window).concatenate(seen, -1) @ self.chart.T

    def decode(self, z: Array) -> Array:
        return z @ self.parametrization.T

    def rate(self, z: Array, u: Array) -> Array:
        return z @ self.A.T + u @ self.B.T + namespace(z).tanh(z / self.state_scale) @ self.K.T

    def rate_jacobians(self, z: Array) -> tuple[Array, Array]:
        slope = (1.0 - namespace(z).tanh(z / self.state_scale) ** 2) / self.state_scale
        return self.A + self.K * slope[..., None, :], self.B + namespace(z).zeros_like(z[..., :1, None])

    def step(self, z: Array, u: Array) -> Array:
        return rk4_step(lambda x: self.rate(x, u), z, self.timestep)

    def step_jacobians(self, z: Array, u: Array) -> tuple[Array, Array, Array]:
        return rk4_linearization(lambda x: self.rate(x, u), self.rate_jacobians, z, identity(z, self.state_dim),
                                 self.timestep)

    def linearize(self, z: Array, u: Array) -> Linearization:
        return around(*self.step_jacobians(z, u), z, u)

    def linearize_output(self, z: Array) -> OutputLinearization:
        zero = namespace(z).zeros_like(self.decode(z))
        return OutputLinearization(self.parametrization + zero[..., None], zero)
