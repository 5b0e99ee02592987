"""The compiled horizon of a polynomial model: tables, Runge-Kutta steps with sensitivities, condensing.

Each step carries W = [z, ∂z/∂z_0, ∂z/∂u]; the outputs' sensitivities are summed into the program as they appear.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit


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
    field_z = np.stack([_derivative(field[:, j, 1:], model.control_monomials) for j in range(m)])
    rate, rate_z = np.insert(model.drift, 0, 0.0, axis=1), _derivative(model.drift, model.drift_monomials)
    newest = model.parametrization[-p:]
    return KernelTables(
        np.concatenate(parents), np.concatenate(variables), _widened(rate, field.shape[-1]),
        _widened(rate_z, field_z.shape[-1]), field.reshape(n * m, -1), field_z,
        np.insert(newest, 0, 0.0, axis=1), _derivative(newest, model.parametrization_monomials),
        model.timestep, model.substeps)


def _derivative(table: np.ndarray, monomials) -> np.ndarray:
    """Jacobian of table · z^{1:d} as a table of z^{0:d−1}: (rows, q) → (rows n, ·)."""
    derivative = np.zeros((len(table), monomials.variables, 1 + monomials.derivative_index.max(initial=-1)))
    for monomial, j in np.argwhere(monomials.exponents):
        position = monomials.derivative_index[monomial, j]
        derivative[:, j, position] += monomials.exponents[monomial, j] * table[:, monomial]
    return derivative.reshape(len(table) * monomials.variables, -1)


def _widened(table: np.ndarray, columns: int) -> np.ndarray:
    return np.pad(table, ((0, 0), (0, max(0, columns - table.shape[1]))))


# Sums may be reordered, but NaN and infinity must keep their meaning: they say that a rollout diverged.
compiled = njit(cache=True, fastmath={"reassoc", "contract"})


@compiled
def _product(table, powers, out):
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
    _product(rate, powers, k)
    for i in range(n):
        K[i, 0] = k[i]
    if columns == 1:
        return
    m = columns - 1 - n
    F, G = np.empty(n * n), np.empty(n * m)
    _product(rate_z, powers, F)
    _product(tables.field, powers, G)
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
        _product(tables.output, powers, outputs[k])
    return states, outputs


@compiled
def condense(state, inputs, reference, tables, weight, R, scale):
    """The fields of `Condensed`, with stage weights (N, p), input weights R (m,) and input scale (m,).

    Only the lower triangle of the hessian is summed, over the inputs up to each step; later ones have no effect.
    """
    N, m = inputs.shape
    n, p = len(state), tables.output.shape[0]
    states, outputs = np.empty((N + 1, n)), np.empty((N, p))
    hessian, gradient = np.zeros((N * m, N * m)), np.empty(N * m)
    rate, rate_z, powers = tables.rate.copy(), tables.rate_z.copy(), np.empty(1 + n + len(tables.parent))
    W, C, S, Y = np.zeros((n, 1 + n + m)), np.empty(p * n), np.zeros((n, N * m)), np.empty(N * m)
    states[0] = state
    for k in range(N):
        W[:] = 0.0
        for i in range(n):
            W[i, 0], W[i, 1 + i] = states[k, i], 1.0
        _step(W, inputs[k], tables, rate, rate_z, powers)
        S = _propagate(W, S, k, scale)
        states[k + 1] = W[:, 0]
        _powers(states[k + 1], tables, powers)
        _product(tables.output, powers, outputs[k])
        _product(tables.output_z, powers, C)
        for j in range(m):
            gradient[k * m + j] = R[j] * inputs[k, j] / scale[j]
            hessian[k * m + j, k * m + j] += R[j]
        for o in range(p):
            if weight[k, o] != 0.0:
                _add_output(weight[k, o], outputs[k, o] - reference[k, o], C[o * n:(o + 1) * n], S,
                            Y[:(k + 1) * m], hessian, gradient)
    for i in range(N * m):
        for j in range(i):
            hessian[j, i] = hessian[i, j]
    return states, outputs, hessian, gradient


@compiled
def _propagate(W, S, k, scale):
    """∂z_{k+1}/∂v from S = ∂z_k/∂v: A S, and B in the columns of v_k, with W = [z, A, B]."""
    n, m = len(W), len(scale)
    following = np.zeros_like(S)
    for i in range(n):
        for r in range(n):
            for j in range(k * m):
                following[i, j] += W[i, 1 + r] * S[r, j]
        for j in range(m):
            following[i, k * m + j] = W[i, 1 + n + j] * scale[j]
    return following


@compiled
def _add_output(weight, error, C, S, Y, hessian, gradient):
    """Add ½ weight (error + Y Δv)² to the lower triangle of the hessian and to the gradient, with Y = C S."""
    Y[:] = 0.0
    for r in range(len(C)):
        for j in range(len(Y)):
            Y[j] += C[r] * S[r, j]
    for i in range(len(Y)):
        gradient[i] += weight * error * Y[i]
        for j in range(i + 1):
            hessian[i, j] += weight * Y[i] * Y[j]
