"""Koopman models: dynamic mode decomposition, its extension by monomials, and their bilinear variant."""

from __future__ import annotations

import torch
from torch import Tensor

from ssmr_torch.models.named_structures import koopman, koopman_structure
from ssmr_torch.models.polynomial import PolynomialModel
from ssmr_torch.models.torch_model import TorchModel, table


class Koopman(TorchModel):
    """Linear or bilinear dynamics of lifted observables (paper, "Baselines"; [Korda and Mezić 2018] for the lifting):

        ζ_k = [y_k, …, y_{k-n_d}, u_{k-1}, …, u_{k-n_u}],   z = ψ(ζ / scale),
        z⁺ = A z + B u + Σ_j u_j N_j z,   y = C z,

    with ψ all monomials of degree up to `degree`, the constant among them if `constant`. degree 1 is DMD with control
    and delays, degree 2 or more EDMD; bilinear adds the N_j [Bruder et al. 2021]. C reads the newest sample out of z,
    so that decode(encode(window)) is that sample. relift: whether ζ alone is propagated and lifted anew at each step,
    z⁺ = ψ(A z + …), which keeps z on the image of ψ [van Goor et al. 2023], instead of all of z. pregain: whether the
    model carries a static pregain G, u = G [1, y] at rest, for the controller of that name.

    state_dim follows from the lifting. timestep: s; None where the data give it.
    Raises ValueError for input_delays above `delays`, or a degree below 1.
    """

    def __init__(self, input_dim: int, output_dim: int, delays: int = 1, *, input_delays: int = 1, degree: int = 1,
                 constant: bool = True, bilinear: bool = False, relift: bool = False, pregain: bool = False,
                 timestep: float = 0.01, window_timestep: float | None = None, base_timestep: float | None = None):
        if int(degree) != degree or degree < 1:
            raise ValueError(f"degree is {degree}; expected 1 (DMD) or more (EDMD), a whole number")
        if int(input_delays) != input_delays or not 0 <= input_delays <= delays:
            raise ValueError(f"input_delays is {input_delays}; expected 0 to the {delays} delays, for a window holds "
                             "the inputs between its samples")
        structure = koopman_structure(int(input_dim), int(output_dim), int(delays), input_delays=int(input_delays),
                                      degree=int(degree), constant=bool(constant), bilinear=bool(bilinear),
                                      relift=bool(relift))
        super().__init__(len(structure.chart), input_dim, output_dim, delays, timestep, window_timestep)
        self.structure, self.lifting = structure, structure.chart
        self.input_delays, self.degree, self.constant = int(input_delays), int(degree), bool(constant)
        self.bilinear, self.relift, self.has_pregain = bool(bilinear), bool(relift), bool(pregain)
        self.base_timestep = self.timestep if base_timestep is None else float(base_timestep)
        size, m, p, linear = self.state_dim, self.input_dim, self.output_dim, int(self.constant)
        self.propagated = slice(linear, linear + structure.chart.variables) if relift else slice(0, size)
        rows = self.propagated.stop - self.propagated.start
        self.A, self.B, self.N = table(rows, size), table(rows, m), table(m if bilinear else 0, rows, size)
        for name, value in (("scale", torch.ones(structure.chart.variables)),
                            ("pregain", torch.zeros(m if pregain else 0, 1 + p)),
                            ("set_points", torch.eye(1 + p)[:None if pregain else 0])):
            self.register_buffer(name, value.double())
        _ = self.reduced  # which refuses a timestep that is no whole multiple of the base

    @property
    def arguments(self) -> dict:
        return super().arguments | ({"pregain": self.has_pregain} if "pregain" in super().arguments else {})

    @property
    def reduced(self) -> PolynomialModel:
        return koopman(scale=self.scale, A=self.A, B=self.B, N=self.N, pregain=self.pregain, degree=self.degree,
                       set_points=self.set_points, input_delays=self.input_delays, constant=self.constant,
                       relift=self.relift, base_timestep=self.base_timestep, **self.sizes)

    def observables(self, window: Tensor, inputs: Tensor) -> Tensor:
        """ζ, (..., (n_d + 1) p + n_u m), newest first, not scaled."""
        return self.reduced.observables(window, inputs) * self.scale


class DMD(Koopman):
    """Dynamic mode decomposition with control and delays: z = [1, ζ / scale], z⁺ = A z + B u."""

    def __init__(self, input_dim: int, output_dim: int, delays: int = 1, *, input_delays: int = 1,
                 constant: bool = True, timestep: float = 0.01, window_timestep: float | None = None,
                 base_timestep: float | None = None):
        super().__init__(input_dim, output_dim, delays, input_delays=input_delays, constant=constant,
                         timestep=timestep, window_timestep=window_timestep, base_timestep=base_timestep)


class EDMD(Koopman):
    """Extended DMD: monomials of ζ / scale up to a degree, z⁺ = A z + B u, perhaps lifted anew after each step."""

    def __init__(self, input_dim: int, output_dim: int, delays: int = 1, *, input_delays: int = 1, degree: int = 2,
                 constant: bool = True, relift: bool = False, timestep: float = 0.01,
                 window_timestep: float | None = None, base_timestep: float | None = None):
        super().__init__(input_dim, output_dim, delays, input_delays=input_delays, degree=degree, constant=constant,
                         relift=relift, timestep=timestep, window_timestep=window_timestep,
                         base_timestep=base_timestep)


class BilinearEDMD(Koopman):
    """Koopman model bilinear in lifted state and input, z⁺ = A z + B u + Σ_j u_j N_j z; degree 1 unless asked for more,
    whose products with the input are all that most data determine.
    """

    def __init__(self, input_dim: int, output_dim: int, delays: int = 1, *, input_delays: int = 1, degree: int = 1,
                 constant: bool = True, relift: bool = False, timestep: float = 0.01,
                 window_timestep: float | None = None, base_timestep: float | None = None):
        super().__init__(input_dim, output_dim, delays, input_delays=input_delays, degree=degree, constant=constant,
                         bilinear=True, relift=relift, timestep=timestep, window_timestep=window_timestep,
                         base_timestep=base_timestep)


class StaticPregainKoopman(Koopman):
    """A linear model of the delayed outputs alone, and the static pregain u = G [1, y] of the set points."""

    def __init__(self, input_dim: int, output_dim: int, delays: int = 1, *, input_delays: int = 0,
                 constant: bool = False, timestep: float = 0.01, window_timestep: float | None = None,
                 base_timestep: float | None = None):
        super().__init__(input_dim, output_dim, delays, input_delays=input_delays, constant=constant, pregain=True,
                         timestep=timestep, window_timestep=window_timestep, base_timestep=base_timestep)
