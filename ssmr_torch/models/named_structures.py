"""Structures of the named polynomial models (SSMR, control-augmented SSMR, Koopman), and models from their tables.

It needs no Torch. The Torch modules of the same names use these structures. Artifacts of older versions and published
models are read through them.
"""

from __future__ import annotations

from functools import lru_cache

from ssmr_torch.models.arrays import Array, identity, namespace
from ssmr_torch.models.monomials import MOST, Monomials, graded
from ssmr_torch.models.polynomial import PolynomialModel, PregainModel
from ssmr_torch.models.structure import Structure


@lru_cache(maxsize=256)
def ssm_structure(state_dim: int, input_dim: int, window_dim: int, *, parametrization_degree: int, dynamics_degree: int,
                  control_degree: int, chart_degree: int) -> Structure:
    """z = chart · ŷ^{1:n_v},   ŷ = w(z) = parametrization · z^{1:n_w},   dz/dt = R · [z^{1:n_r}, u, z^{1:n_u} ⊗ u]."""
    n, m = state_dim, input_dim
    drift, control = graded(n, 1, dynamics_degree), graded(n, 1, control_degree)
    products = [(*factors, n + j) for factors in ((), *control.factors) for j in range(m)]
    return Structure(graded(window_dim, 1, chart_degree), tuple(range(window_dim)),
                     graded(n, 1, parametrization_degree), Monomials(n + m, [*drift.factors, *products]),
                     "runge_kutta")


@lru_cache(maxsize=256)
def control_augmented_structure(state_dim: int, input_dim: int, window_dim: int, held_dim: int, *,
                                parametrization_degree: int, dynamics_degree: int, input_degree: int,
                                state_degree: int | None, saturated: bool) -> Structure:
    """z = chart · [ŷ, û],   y = parametrization · z^{1:n_w},   z⁺ = z + h · dynamics · (z, u)^{1:n_r},

    with the monomials of degree ≤ input_degree in u and ≤ state_degree in z. held_dim: number of values in û.
    """
    n, seen = state_dim, window_dim + held_dim
    joint = [factors for factors in graded(n + input_dim, 1, dynamics_degree).factors
             if sum(factor >= n for factor in factors) <= input_degree
             and sum(factor < n for factor in factors) <= (state_degree or dynamics_degree)]
    return Structure(graded(seen, 1, 1), tuple(range(seen)), graded(n, 1, parametrization_degree),
                     Monomials(n + input_dim, joint), "euler", saturated)


@lru_cache(maxsize=256)
def koopman_structure(input_dim: int, output_dim: int, delays: int, *, input_delays: int, degree: int, constant: bool,
                      bilinear: bool, relift: bool) -> Structure:
    """z = ψ(ζ / scale), ζ = [y_k, …, y_{k−n_d}, u_{k−1}, …, u_{k−n_u}],   f = A z + B u + Σ_j u_j N_j z;   z holds y.
    """
    p, m, lowest = output_dim, input_dim, 0 if constant else 1
    window = (delays + 1) * p
    if not 0 <= input_delays <= max(delays, 0) or window + input_delays * m > MOST:
        raise ValueError(f"input_delays is {input_delays} with {delays} delays of {p} outputs; expected from 0 to "
                         f"delays, and at most {MOST} values in a window")
    order = [k * p + i for k in range(delays, -1, -1) for i in range(p)]
    order += [window + k * m + i for k in range(delays - 1, delays - 1 - input_delays, -1) for i in range(m)]
    lifting = graded(len(order), lowest, degree)
    n = len(lifting)
    rows = [(k,) for k in range(n + m)] + [(i, n + j) for j in range(m) for i in range(n) if bilinear]
    newest = Monomials(n, [(1 - lowest + i,) for i in range(p)])
    return Structure(lifting, tuple(order), newest, Monomials(n + m, rows), "map", relift=relift)


def spectral_submanifold(*, chart: Array, parametrization: Array, drift: Array, control: Array, state_scale: Array,
                         chart_degree: int = 1, parametrization_degree: int = 1, dynamics_degree: int = 1,
                         control_degree: int = 1, input_dim: int, output_dim: int, delays: int, timestep: float,
                         window_timestep: float, substeps: int = 1) -> PolynomialModel:
    """z = chart · window^{1:n_v},   window = parametrization · z^{1:n_w},
    dz/dt = drift · z^{1:n_r} + control · [u, z^{1:n_u} ⊗ u].

    chart (n, ·), parametrization ((n_d + 1) p, ·), drift (n, ·), control (n, m (1 + ·)), state_scale (n,): SI.
    """
    structure = ssm_structure(len(chart), input_dim, (delays + 1) * output_dim, chart_degree=chart_degree,
                              parametrization_degree=parametrization_degree, dynamics_degree=dynamics_degree,
                              control_degree=control_degree)
    return PolynomialModel(
        structure=structure, chart=chart, parametrization=parametrization, state_scale=state_scale,
        dynamics=namespace(drift).concatenate([drift, control], -1), input_dim=input_dim, output_dim=output_dim,
        delays=delays, timestep=timestep, window_timestep=window_timestep, substeps=substeps)


def control_augmented(*, chart: Array, parametrization: Array, dynamics: Array, state_scale: Array,
                      parametrization_degree: int, dynamics_degree: int, input_degree: int,
                      state_degree: int | None = None, saturated: bool = False, input_dim: int, output_dim: int,
                      delays: int, timestep: float, window_timestep: float, base_timestep: float) -> PolynomialModel:
    """z = chart · [window, inputs held within it],   y = parametrization · z^{1:n_w},
    z⁺ = z + base_timestep · dynamics · (z, u)^{1:n_r}; see `control_augmented_structure`.

    chart (n, (n_d + 1) p + n_d m), parametrization (p, ·), dynamics (n, ·), state_scale (n,): SI.
    """
    structure = control_augmented_structure(
        len(chart), input_dim, (delays + 1) * output_dim, delays * input_dim, saturated=saturated,
        parametrization_degree=parametrization_degree, dynamics_degree=dynamics_degree, input_degree=input_degree,
        state_degree=state_degree)
    return PolynomialModel(structure=structure, chart=chart, parametrization=parametrization, dynamics=dynamics,
                           state_scale=state_scale, input_dim=input_dim, output_dim=output_dim, delays=delays,
                           timestep=timestep, window_timestep=window_timestep, base_timestep=base_timestep)


def koopman(*, scale: Array, A: Array, B: Array, N: Array, pregain: Array, set_points: Array, state_scale: Array,
            degree: int, input_delays: int, constant: bool, relift: bool = False, input_dim: int, output_dim: int,
            delays: int, timestep: float, window_timestep: float, base_timestep: float) -> PolynomialModel:
    """z = ψ(ζ / scale), z⁺ = A z + B u + Σ_j u_j N_j z, y = scale · (the entries of z that hold y_k).

    scale ((n_d + 1) p + n_u m,), A (N, N), B (N, m), N (m, N, N) of a bilinear model, otherwise (0, N, N); with relift,
    A, B and N have only the rows of ζ / scale. pregain, set_points: see `PregainModel`; (0, 1 + p) without a pregain.
    """
    xp, p = namespace(A), output_dim
    structure = koopman_structure(input_dim, p, delays, input_delays=input_delays, degree=degree,
                                  constant=bool(constant), bilinear=len(N) > 0, relift=bool(relift))
    tables = {"dynamics": xp.concatenate([A, B, *N], -1), "parametrization": identity(A, p) * scale[:p],
              "chart": A[:0],  # z is ψ itself
              "window_scale": scale, "state_scale": state_scale}
    plain = {"structure": structure, "input_dim": input_dim, "output_dim": p, "delays": delays, "timestep": timestep,
             "window_timestep": window_timestep, "base_timestep": base_timestep}
    if len(pregain):
        return PregainModel(**tables, **plain, pregain=pregain, set_points=set_points)
    return PolynomialModel(**tables, **plain)
