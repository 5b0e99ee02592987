"""Koopman models: DMD with control, EDMD with monomials, bilinear EDMD, and the model of the static pregain."""

from __future__ import annotations

import torch
from torch import Tensor

from ssmr_torch.checked_arguments import checked
from ssmr_torch.models.named_structures import koopman, koopman_structure
from ssmr_torch.models.polynomial import PolynomialModel
from ssmr_torch.models.torch_model import TorchModel, table
from ssmr_torch.quantities import DEGREE, DELAYS, MODEL_TIMESTEP, TIMESTEP, TRUTH
from ssmr_torch.ranges import OrNone


class Koopman(TorchModel):
    """Linear or bilinear dynamics of lifted observables (paper, "Baselines"; [Korda and Mezić 2018] for the lifting):

        ζ_k = [y_k, …, y_{k-n_d}, u_{k-1}, …, u_{k-n_u}],   z = ψ(ζ / scale),
        z⁺ = A z + B u + Σ_j u_j N_j z,   y = C z,

    ψ holds all monomials of degree up to `degree`, and the constant if `constant`. degree 1 is DMD with control and
    delays; degree 2 or more is EDMD; bilinear adds the N_j [Bruder et al. 2021]. C reads the newest sample out of z, so
    that decode(encode(window)) is that sample.
    relift: re-lifting at every step, z⁺ = ψ(A z + …). The model then predicts ζ only and computes z from it, which
    keeps z on the image of ψ [van Goor et al. 2023]. Without it, the model predicts all of z.
    pregain: whether the model has a static pregain G, u = G [1, y] at rest, for the controller `static_pregain`.

    state_dim follows from the lifting. timestep: s; None if the data give it.
    Raises ValueError for input_delays above `delays`, or a degree below 1.
    """

    @checked(delays=DELAYS, timestep=MODEL_TIMESTEP, window_timestep=OrNone(TIMESTEP), input_delays=DELAYS,
             constant=TRUTH, base_timestep=OrNone(TIMESTEP), degree=DEGREE, relift=TRUTH)
    def __init__(self, input_dim: int, output_dim: int, delays: int = 1, *, input_delays: int = 1, degree: int = 1,
                 constant: bool = True, bilinear: bool = False, relift: bool = False, pregain: bool = False,
                 timestep: float = 0.01, window_timestep: float | None = None, base_timestep: float | None = None):
        if int(degree) != degree or degree < 1:
            raise ValueError(f"degree is {degree}; expected a whole number: 1 (DMD), or more (EDMD)")
        if int(input_delays) != input_delays or not 0 <= input_delays <= delays:
            raise ValueError(f"input_delays is {input_delays}; expected 0 to {delays}, the number of delays, because "
                             "a window holds only the inputs between its samples")
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
        _ = self.reduced  # raises an error if timestep is not a whole multiple of base_timestep

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

    @checked(delays=DELAYS, timestep=MODEL_TIMESTEP, window_timestep=OrNone(TIMESTEP), input_delays=DELAYS,
             constant=TRUTH, base_timestep=OrNone(TIMESTEP))
    def __init__(self, input_dim: int, output_dim: int, delays: int = 1, *, input_delays: int = 1,
                 constant: bool = True, timestep: float = 0.01, window_timestep: float | None = None,
                 base_timestep: float | None = None):
        super().__init__(input_dim, output_dim, delays, input_delays=input_delays, constant=constant,
                         timestep=timestep, window_timestep=window_timestep, base_timestep=base_timestep)


class EDMD(Koopman):
    """Extended DMD: monomials of ζ / scale up to a degree, z⁺ = A z + B u; with re-lifting at every step if `relift`.
    """

    @checked(delays=DELAYS, timestep=MODEL_TIMESTEP, window_timestep=OrNone(TIMESTEP), input_delays=DELAYS,
             constant=TRUTH, base_timestep=OrNone(TIMESTEP), degree=DEGREE, relift=TRUTH)
    def __init__(self, input_dim: int, output_dim: int, delays: int = 1, *, input_delays: int = 1, degree: int = 2,
                 constant: bool = True, relift: bool = False, timestep: float = 0.01,
                 window_timestep: float | None = None, base_timestep: float | None = None):
        super().__init__(input_dim, output_dim, delays, input_delays=input_delays, degree=degree, constant=constant,
                         relift=relift, timestep=timestep, window_timestep=window_timestep,
                         base_timestep=base_timestep)


class BilinearEDMD(Koopman):
    """Koopman model that is bilinear in lifted state and input, z⁺ = A z + B u + Σ_j u_j N_j z.

    The default degree is 1, because most data determine no more than the products of ζ with the input.
    """

    @checked(delays=DELAYS, timestep=MODEL_TIMESTEP, window_timestep=OrNone(TIMESTEP), input_delays=DELAYS,
             constant=TRUTH, base_timestep=OrNone(TIMESTEP), degree=DEGREE, relift=TRUTH)
    def __init__(self, input_dim: int, output_dim: int, delays: int = 1, *, input_delays: int = 1, degree: int = 1,
                 constant: bool = True, relift: bool = False, timestep: float = 0.01,
                 window_timestep: float | None = None, base_timestep: float | None = None):
        super().__init__(input_dim, output_dim, delays, input_delays=input_delays, degree=degree, constant=constant,
                         bilinear=True, relift=relift, timestep=timestep, window_timestep=window_timestep,
                         base_timestep=base_timestep)


class StaticPregainKoopman(Koopman):
    """Linear model of delayed outputs only, with the static pregain u = G [1, y], fitted to set points."""

    @checked(delays=DELAYS, timestep=MODEL_TIMESTEP, window_timestep=OrNone(TIMESTEP), input_delays=DELAYS,
             constant=TRUTH, base_timestep=OrNone(TIMESTEP))
    def __init__(self, input_dim: int, output_dim: int, delays: int = 1, *, input_delays: int = 0,
                 constant: bool = False, timestep: float = 0.01, window_timestep: float | None = None,
                 base_timestep: float | None = None):
        super().__init__(input_dim, output_dim, delays, input_delays=input_delays, constant=constant, pregain=True,
                         timestep=timestep, window_timestep=window_timestep, base_timestep=base_timestep)
