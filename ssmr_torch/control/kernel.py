"""The compiled horizon of a polynomial model: its step and the sensitivities of every step, fed from its forms.

A step applies the dynamics again and again with the input held: four stages of Runge-Kutta per substep, an Euler step,
or a map. z and S = [∂z/∂z_0, ∂z/∂u] are carried along. The held input is folded into the tables once per step.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ssmr_torch.control.condensing import compiled, condensed, copy, split
from ssmr_torch.models.polynomial import SCHEMES
from ssmr_torch.models.split import derivative_table, output_table, products
from ssmr_torch.models.split import split as split_form

RUNGE_KUTTA, EULER = SCHEMES.index("runge_kutta"), SCHEMES.index("euler")


class KernelTables(NamedTuple):
    """Tables over the closure of the monomials of z, see `models.split.Split`; indices unsigned, which index faster.

    products, u_products (2, ·): entry 1 + n + i of the closure of z is entry products[0, i] times z[products[1, i]];
    likewise of u. free, runs, fields, free_z, runs_z, fields_z, runs_u: see `Split`. output (p, ·), output_z (p n, ·):
    of y and ∂y/∂z. linear (n, n): what is linear in z; edge (n,): where other runs saturate, empty where they do not.
    columns_u: of ∂f/∂u. scheme, length (s): of Runge-Kutta substeps or Euler steps. count: evaluations of the dynamics
    in a step.
    """

    products: np.ndarray
    u_products: np.ndarray
    free: np.ndarray
    runs: np.ndarray
    fields: np.ndarray
    free_z: np.ndarray
    runs_z: np.ndarray
    fields_z: np.ndarray
    runs_u: np.ndarray
    output: np.ndarray
    output_z: np.ndarray
    linear: np.ndarray
    edge: np.ndarray
    columns_u: int
    scheme: int
    length: float
    count: int


def compiled_polynomial(model) -> tuple | None:
    """Tables, `rollout` and `condense` of a `PolynomialModel`; None where its observables are lifted anew."""
    structure = model.structure
    if structure.relift:
        return None
    found = split_form(model.dynamics_form, model.state_dim, structure.parametrization)
    output = output_table(model.output_form, found.states)
    tables = KernelTables(
        _index(products(found.states)), _index(products(found.inputs)), found.free, _index(found.runs), found.fields,
        found.free_z, _index(found.runs_z), found.fields_z, _index(found.runs_u), output,
        derivative_table(output, found.states), np.ascontiguousarray(model.linear_part),
        np.array(model.edge if structure.saturated else ()), found.columns_u, SCHEMES.index(structure.scheme),
        model.timestep / model.substeps if model.flow else model.base_timestep,
        4 * model.substeps if model.flow else model.repeats)
    return tuple(tables), rollout, condense


def _index(table) -> np.ndarray:
    return np.ascontiguousarray(table, dtype=np.uint32)


@compiled
def table_product(table, powers, out):
    """out = table · powers, for as many powers as the table has columns; four rows at a time share their loads."""
    rows, columns = table.shape
    whole = rows - rows % 4
    for i in range(0, whole, 4):
        a, b, c, d = 0.0, 0.0, 0.0, 0.0
        for q in range(columns):
            x = powers[q]
            a += table[i, q] * x
            b += table[i + 1, q] * x
            c += table[i + 2, q] * x
            d += table[i + 3, q] * x
        out[i], out[i + 1], out[i + 2], out[i + 3] = a, b, c, d
    for i in range(whole, rows):
        a = 0.0
        for q in range(columns):
            a += table[i, q] * powers[q]
        out[i] = a


@compiled
def powers_of(x, products, out):
    """out = the closure of x; see `KernelTables` for the products."""
    out[0] = 1.0
    for i in range(len(x)):
        out[1 + i] = x[i]
    for i in range(products.shape[1]):
        out[1 + len(x) + i] = out[products[0, i]] * x[products[1, i]]


@compiled
def _held(free, runs, fields, u_powers, out):
    """out = free, with what each run adds to its columns while the input u is held."""
    for i in range(len(free)):
        copy(free[i], out[i])
    for r in range(len(runs)):
        weight, first, count, offset = u_powers[runs[r, 0]], runs[r, 1], runs[r, 2], runs[r, 3]
        for i in range(len(fields)):
            for k in range(count):
                out[i, first + k] += weight * fields[i, offset + k]


@compiled
def _held_by_input(runs_u, fields, m, u_powers, out):
    """out (n m, ·), the table of ∂f/∂u while u is held."""
    for i in range(out.shape[0]):
        for k in range(out.shape[1]):
            out[i, k] = 0.0
    for r in range(len(runs_u)):
        slope, j = u_powers[runs_u[r, 0]] * runs_u[r, 1], runs_u[r, 2]
        first, count, offset = runs_u[r, 3], runs_u[r, 4], runs_u[r, 5]
        for i in range(len(fields)):
            for k in range(count):
                out[i * m + j, first + k] += slope * fields[i, offset + k]


@compiled
def _within(z, edge, within, slopes):
    """within = s(z) and the slopes of s; see `models.saturation`."""
    for i in range(len(z)):
        over, slopes[i], within[i] = abs(z[i]) / edge[i] - 1.0, 1.0, z[i]
        if over > 0.0:
            bend = np.tanh(2.0 * over)
            within[i], slopes[i] = z[i] * (1.0 + 0.5 * bend) / (1.0 + over), 1.0 - bend * bend


@compiled
def _kept_linear(z, within, linear, k):
    """k, of s(z), becomes that with what is linear in z as it is."""
    for j in range(len(z)):
        if within[j] != z[j]:
            for i in range(len(k)):
                k[i] += linear[i, j] * (z[j] - within[j])


@compiled
def _bent(F, slopes, linear):
    """F (n n,), by s(z), becomes that by z: the linear part whole, the others by the slopes of s."""
    n = len(slopes)
    for j in range(n):
        if slopes[j] < 1.0:
            for i in range(n):
                F[i * n + j] = slopes[j] * F[i * n + j] + (1.0 - slopes[j]) * linear[i, j]


@compiled
def _carried(F, G, S, K, first):
    """K = F S + [0, G], of S = [∂z/∂z_0, ∂z/∂u] (n, n + m), which at first is [1, 0]."""
    n, columns = S.shape
    m = columns - n
    for i in range(n):
        for j in range(m):
            K[i, n + j] = G[i * m + j]
        if first:
            for j in range(n):
                K[i, j] = F[i * n + j]
            continue
        for j in range(n):
            K[i, j] = 0.0
        for r in range(n):
            f = F[i * n + r]
            for j in range(columns):
                K[i, j] += f * S[r, j]


@compiled
def _reach(x, start, total, k, stage, h):
    """x of the next of four stages, or after the last the new x; total gathers the rates k."""
    share, reach = 1.0 if stage % 3 == 0 else 2.0, h if stage == 2 else 0.5 * h
    for i in range(len(x)):
        total[i] += share * k[i]
        x[i] = start[i] + (reach * k[i] if stage < 3 else h / 6.0 * total[i])


@compiled
def _begin(x, start, total):
    """start = x and total = 0."""
    for i in range(len(x)):
        start[i], total[i] = x[i], 0.0


@compiled
def _stepped(x, k, start, total, scheme, stage, h):
    """x after one evaluation k of the dynamics: the next stage, x + h k of an Euler step, or k of a map."""
    if scheme == RUNGE_KUTTA:
        if stage == 0:
            _begin(x, start, total)
        _reach(x, start, total, k, stage, h)
    elif scheme == EULER:
        for i in range(len(x)):
            x[i] += h * k[i]
    else:
        copy(k, x)


@compiled
def rollout(state, inputs, tables):
    """States (N+1, n) and outputs (N, p) from state (n,) under inputs (N, m)."""
    products, u_products, free, runs, fields, _, _, _, _, output, _, linear, edge, _, scheme, h, count = tables
    N, n, m = len(inputs), len(state), inputs.shape[1]
    states, outputs = np.empty((N + 1, n)), np.empty((N, output.shape[0]))
    rate, powers, work = np.empty_like(free), np.empty(1 + n + products.shape[1]), np.empty((5, n))
    k, start, total, within, slopes = work[0], work[1], work[2], work[3], work[4]
    u_powers = np.empty(1 + m + u_products.shape[1])
    copy(state, states[0])
    saturated = len(edge) > 0
    for step in range(N):
        z = states[step + 1]
        copy(states[step], z)
        powers_of(inputs[step], u_products, u_powers)
        _held(free, runs, fields, u_powers, rate)
        for application in range(count):
            if saturated:
                _within(z, edge, within, slopes)
            powers_of(within if saturated else z, products, powers)
            table_product(rate, powers, k)
            if saturated:
                _kept_linear(z, within, linear, k)
            _stepped(z, k, start, total, scheme, application % 4, h)
        powers_of(z, products, powers)
        table_product(output, powers, outputs[step])
    return states, outputs


@compiled
def linearize(state, inputs, tables):
    """States (N+1, n), outputs (N, p), A (N, n, n), B (N, n, m) of every step, C (N, p, n) of the output after it."""
    (products, u_products, free, runs, fields, free_z, runs_z, fields_z, runs_u, output, output_z, linear, edge,
     columns_u, scheme, h, count) = tables
    (N, m), n, p = inputs.shape, len(state), output.shape[0]
    states, outputs = np.empty((N + 1, n)), np.empty((N, p))
    A, B, C = np.empty((N, n, n)), np.empty((N, n, m)), np.empty((N, p, n))
    rate, rate_z, rate_u = np.empty_like(free), np.empty_like(free_z), np.empty((n * m, columns_u))
    powers, u_powers = np.empty(1 + n + products.shape[1]), np.empty(1 + m + u_products.shape[1])
    F, G = np.empty(n * n), np.empty(n * m)
    vectors, work = np.empty((5, n)), np.empty((4, n * (n + m)))
    k, start, total, within, slopes = vectors[0], vectors[1], vectors[2], vectors[3], vectors[4]
    S_start, S_total, flat_S, flat_K = work[0], work[1], work[2], work[3]
    S, K, C_rows = flat_S.reshape(n, n + m), flat_K.reshape(n, n + m), C.reshape(N, p * n)
    copy(state, states[0])
    saturated = len(edge) > 0
    for step in range(N):
        z = states[step + 1]
        copy(states[step], z)
        for i in range(n):
            for j in range(n + m):
                S[i, j] = 1.0 if i == j else 0.0
        powers_of(inputs[step], u_products, u_powers)
        _held(free, runs, fields, u_powers, rate)
        _held(free_z, runs_z, fields_z, u_powers, rate_z)
        _held_by_input(runs_u, fields, m, u_powers, rate_u)
        for application in range(count):
            if saturated:
                _within(z, edge, within, slopes)
            powers_of(within if saturated else z, products, powers)
            table_product(rate, powers, k)
            table_product(rate_z, powers, F)
            table_product(rate_u, powers, G)
            if saturated:
                _kept_linear(z, within, linear, k)
                _bent(F, slopes, linear)
            _carried(F, G, S, K, application == 0)
            _stepped(z, k, start, total, scheme, application % 4, h)
            _stepped(flat_S, flat_K, S_start, S_total, scheme, application % 4, h)
        split(S, A[step], B[step])
        powers_of(z, products, powers)
        table_product(output, powers, outputs[step])
        table_product(output_z, powers, C_rows[step])
    return states, outputs, A, B, C


@compiled
def condense(state, inputs, acting, reference, tables, scale, weight, R):
    """As `condensing.condensed` of the linearization around `acting`, what the plant gets; states and outputs first."""
    states, outputs, A, B, C = linearize(state, acting, tables)
    return states, outputs, *condensed(outputs, A, B, C, reference, inputs, scale, weight, R)


@compiled
def linear_states(state, driven, A):
    """States (N+1, n) of z⁺ = A z + driven[k], driven (N, n)."""
    states = np.empty((len(driven) + 1, len(state)))
    copy(state, states[0])
    for k in range(len(driven)):
        table_product(A, states[k], states[k + 1])
        for i in range(len(state)):
            states[k + 1, i] += driven[k, i]
    return states
