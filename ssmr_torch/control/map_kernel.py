"""The compiled horizons of models in discrete time: polynomial in state and input together, bilinear, and linear.

A step covers `repeats` applications of the map; its Jacobians follow by the chain rule.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ssmr_torch.control.condensing import compiled, condensed, copy, split
from ssmr_torch.control.kernel import derivative_table, parents_of, powers_of, table_product


class MapTables(NamedTuple):
    """z⁺ = advance · (z, u)^{0:d},   y = output · z^{0:d_w}; the nonlinear terms of z⁺ see s(z), see `saturation`.

    parent, variable: monomial 1 + (n + m) + i of (z, u) is monomial parent[i] times entry variable[i]; output_parent,
    output_variable: the same of z alone. advance (n, ·) and output (p, ·), advance_x (n (n + m), ·) and
    output_z (p n, ·): their Jacobians. edge (n,): of s, infinite where nothing saturates.
    """

    parent: np.ndarray
    variable: np.ndarray
    output_parent: np.ndarray
    output_variable: np.ndarray
    advance: np.ndarray
    advance_x: np.ndarray
    output: np.ndarray
    output_z: np.ndarray
    edge: np.ndarray
    repeats: int


class BilinearTables(NamedTuple):
    """z⁺ = A z + B u + Σ_j u_j N_j z,   y = C z, with N (m, n, n)."""

    A: np.ndarray
    B: np.ndarray
    N: np.ndarray
    C: np.ndarray
    repeats: int


def map_tables(model, repeats: int) -> MapTables:
    """The kernel's tables of a `ControlAugmentedTables`, Jacobians differentiated analytically."""
    joint, seen, n = model.dynamics_monomials, model.parametrization_monomials, model.state_dim
    chosen = np.arange(len(joint)) if joint.chosen is None else joint.chosen
    advance = np.zeros((n, 2 + chosen.max()))
    advance[:, 1 + chosen] = model.base_timestep * model.dynamics
    advance[:, 1:1 + n] += np.eye(n)
    rate_x = derivative_table(model.base_timestep * model.dynamics, joint)
    rate_x.reshape(n, n + model.input_dim, -1)[range(n), range(n), 0] += 1.0
    output = np.insert(model.parametrization, 0, 0.0, axis=1)
    return MapTables(*parents_of(joint), *parents_of(seen), advance, rate_x, output,
                     derivative_table(model.parametrization, seen), model.edge, repeats)


def bilinear_tables(model, repeats: int) -> BilinearTables:
    """The kernel's tables of `KoopmanTables` whose observables are not lifted anew."""
    N = model.N if len(model.N) else np.zeros((model.input_dim, model.state_dim, model.state_dim))
    return BilinearTables(model.A, model.B, N, model.read_out, repeats)


@compiled
def _chain(J, A, B, n, m, first):
    """A ← J_z A,  B ← J_z B + J_u, of one application more; J (n (n + m),) of this one."""
    J = J.reshape(n, n + m)
    if first:
        split(J, A, B)
        return
    before_A, before_B = A.copy(), B.copy()
    for i in range(n):
        for j in range(n):
            A[i, j] = 0.0
        for j in range(m):
            B[i, j] = J[i, n + j]
        for r in range(n):
            for j in range(n):
                A[i, j] += J[i, r] * before_A[r, j]
            for j in range(m):
                B[i, j] += J[i, r] * before_B[r, j]


@compiled
def _saturated_powers(x, tables, within, slopes, powers):
    """powers = (s(z), u)^{0:d} of x = (z, u), with within = (s(z), u) and the slopes of s (n,)."""
    copy(x, within)
    for i in range(len(slopes)):
        over, slopes[i] = abs(x[i]) / tables.edge[i] - 1.0, 1.0
        if over > 0.0:
            bend = np.tanh(2.0 * over)
            within[i], slopes[i] = x[i] * (1.0 + 0.5 * bend) / (1.0 + over), 1.0 - bend * bend
    powers_of(within, tables.parent, tables.variable, powers)


@compiled
def _unsaturated(x, n, powers):
    """What is linear in z stays so: its powers are those of z again."""
    for i in range(n):
        powers[1 + i] = x[i]


@compiled
def _linear_beyond(tables, slopes, n, m, J):
    """J (n (n + m),), by s(z), becomes that by z: the linear part whole, the others by the slopes of s."""
    for j in range(n):
        if slopes[j] < 1.0:
            for i in range(n):
                at = i * (n + m) + j
                J[at] = slopes[j] * J[at] + (1.0 - slopes[j]) * tables.advance[i, 1 + j]


@compiled
def rollout_map(state, inputs, tables):
    """States (N+1, n) and outputs (N, p) from state (n,) under inputs (N, m)."""
    N, m = inputs.shape
    n, p = len(state), tables.output.shape[0]
    states, outputs = np.empty((N + 1, n)), np.empty((N, p))
    x, within, powers = np.empty(n + m), np.empty(n + m), np.empty(1 + n + m + len(tables.parent))
    seen, slopes = np.empty(1 + n + len(tables.output_parent)), np.empty(n)
    copy(state, states[0])
    copy(state, x)
    for k in range(N):
        copy(inputs[k], x[n:])
        for _ in range(tables.repeats):
            _saturated_powers(x, tables, within, slopes, powers)
            _unsaturated(x, n, powers)
            table_product(tables.advance, powers, x[:n])
        copy(x[:n], states[k + 1])
        powers_of(x[:n], tables.output_parent, tables.output_variable, seen)
        table_product(tables.output, seen, outputs[k])
    return states, outputs


@compiled
def linearize_map(state, inputs, tables):
    """States (N+1, n), outputs (N, p), A (N, n, n), B (N, n, m) of every step, C (N, p, n) of the output after it."""
    N, m = inputs.shape
    n, p = len(state), tables.output.shape[0]
    states, outputs = np.empty((N + 1, n)), np.empty((N, p))
    A, B, C = np.empty((N, n, n)), np.empty((N, n, m)), np.empty((N, p, n))
    x, within, powers = np.empty(n + m), np.empty(n + m), np.empty(1 + n + m + len(tables.parent))
    seen, J, slopes = np.empty(1 + n + len(tables.output_parent)), np.empty(n * (n + m)), np.empty(n)
    copy(state, states[0])
    copy(state, x)
    for k in range(N):
        copy(inputs[k], x[n:])
        for repeat in range(tables.repeats):
            _saturated_powers(x, tables, within, slopes, powers)
            table_product(tables.advance_x, powers, J)
            _linear_beyond(tables, slopes, n, m, J)
            _chain(J, A[k], B[k], n, m, repeat == 0)
            _unsaturated(x, n, powers)
            table_product(tables.advance, powers, x[:n])
        copy(x[:n], states[k + 1])
        powers_of(x[:n], tables.output_parent, tables.output_variable, seen)
        table_product(tables.output, seen, outputs[k])
        table_product(tables.output_z, seen, C[k].reshape(-1))
    return states, outputs, A, B, C


@compiled
def _bilinear_jacobian(z, u, tables, J):
    """J (n (n + m),) = [A + Σ_j u_j N_j, B + [N_j z]]."""
    n, m = tables.B.shape
    for i in range(n):
        for j in range(m):
            J[i * (n + m) + n + j] = tables.B[i, j]
        for r in range(n):
            total = tables.A[i, r]
            for j in range(m):
                total += u[j] * tables.N[j, i, r]
                J[i * (n + m) + n + j] += tables.N[j, i, r] * z[r]
            J[i * (n + m) + r] = total


@compiled
def linearize_bilinear(state, inputs, tables):
    """As `linearize_map`."""
    N, m = inputs.shape
    n, p = len(state), tables.C.shape[0]
    states, outputs = np.empty((N + 1, n)), np.empty((N, p))
    A, B, C, J = np.empty((N, n, n)), np.empty((N, n, m)), np.empty((N, p, n)), np.empty(n * (n + m))
    copy(state, states[0])
    for k in range(N):
        z = states[k].copy()
        for repeat in range(tables.repeats):
            _bilinear_jacobian(z, inputs[k], tables, J)
            _chain(J, A[k], B[k], n, m, repeat == 0)
            here = J.reshape(n, n + m)
            following = np.zeros(n)
            for i in range(n):
                for r in range(n):
                    following[i] += here[i, r] * z[r]
                for j in range(m):
                    following[i] += tables.B[i, j] * inputs[k, j]
            z = following
        copy(z, states[k + 1])
        copy(tables.C.reshape(-1), C[k].reshape(-1))
        table_product(tables.C, z, outputs[k])
    return states, outputs, A, B, C


@compiled
def rollout_bilinear(state, inputs, tables):
    """As `rollout_map`."""
    N, m = inputs.shape
    n, p = len(state), tables.C.shape[0]
    states, outputs = np.empty((N + 1, n)), np.empty((N, p))
    copy(state, states[0])
    for k in range(N):
        z = states[k].copy()
        for _ in range(tables.repeats):
            following = np.zeros(n)
            for i in range(n):
                for r in range(n):
                    total = tables.A[i, r]
                    for j in range(m):
                        total += inputs[k, j] * tables.N[j, i, r]
                    following[i] += total * z[r]
                for j in range(m):
                    following[i] += tables.B[i, j] * inputs[k, j]
            z = following
        copy(z, states[k + 1])
        table_product(tables.C, z, outputs[k])
    return states, outputs


@compiled
def condense_map(state, inputs, acting, reference, tables, scale, weight, R):
    """As `kernel.condense`."""
    states, outputs, A, B, C = linearize_map(state, acting, tables)
    return states, outputs, *condensed(outputs, A, B, C, reference, inputs, scale, weight, R)


@compiled
def condense_bilinear(state, inputs, acting, reference, tables, scale, weight, R):
    """As `kernel.condense`."""
    states, outputs, A, B, C = linearize_bilinear(state, acting, tables)
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
