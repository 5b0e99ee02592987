"""The compiled horizon of a polynomial model in continuous time: Runge-Kutta steps with their sensitivities.

Each step carries W = [z, ∂z/∂z_0, ∂z/∂u].
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ssmr_torch.control.condensing import compiled, condensed


class KernelTables(NamedTuple):
    """Coefficients of z^{0:d}, one column per monomial.

    parent, variable: monomial 1 + n + i is monomial parent[i] times z[variable[i]].
    rate (n, ·), output (p, ·): dz/dt without input, and y.   rate_z (n n, ·), output_z (p n, ·): Jacobians.
    field (n m, ·), field_z (m, n n, ·): the control field, and its Jacobian for each input.
    """

    parent: np.ndarray
    variable: np.ndarray
    rate: np.ndarray
    rate_z: np.ndarray
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
    parents, variables, offset = [np.zeros(0, dtype=np.int64)], [np.zeros(0, dtype=np.int64)], 1
    for parent, variable in max(used, key=lambda monomials: monomials.highest).levels:
        parents.append(parent + offset)
        variables.append(variable)
        offset += parent.max() + 1
    field = model.control.reshape(n, -1, m).transpose(0, 2, 1)
    field_z = np.stack([derivative_table(field[:, j, 1:], model.control_monomials) for j in range(m)])
    rate, rate_z = np.insert(model.drift, 0, 0.0, axis=1), derivative_table(model.drift, model.drift_monomials)
    newest = model.parametrization[-p:]
    return KernelTables(
        np.concatenate(parents), np.concatenate(variables), _widened(rate, field.shape[-1]),
        _widened(rate_z, field_z.shape[-1]), field.reshape(n * m, -1), field_z,
        np.insert(newest, 0, 0.0, axis=1), derivative_table(newest, model.parametrization_monomials),
        model.timestep, model.substeps)


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
    """out = table · powers, for as many powers as the table has columns."""
    for i in range(table.shape[0]):
        total = 0.0
        for q in range(table.shape[1]):
            total += table[i, q] * powers[q]
        out[i] = total


@compiled
def _powers(z, tables, out):
    """out = z^{0:d}."""
    n = len(z)
    out[0] = 1.0
    for i in range(n):
        out[1 + i] = z[i]
    for i in range(len(tables.parent)):
        out[n + 1 + i] = out[tables.parent[i]] * z[tables.variable[i]]


@compiled
def _hold_input(u, tables, rate, rate_z):
    """Tables of the rate and of its Jacobian while the input u is held."""
    m = len(u)
    for i in range(rate.shape[0]):
        for q in range(tables.field.shape[1]):
            rate[i, q] = tables.rate[i, q]
            for j in range(m):
                rate[i, q] += tables.field[i * m + j, q] * u[j]
    for i in range(rate_z.shape[0]):
        for q in range(tables.field_z.shape[2]):
            rate_z[i, q] = tables.rate_z[i, q]
            for j in range(m):
                rate_z[i, q] += tables.field_z[j, i, q] * u[j]


@compiled
def _stage(W, tables, rate, rate_z, powers, K):
    """K = dW/dt for W = [z, ∂z/∂z_0, ∂z/∂u]: [f, F ∂z/∂z_0, F ∂z/∂u + G], or f alone where W is z alone."""
    n, columns = W.shape
    _powers(W[:, 0], tables, powers)
    k = np.empty(n)
    table_product(rate, powers, k)
    for i in range(n):
        K[i, 0] = k[i]
    if columns == 1:
        return
    m = columns - 1 - n
    F, G = np.empty(n * n), np.empty(n * m)
    table_product(rate_z, powers, F)
    table_product(tables.field, powers, G)
    for i in range(n):
        for j in range(n):
            K[i, 1 + j] = 0.0
        for j in range(m):
            K[i, 1 + n + j] = G[i * m + j]
        for r in range(n):
            for j in range(1, columns):
                K[i, j] += F[i * n + r] * W[r, j]


@compiled
def _step(W, u, tables, rate, rate_z, powers):
    """W = [z, ∂z/∂z_0, ∂z/∂u] one timestep later, in place: Runge-Kutta of order four with the input held."""
    _hold_input(u, tables, rate, rate_z)
    h = tables.timestep / tables.substeps
    start, total, K = np.empty_like(W), np.empty_like(W), np.empty_like(W)
    for _ in range(tables.substeps):
        start[:] = W
        total[:] = 0.0
        for stage in range(4):
            _stage(W, tables, rate, rate_z, powers, K)
            share = 1.0 if stage == 0 or stage == 3 else 2.0
            reach = h if stage == 2 else 0.5 * h
            for i in range(W.shape[0]):
                for j in range(W.shape[1]):
                    total[i, j] += share * K[i, j]
                    W[i, j] = start[i, j] + (reach * K[i, j] if stage < 3 else h / 6.0 * total[i, j])


@compiled
def rollout(state, inputs, tables):
    """States (N+1, n) and outputs (N, p) from state (n,) under inputs (N, m)."""
    N, n = len(inputs), len(state)
    states, outputs = np.empty((N + 1, n)), np.empty((N, tables.output.shape[0]))
    rate, rate_z = tables.rate.copy(), np.empty((0, 0))
    powers, W = np.empty(1 + n + len(tables.parent)), np.empty((n, 1))
    states[0] = state
    for k in range(N):
        W[:, 0] = states[k]
        _step(W, inputs[k], tables, rate, rate_z, powers)
        states[k + 1] = W[:, 0]
        _powers(states[k + 1], tables, powers)
        table_product(tables.output, powers, outputs[k])
    return states, outputs


@compiled
def linearize(state, inputs, tables):
    """States (N+1, n), outputs (N, p), A (N, n, n), B (N, n, m) of every step, C (N, p, n) of the output after it."""
    N, m = inputs.shape
    n, p = len(state), tables.output.shape[0]
    states, outputs = np.empty((N + 1, n)), np.empty((N, p))
    A, B, C = np.empty((N, n, n)), np.empty((N, n, m)), np.empty((N, p, n))
    rate, rate_z, powers = tables.rate.copy(), tables.rate_z.copy(), np.empty(1 + n + len(tables.parent))
    W = np.zeros((n, 1 + n + m))
    states[0] = state
    for k in range(N):
        W[:] = 0.0
        for i in range(n):
            W[i, 0], W[i, 1 + i] = states[k, i], 1.0
        _step(W, inputs[k], tables, rate, rate_z, powers)
        states[k + 1], A[k], B[k] = W[:, 0], W[:, 1:1 + n], W[:, 1 + n:]
        _powers(states[k + 1], tables, powers)
        table_product(tables.output, powers, outputs[k])
        table_product(tables.output_z, powers, C[k].reshape(-1))
    return states, outputs, A, B, C


@compiled
def condense(state, inputs, acting, reference, tables, scale, weight, R):
    """As `condensing.condensed` of the linearization around `acting`, what the plant gets; states and outputs first."""
    states, outputs, A, B, C = linearize(state, acting, tables)
    return states, outputs, *condensed(outputs, A, B, C, reference, inputs, scale, weight, R)
