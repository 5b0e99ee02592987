"""A lifted linear or bilinear model as plain arrays."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ssmr_torch.models.monomials import Monomials
from ssmr_torch.models.tables import DiscreteTimeTables


@dataclass(frozen=True, eq=False, kw_only=True)
class KoopmanTables(DiscreteTimeTables):
    """z = ψ(ζ / scale), ζ = [y_k, …, y_{k-n_d}, u_{k-1}, …, u_{k-n_u}], ψ the monomials of degree 0 (or 1) to d;
    z⁺ = A z + B u + Σ_j u_j N_j z,   y = scale · (the entries of z that hold y_k).

    scale ((n_d + 1) p + n_u m,), A (N, N), B (N, m), N (m, N, N) of the bilinear variant, else (0, N, N); with relift,
    z⁺ = ψ(A z + …) and the rows of A, B, N are those of ζ / scale alone;
    pregain G (m, 1 + p) of u = G [1, y] at rest, else (0, 1 + p); set_points (1 + p, 1 + p) of those behind it, else
    (0, 1 + p): triangular factor of the mean of [1, y]ᵀ [1, y]. float64, SI.
    """

    scale: np.ndarray
    A: np.ndarray
    B: np.ndarray
    N: np.ndarray
    pregain: np.ndarray
    set_points: np.ndarray
    degree: int
    input_delays: int
    constant: bool
    relift: bool = False

    @property
    def affine(self) -> bool:
        return not len(self.N) and not self.relift

    @cached_property
    def monomials(self) -> Monomials:
        return Monomials(len(self.scale), 0 if self.constant else 1, self.degree)

    @cached_property
    def read_out(self) -> np.ndarray:
        """C (p, N): y_k = C z, the linear monomials of the newest sample."""
        return np.eye(self.output_dim, self.state_dim, int(self.constant)) * self.scale[:self.output_dim, None]

    def observables(self, window: np.ndarray, inputs: np.ndarray) -> np.ndarray:
        """ζ / scale, newest first: (..., n_d + 1, p), (..., n_d, m) → (..., (n_d + 1) p + n_u m)."""
        leading = window.shape[:-2]
        newest_first = inputs[..., ::-1, :][..., :self.input_delays, :]
        return np.concatenate([window[..., ::-1, :].reshape(*leading, -1),
                               newest_first.reshape(*leading, -1)], axis=-1) / self.scale

    def encode(self, window: np.ndarray, inputs: np.ndarray) -> np.ndarray:
        return self.monomials(self.observables(window, inputs))

    def decode(self, z: np.ndarray) -> np.ndarray:
        return z @ self.read_out.T

    def advance(self, z: np.ndarray, u: np.ndarray) -> np.ndarray:
        following = self.propagate(z, u)
        return self.monomials(following) if self.relift else following

    def propagate(self, z: np.ndarray, u: np.ndarray) -> np.ndarray:
        """All of the next state, or its ζ / scale where that is lifted anew."""
        following = z @ self.A.T + u @ self.B.T
        if len(self.N):
            following = following + np.einsum("...m,mij,...j->...i", u, self.N, z)
        return following

    def advance_jacobians(self, z: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        A, B = (np.broadcast_to(table, z.shape[:-1] + table.shape) for table in (self.A, self.B))
        if len(self.N):
            A, B = A + np.tensordot(u, self.N, 1), B + np.einsum("mij,...j->...im", self.N, z)
        if self.relift:
            lifted = self.monomials.jacobian(self.propagate(z, u))
            A, B = lifted @ A, lifted @ B
        return A, B

    def linearize_output(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        C = np.broadcast_to(self.read_out, z.shape[:-1] + self.read_out.shape)
        return C, np.zeros(z.shape[:-1] + (self.output_dim,))
