"""The compiled horizon of a polynomial model: rollout and sensitivities of every step, computed from its forms.

A step evaluates the dynamics several times with the input held: four stages of Runge-Kutta per substep, an Euler step,
or a map. It carries z and S = [∂z/∂z_0, ∂z/∂u] along. The held input is folded into the tables once per step.
"""

from __future__ import annotations

import numpy as np

from ssmr_torch.control.condensing import compiled, condensed, copy, split
from ssmr_torch.control.horizon_kernel_outputs import count_outputs, place, place_slopes
from ssmr_torch.control.horizon_kernel_tables import tables_of
from ssmr_torch.models.structure import SCHEMES

RUNGE_KUTTA, EULER = SCHEMES.index("runge_kutta"), SCHEMES.index("euler")


def compiled_polynomial(model) -> tuple | None:
    """Tables, `rollout` and `condense` of a `PolynomialModel`; None for a model with re-lifting, or with output
    coordinates of a user.
    """
    foreign = model.coordinates is not None and model.coordinates.markers() is None
    return None if model.structure.relift or foreign else (tuple(tables_of(model)), rollout, condense)


@compiled
def table_product(table, powers, out):
    """out = table · powers, for as many powers as the table has columns. Four rows at a time share their loads."""
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
def _weights(terms, u_powers, weights):
    """The weight of each term while the input u is held."""
    for e in range(len(terms)):
        weights[e] = u_powers[terms[e, 0]] * terms[e, 1]


@compiled
def _held(free, columns, weights, fields, out):
    """out = the columns that the input changes: the columns of `free` plus their terms."""
    for c in range(len(columns)):
        column, first, count = columns[c, 0], columns[c, 1], columns[c, 2]
        for i in range(len(fields)):
            total = free[i, column]
            for e in range(first, first + count):
                total += weights[e] * fields[i, e]
            out[i, column] = total


@compiled
def _saturate(edge, x, slopes):
    """Replace z, the first entries of x, by s(z); slopes = the slopes of s. See `models.saturation`."""
    for i in range(len(edge)):
        over, slopes[i] = abs(x[i]) / edge[i] - 1.0, 1.0
        if over > 0.0:
            bend = np.tanh(2.0 * over)
            x[i], slopes[i] = x[i] * (1.0 + 0.5 * bend) / (1.0 + over), 1.0 - bend * bend


@compiled
def _keep_linear(z, within, linear, k):
    """Correct k, computed with s(z): its linear part must use z itself."""
    for j in range(len(z)):
        if within[j] != z[j]:
            for i in range(len(k)):
                k[i] += linear[i, j] * (z[j] - within[j])


@compiled
def _bend(F, slopes, linear):
    """Turn F (n n,), the derivative by s(z), into that by z: the linear part unchanged, the rest times the slopes."""
    n = len(slopes)
    for j in range(n):
        if slopes[j] < 1.0:
            for i in range(n):
                F[i * n + j] = slopes[j] * F[i * n + j] + (1.0 - slopes[j]) * linear[i, j]


@compiled
def _carried(F, G, S, K, first):
    """K = F S + [0, G], for S = [∂z/∂z_0, ∂z/∂u] (n, n + m), which is [1, 0] at first."""
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
    """x of the next of four stages, or after the last one the new x; total sums up the rates k."""
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
    """x after one evaluation k of the dynamics: the next stage, or x + h k for an Euler step, or k for a map."""
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
def _observe(output, powers, markers, xi, y):
    """y of a state, from its powers. Where there are markers, xi is filled: the coordinates and three more entries."""
    if len(markers):
        table_product(output, powers, xi)
        place(markers, xi, xi[len(output):], y)
    else:
        table_product(output, powers, y)


@compiled
def _observe_slopes(output_z, powers, markers, xi, D, C):
    """C (p, n) = ∂y/∂z there, after `_observe`. Where there are markers, D (p', n) is filled."""
    if len(markers):
        table_product(output_z, powers, D.reshape(D.size))
        place_slopes(markers, xi, D, xi[len(D):], C)
    else:
        table_product(output_z, powers, C.reshape(C.size))


@compiled
def rollout(state, inputs, tables):
    """States (N+1, n) and outputs (N, p) from state (n,) under inputs (N, m)."""
    (products, u_products, free, columns, terms, fields, _, _, _, _, _, _, _, _, output, _, linear, edge, variables,
     markers, scheme, h, count) = tables
    N, n, m = len(inputs), len(state), inputs.shape[1]
    states, outputs = np.empty((N + 1, n)), np.empty((N, count_outputs(markers, output.shape[0])))
    rate, powers, work = free.copy(), np.empty(1 + variables + products.shape[1]), np.empty((4, n))
    k, start, total, slopes, x = work[0], work[1], work[2], work[3], np.zeros(n + m)
    xi = np.empty(output.shape[0] + 3) if len(markers) else k
    within, u_powers, weights = x[:variables], np.empty(1 + m + u_products.shape[1]), np.empty(len(terms))
    copy(state, states[0])
    for step in range(N):
        z = states[step + 1]
        copy(states[step], z)
        copy(inputs[step], x[n:])
        powers_of(inputs[step], u_products, u_powers)
        _weights(terms, u_powers, weights)
        _held(free, columns, weights, fields, rate)
        for application in range(count):
            copy(z, within)
            if len(edge):
                _saturate(edge, within, slopes)
            powers_of(within, products, powers)
            table_product(rate, powers, k)
            if len(edge):
                _keep_linear(z, within, linear, k)
            _stepped(z, k, start, total, scheme, application % 4, h)
        copy(z, within)
        powers_of(within, products, powers)
        _observe(output, powers, markers, xi, outputs[step])
    return states, outputs


@compiled
def linearize(state, inputs, tables):
    """States (N+1, n), outputs (N, p), A (N, n, n), B (N, n, m) of every step, C (N, p, n) of the output after it."""
    (products, u_products, free, columns, terms, fields, free_z, columns_z, terms_z, fields_z, free_u, columns_u,
     terms_u, fields_u, output, output_z, linear, edge, variables, markers, scheme, h, count) = tables
    (N, m), n, latent = inputs.shape, len(state), output.shape[0]
    p = count_outputs(markers, latent)
    states, outputs = np.empty((N + 1, n)), np.empty((N, p))
    A, B, C = np.empty((N, n, n)), np.empty((N, n, m)), np.empty((N, p, n))
    rate, rate_z, rate_u = free.copy(), free_z.copy(), free_u.copy()
    weights, weights_z, weights_u = np.empty(len(terms)), np.empty(len(terms_z)), np.empty(len(terms_u))
    powers, u_powers = np.empty(1 + variables + products.shape[1]), np.empty(1 + m + u_products.shape[1])
    F, G, by_input, x = np.empty(n * n), np.empty(n * m), rate_u.reshape(n * m, -1), np.zeros(n + m)
    vectors, work = np.empty((4, n)), np.empty((4, n * (n + m)))
    k, start, total, slopes, within = vectors[0], vectors[1], vectors[2], vectors[3], x[:variables]
    S_start, S_total, flat_S, flat_K = work[0], work[1], work[2], work[3]
    S, K = flat_S.reshape(n, n + m), flat_K.reshape(n, n + m)
    xi, D = (np.empty(latent + 3), np.empty((latent, n))) if len(markers) else (k, S)
    copy(state, states[0])
    for step in range(N):
        z = states[step + 1]
        copy(states[step], z)
        copy(inputs[step], x[n:])
        for i in range(n):
            for j in range(n + m):
                S[i, j] = 1.0 if i == j else 0.0
        powers_of(inputs[step], u_products, u_powers)
        _weights(terms, u_powers, weights)
        _held(free, columns, weights, fields, rate)
        _weights(terms_z, u_powers, weights_z)
        _held(free_z, columns_z, weights_z, fields_z, rate_z)
        _weights(terms_u, u_powers, weights_u)
        _held(free_u, columns_u, weights_u, fields_u, rate_u)
        for application in range(count):
            copy(z, within)
            if len(edge):
                _saturate(edge, within, slopes)
            powers_of(within, products, powers)
            table_product(rate, powers, k)
            table_product(rate_z, powers, F)
            table_product(by_input, powers, G)
            if len(edge):
                _keep_linear(z, within, linear, k)
                _bend(F, slopes, linear)
            _carried(F, G, S, K, application == 0)
            _stepped(z, k, start, total, scheme, application % 4, h)
            _stepped(flat_S, flat_K, S_start, S_total, scheme, application % 4, h)
        split(S, A[step], B[step])
        copy(z, within)
        powers_of(within, products, powers)
        _observe(output, powers, markers, xi, outputs[step])
        _observe_slopes(output_z, powers, markers, xi, D, C[step])
    return states, outputs, A, B, C


@compiled
def condense(state, inputs, acting, reference, tables, scale, weight, R):
    """`condensing.condensed` of the linearization around `acting`, the inputs that act; states and outputs first."""
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
