"""Trajectory piecewise linear (TPWL) model without Torch: linearizations, switched or blended by distance."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ssmr_torch.models.arrays import Array, namespace
from ssmr_torch.models.base import Linearization, Model, OutputLinearization, around
from ssmr_torch.models.integrators import map_linearization, repeated_map
from ssmr_torch.models.kalman import Noise, filter_window
from ssmr_torch.models.sizes import check_steps
from ssmr_torch.periods import whole_multiple

NEGLIGIBLE = 1e-17  # relative to the greatest weight: a hundred points below it change less than rounding does
BLOCK = 16


@dataclass(frozen=True, eq=False, kw_only=True)
class PiecewiseLinearModel(Model):
    """z = [q̃, ṽ];   z⁺ = Σ_i w_i(q̃) (A_i z + B_i u + c_i);   y = C z + d;   chart: an extended Kalman filter.

    width: m. Width 0 takes the nearest point; a positive width blends the points with the weights

        w_i = exp(−‖q̃ − q̃_i‖² / width²) / Σ_j exp(−‖q̃ − q̃_j‖² / width²).

    points (N, n/2): q̃_i, m.   A (N, n, n), B (N, n, m), c (N, n).   C (p, n), d (p,).
    mean (n,), covariance (n, n), process (n, n), measurement (p, p): the noise that the filter assumes, see `Noise`.
    base_timestep: time in s that one map covers. Raises ValueError if timestep or window_timestep is not a whole
    multiple of it.
    """

    c_source: ClassVar[str] = "ssmr_torch.deployment.c.tpwl:tpwl"

    points: Array
    A: Array
    B: Array
    c: Array
    C: Array
    d: Array
    mean: Array
    covariance: Array
    process: Array
    measurement: Array
    width: float
    base_timestep: float

    def __post_init__(self):
        super().__post_init__()
        self._check_shapes()
        check_steps("the number of maps in one step", self.repeats)
        check_steps("the number of maps in a window", max(1, self.delays) * self.window_steps)

    def _check_shapes(self) -> None:
        points, n, m, p = len(self.points), self.state_dim, self.input_dim, self.output_dim
        expected = {"A": (points, n, n), "B": (points, n, m), "c": (points, n), "C": (p, n), "d": (p,), "mean": (n,),
                    "covariance": (n, n), "process": (n, n), "measurement": (p, p)}
        for name, shape in expected.items():
            if tuple(getattr(self, name).shape) != shape:
                raise ValueError(f"{name} has the shape {tuple(getattr(self, name).shape)}; expected {shape}")
        if not 0 <= self.width < np.inf:
            raise ValueError(f"width is {self.width}; expected a number, 0 or more")

    @property
    def kind(self) -> str:
        return "TPWL"

    @property
    def repeats(self) -> int:
        """Number of maps in one step."""
        return whole_multiple("the step", self.timestep, "the timestep that this discrete-time model was fitted at",
                              self.base_timestep, "choose another period, or fit at a timestep that divides it")

    @property
    def window_steps(self) -> int:
        """Number of maps from one sample of a window to the next."""
        return whole_multiple("the model's window_timestep", self.window_timestep,
                              "the timestep that this discrete-time model was fitted at", self.base_timestep)

    def encode(self, window: Array, inputs: Array) -> Array:
        noise = Noise(self.mean, self.covariance, self.process, self.measurement)
        return filter_window(self, window, inputs, noise, self.window_steps)

    def decode(self, z: Array) -> Array:
        return z @ self.C.T + self.d

    def advance(self, z: Array, u: Array) -> Array:
        """State one base_timestep later, (..., n)."""
        if self.width == 0.0:
            return self._at_nearest(z, u)[0]
        following = namespace(z).zeros_like(z)
        for weights, each, _ in self._blocks(z, u):
            following = following + (weights[..., None, :] @ each)[..., 0, :]
        return following

    def advance_linearization(self, z: Array, u: Array) -> tuple[Array, Array, Array]:
        """z⁺, ∂z⁺/∂z = Σ_i w_i A_i + Σ_i (A_i z + B_i u + c_i) (∂w_i/∂z)ᵀ and ∂z⁺/∂u = Σ_i w_i B_i in one pass."""
        if self.width == 0.0:
            return self._at_nearest(z, u)
        xp, following, A, B, mean, mixed = namespace(z), 0.0, 0.0, 0.0, 0.0, 0.0
        for weights, each, (points, of_state, of_input) in self._blocks(z, u):
            following = following + (weights[..., None, :] @ each)[..., 0, :]
            A = A + xp.tensordot(weights, of_state, 1)
            B = B + xp.tensordot(weights, of_input, 1)
            mean = mean + weights @ points
            mixed = mixed + each.swapaxes(-1, -2) @ (weights[..., None] * points)
        turning = 2.0 / self.width ** 2 * (mixed - following[..., None] * mean[..., None, :])
        return following, A + xp.concatenate([turning, xp.zeros_like(turning)], -1), B

    def step(self, z: Array, u: Array) -> Array:
        return repeated_map(lambda x: self.advance(x, u), z, self.repeats)

    def step_jacobians(self, z: Array, u: Array) -> tuple[Array, Array, Array]:
        """`step`, ∂z⁺/∂z (..., n, n) and ∂z⁺/∂u (..., n, m)."""
        return map_linearization(lambda x: self.advance_linearization(x, u), z, self.repeats)

    def linearize(self, z: Array, u: Array) -> Linearization:
        return around(*self.step_jacobians(z, u), z, u)

    def linearize_output(self, z: Array) -> OutputLinearization:
        xp = namespace(z)
        C, d = (xp.broadcast_to(table, (*z.shape[:-1], *table.shape)) for table in (self.C, self.d))
        return OutputLinearization(C, d)

    def _distances(self, z: Array) -> Array:
        """‖q̃ − q̃_i‖² − ‖q̃‖², (..., N)."""
        return (self.points ** 2).sum(-1) - 2.0 * (z[..., :self.points.shape[1]] @ self.points.T)

    def _at_nearest(self, z: Array, u: Array) -> tuple[Array, Array, Array]:
        nearest = self._distances(z).argmin(-1)[..., None]  # vmap needs an index with at least one dimension
        A, B, c = self.A[nearest][..., 0, :, :], self.B[nearest][..., 0, :, :], self.c[nearest][..., 0, :]
        return (A @ z[..., None] + B @ u[..., None])[..., 0] + c, A, B

    def _blocks(self, z: Array, u: Array) -> Iterator[tuple]:
        """Weights (..., k), A_i z + B_i u + c_i (..., k, n), q̃_i, A_i and B_i, for k points at a time."""
        xp, distances = namespace(z), self._distances(z)
        weights = xp.exp((xp.amin(distances, -1)[..., None] - distances) / self.width ** 2)
        blocks = _counting(weights) if xp is np else [slice(None)]
        weights = weights / weights.sum(-1)[..., None]
        for block in blocks:
            A, B = self.A[block], self.B[block]
            yield weights[..., block], _applied(A, z) + _applied(B, u) + self.c[block], (self.points[block], A, B)


def _counting(weights: np.ndarray) -> Iterator[np.ndarray]:
    """Indices of the points with weight, `BLOCK` at a time, so that their matrices fit into the cache."""
    counting = np.flatnonzero((weights > NEGLIGIBLE).reshape(-1, weights.shape[-1]).any(0))
    for first in range(0, len(counting), BLOCK):
        yield counting[first:first + BLOCK]


def _applied(matrices: Array, x: Array) -> Array:
    """Each matrix times x: (k, n, m), (..., m) → (..., k, n)."""
    return (x @ matrices.reshape(-1, matrices.shape[-1]).T).reshape(*x.shape[:-1], *matrices.shape[:2])
