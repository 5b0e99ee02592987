"""Koopman models: dynamic mode decomposition, its extension by monomials, and their bilinear variant."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from ssmr_torch.models.base import DiscreteTimeModel, OutputLinearization, fill
from ssmr_torch.models.koopman_tables import KoopmanTables
from ssmr_torch.models.monomial_features import MonomialFeatures
from ssmr_torch.models.monomials import Monomials, count_monomials


class Koopman(DiscreteTimeModel):
    """Linear or bilinear dynamics of lifted observables (paper, "Baselines"; [Korda and Mezić 2018] for the lifting):

        ζ_k = [y_k, …, y_{k-n_d}, u_{k-1}, …, u_{k-n_u}],   z = ψ(ζ / scale),
        z⁺ = A z + B u + Σ_j u_j N_j z,   y = C z,

    with ψ all monomials of degree up to `degree`, the constant among them if `constant`. degree 1 is DMD with control
    and delays, degree 2 or more EDMD; bilinear adds the N_j [Bruder et al. 2021]. C reads the newest sample out of z,
    so that decode(encode(window)) is that sample. relift: whether ζ alone is propagated and lifted anew at each step,
    z⁺ = ψ(A z + …), which keeps z on the image of ψ [van Goor et al. 2023], instead of all of z. pregain: whether the
    model carries a static pregain G, u = G [1, y] at rest, for the controller of that name.

    state_dim follows from the lifting. Raises ValueError for input_delays above `delays`, or a degree below 1.
    """

    def __init__(self, input_dim: int, output_dim: int, delays: int = 1, *, input_delays: int = 1, degree: int = 1,
                 constant: bool = True, bilinear: bool = False, relift: bool = False, pregain: bool = False,
                 timestep: float = 0.01, window_timestep: float | None = None, base_timestep: float | None = None):
        if degree < 1:
            raise ValueError(f"degree is {degree}; expected 1 (DMD) or more (EDMD)")
        if not 0 <= input_delays <= delays:
            raise ValueError(f"input_delays is {input_delays}; expected 0 to the {delays} delays, for a window holds "
                             "the inputs between its samples")
        observables = (delays + 1) * output_dim + input_delays * input_dim
        lowest = 0 if constant else 1
        super().__init__(count_monomials(observables, lowest, degree), input_dim, output_dim, delays, timestep,
                         timestep if window_timestep is None else window_timestep, base_timestep)
        self.input_delays, self.degree, self.constant = int(input_delays), int(degree), bool(constant)
        self.bilinear, self.relift, self.has_pregain = bool(bilinear), bool(relift), bool(pregain)
        self.lifting = MonomialFeatures(Monomials(observables, lowest, degree))

        def table(*shape: int) -> nn.Parameter:
            return nn.Parameter(torch.zeros(shape, dtype=torch.float64))

        size, m = self.state_dim, self.input_dim
        self.propagated = slice(1 - lowest, 1 - lowest + observables) if relift else slice(0, size)
        rows = self.propagated.stop - self.propagated.start
        self.register_buffer("scale", torch.ones(observables, dtype=torch.float64))
        self.A, self.B, self.N = table(rows, size), table(rows, m), table(m if bilinear else 0, rows, size)
        self.register_buffer("pregain", torch.zeros(m if pregain else 0, 1 + self.output_dim, dtype=torch.float64))
        self.register_buffer("set_points", torch.eye(1 + self.output_dim, dtype=torch.float64)[:None if pregain else 0])

    @property
    def arguments(self) -> dict:
        return {name: getattr(self, name) for name in (
            "input_dim", "output_dim", "delays", "input_delays", "degree", "constant", "bilinear", "relift",
            "timestep", "window_timestep", "base_timestep")} | {"pregain": self.has_pregain}

    @property
    def read_out(self) -> Tensor:
        """C (p, N)."""
        p, first = self.output_dim, int(self.constant)
        C = self.scale.new_zeros(p, self.state_dim)
        C[:, first:first + p] = torch.diag(self.scale[:p])
        return C

    def observables(self, window: Tensor, inputs: Tensor) -> Tensor:
        """ζ, (..., (n_d + 1) p + n_u m), newest first, not scaled."""
        return torch.cat([window.flip(-2).flatten(-2), inputs.flip(-2)[..., :self.input_delays, :].flatten(-2)], dim=-1)

    def encode(self, window: Tensor, inputs: Tensor) -> Tensor:
        return self.lifting(self.observables(window, inputs) / self.scale)

    def decode(self, z: Tensor) -> Tensor:
        return z @ self.read_out.T

    def advance(self, z: Tensor, u: Tensor) -> Tensor:
        following = self.propagate(z, u)
        return self.lifting(following) if self.relift else following

    def propagate(self, z: Tensor, u: Tensor) -> Tensor:
        """What of the next state is regressed: all of it, or ζ / scale where it is lifted anew."""
        following = z @ self.A.T + u @ self.B.T
        if self.bilinear:
            following = following + torch.einsum("...m,mij,...j->...i", u, self.N, z)
        return following

    def advance_jacobians(self, z: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
        A, B = self.A.expand(*z.shape[:-1], -1, -1), self.B.expand(*z.shape[:-1], -1, -1)
        if self.bilinear:
            A, B = A + torch.tensordot(u, self.N, 1), B + torch.einsum("mij,...j->...im", self.N, z)
        if self.relift:
            lifted = self.lifting.jacobian(self.propagate(z, u))
            A, B = lifted @ A, lifted @ B
        return A, B

    def linearize_output(self, z: Tensor) -> OutputLinearization:
        C = self.read_out.expand(*z.shape[:-1], -1, -1)
        return OutputLinearization(C, z.new_zeros(*z.shape[:-1], self.output_dim))

    def tables(self) -> KoopmanTables:
        arrays = {name: getattr(self, name).detach().cpu().numpy() for name in KoopmanTables.array_names()}
        return KoopmanTables(**arrays, **{name: getattr(self, name) for name in KoopmanTables.scalar_names()})

    @classmethod
    def from_tables(cls, tables: KoopmanTables) -> Koopman:
        model = cls(**{name: getattr(tables, name) for name in tables.scalar_names()}, bilinear=len(tables.N) > 0,
                    pregain=len(tables.pregain) > 0)
        fill([(getattr(model, name), getattr(tables, name)) for name in tables.array_names()])
        return model
