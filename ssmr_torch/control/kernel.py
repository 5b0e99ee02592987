"""The compiled horizon of a polynomial model in continuous time: Runge-Kutta steps with their sensitivities.

Each step carries z, ∂z/∂z_0 and ∂z/∂u.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ssmr_torch.control.condensing import compiled, condensed, copy, split


class KernelTables(NamedTuple):
    """Coefficients of z^{0:d}, one column per monomial.

    parent, variable: monomial 1 + n + i is monomial parent[i] times z[variable[i]]; unsigned, which indexes faster.
    rate (n, ·), output (p, ·): dz/dt without input, and y.   rate_z (n n, ·), output_z (p n, ·): Jacobians.
    rate_u (n m, ·): ∂(dz/dt)/∂u.   field (m, n, ·), field_z (m, n n, ·): what each input adds to rate
    and rate_z.
    """

    parent: np.ndarray
    variable: np.ndarray
    rate: np.ndarray
    rate_z: np.ndarray
    rate_u: np.ndarray
    field: np.ndarray
    field_z: np.ndarray
    output: np.ndarray
    output_z: np.ndarray
    timestep: float
    substeps: int


def tables_of(model) -> KernelTables:
    """The kernel's tables of a polynomial model (`PolynomialTables`), Jacobians differentiated analytically."""
    n, m, p = model.state_dim, model.input_dim, model.output_dim
    used = (model.drift_monomials, model.control_monomials, model.parametrization_monomials)
    parent, variable = parents_of(max(used, key=lambda monomials: monomials.highest))
    field = np.ascontiguousarray(model.control.reshape(n, -1, m).transpose(2, 0, 1))
    field_z = np.stack([derivative_table(field[j, :, 1:], model.control_monomials) for j in range(m)])
    rate, rate_z = np.insert(model.drift, 0, 0.0, axis=1), derivative_table(model.drift, model.drift_monomials)
    newest = model.parametrization[-p:]
    return KernelTables(
        parent, variable, _widened(rate, field.shape[-1]), _widened(rate_z, field_z.shape[-1]),
        field.transpose(1, 0, 2).reshape(n * m, -1), field, field_z,
        np.insert(newest, 0, 0.0, axis=1), derivative_table(newest, model.parametrization_monomials),
        model.timestep, model.substeps)


def parents_of(monomials) -> tuple[np.ndarray, np.ndarray]:
    """parent and variable of all monomials beyond the linear ones, see `KernelTables`; none for linear ones."""
    parents, variables, offset = [np.zeros(0, dtype=np.int64)], [np.zeros(0, dtype=np.int64)], 1
    for parent, variable in monomials.levels:
        parents.append(parent + offset)
        variables.append(variable)
        offset += parent.max() + 1
    return np.concatenate(parents).astype(np.uint32), np.concatenate(variables).astype(np.uint32)


def derivative_table(table: np.ndarray, monomials) -> np.ndarray:
    """Jacobian of table · z^{1:d} as a table of z^{0:d−1}: (rows, q) → (rows n, ·)."""
    derivative = np.zeros((len(table), monomials.variables, 1 + monomials.derivative_index.max(initial=-1)))
    for monomial, j in np.argwhere(monomials.exponents):
        position = monomials.derivative_index[monomial, j]
        derivative[:, j, position] += monomials.exponents[monomial, j] * table[:, monomial]
    return derivative.reshape(len(table) * monomials.variables, -1)


def _widened(table: np.ndarray, columns: int) -> np.ndarray:
    return np.pad(table, ((0, 0), (0, max(0, columns - table.shape[1]))))


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
def powers_of(x, parent, variable, out):
    """out = x^{0:d}; see `KernelTables` for parent and variable."""
    out[0] = 1.0
    for i in range(len(x)):
        out[1 + i] = x[i]
    for i in range(len(parent)):
        out[1 + len(x) + i] = out[parent[i]] * x[variable[i]]


@compiled
def _held(table, field, u, out):
    """out = table while the input u is held: its first columns with Σ_j u_j field_j added, field (m, rows, ·)."""
    for i in range(len(table)):
        copy(table[i], out[i])
    for j in range(field.shape[0]):
        for i in range(field.shape[1]):
            for q in range(field.shape[2]):
                out[i, q] += u[j] * field[j, i, q]


@compiled
def _reach(x, start, total, k, stage, h):
    """x of the next of four stages, or after the last the new x; total gathers the rates k."""
    share, reach = 1.0 if stage % 3 == 0 else 2.0, h if stage == 2 else 0.5 * h
    for i in range(len(x)):
        total[i] += share * k[i]
        x[i] = start[i] + (reach * k[i] if stage < 3 else h / 6.0 * total[i])


@compiled
def begin(x, start, total):
    """start = x and total = 0."""
    for i in range(len(x)):
        start[i], total[i] = x[i], 0.0


@compiled
def _advance(z, h, substeps, rate, parent, variable, powers, k, start, total):
    """z one timestep later, in place: Runge-Kutta of order four with the input held."""
    for _ in range(substeps):
        begin(z, start, total)
        for stage in range(4):
            powers_of(z, parent, variable, powers)
            table_product(rate, powers, k)
            _reach(z, start, total, k, stage, h)


@compiled
def rollout(state, inputs, tables):
    """States (N+1, n) and outputs (N, p) from state (n,) under inputs (N, m)."""
    parent, variable, free, _, _, field, _, output, _, timestep, substeps = tables
    N, n = len(inputs), len(state)
    states, outputs = np.empty((N + 1, n)), np.empty((N, output.shape[0]))
    rate, powers, work = np.empty_like(free), np.empty(1 + n + len(parent)), np.empty((3, n))
    k, start, total = work[0], work[1], work[2]
    copy(state, states[0])
    for step in range(N):
        z = states[step + 1]
        copy(states[step], z)
        _held(free, field, inputs[step], rate)
        _advance(z, timestep / substeps, substeps, rate, parent, variable, powers, k, start, total)
        powers_of(z, parent, variable, powers)
        table_product(output, powers, outputs[step])
    return states, outputs


@compiled
def _rates(z, S, rate, rate_z, rate_u, parent, variable, powers, k, F, G, K):
    """k = dz/dt (n,) and K = dS/dt = F S + [0, G] of S = [∂z/∂z_0, ∂z/∂u], (n, n + m)."""
    n, columns = S.shape
    m = columns - n
    powers_of(z, parent, variable, powers)
    table_product(rate, powers, k)
    table_product(rate_z, powers, F)
    table_product(rate_u, powers, G)
    for i in range(n):
        for j in range(n):
            K[i, j] = 0.0
        for j in range(m):
            K[i, n + j] = G[i * m + j]
        for r in range(n):
            f = F[i * n + r]
            for j in range(columns):
                K[i, j] += f * S[r, j]


@compiled
def linearize(state, inputs, tables):
    """States (N+1, n), outputs (N, p), A (N, n, n), B (N, n, m) of every step, C (N, p, n) of the output after it."""
    parent, variable, free, free_z, rate_u, field, field_z, output, output_z, timestep, substeps = tables
    (N, m), n, p, h = inputs.shape, len(state), output.shape[0], timestep / substeps
    states, outputs = np.empty((N + 1, n)), np.empty((N, p))
    A, B, C = np.empty((N, n, n)), np.empty((N, n, m)), np.empty((N, p, n))
    rate, rate_z, powers = np.empty_like(free), np.empty_like(free_z), np.empty(1 + n + len(parent))
    k, F, G = np.empty(n), np.empty(n * n), np.empty(n * m)
    start, total, work = np.empty(n), np.empty(n), np.empty((4, n * (n + m)))
    S_start, S_total, flat_S, flat_K = work[0], work[1], work[2], work[3]
    S, K, C_rows = flat_S.reshape(n, n + m), flat_K.reshape(n, n + m), C.reshape(N, p * n)
    copy(state, states[0])
    for step in range(N):
        z = states[step + 1]
        copy(states[step], z)
        for i in range(n):
            for j in range(n + m):
                S[i, j] = 1.0 if i == j else 0.0
        _held(free, field, inputs[step], rate)
        _held(free_z, field_z, inputs[step], rate_z)
        for _ in range(substeps):
            begin(z, start, total)
            begin(flat_S, S_start, S_total)
            for stage in range(4):
                _rates(z, S, rate, rate_z, rate_u, parent, variable, powers, k, F, G, K)
                _reach(z, start, total, k, stage, h)
                _reach(flat_S, S_start, S_total, flat_K, stage, h)
        split(S, A[step], B[step])
        powers_of(z, parent, variable, powers)
        table_product(output, powers, outputs[step])
        table_product(output_z, powers, C_rows[step])
    return states, outputs, A, B, C


@compiled
def condense(state, inputs, acting, reference, tables, scale, weight, R):
    """As `condensing.condensed` of the linearization around `acting`, what the plant gets; states and outputs first."""
    states, outputs, A, B, C = linearize(state, acting, tables)
    return states, outputs, *condensed(outputs, A, B, C, reference, inputs, scale, weight, R)
