"""Compiled functions that turn linearizations along the horizon into a quadratic program in the inputs."""

from __future__ import annotations

import numpy as np

from ssmr_torch import compiled_functions

# Sums may be reordered, but NaN and infinity must keep their meaning: they show that a rollout diverged.
compiled = compiled_functions.compiled(fastmath={"reassoc", "contract"})


# Loops and no slices: numba needs four more seconds to compile `a[:] = b`.
@compiled
def copy(x, out):
    """out = x, for all entries of out."""
    for i in range(len(x)):
        out[i] = x[i]


@compiled
def split(J, A, B):
    """A = J[:, :n], B = J[:, n:], A (n, n)."""
    n = len(A)
    for i in range(n):
        copy(J[i, :n], A[i])
        copy(J[i, n:], B[i])


@compiled
def sensitivities(A, B, C, scale):
    """Y (N, p, N m) = ∂y_k/∂v and Z (N, p, n) = ∂y_k/∂z_0 for y_1 … y_N, where v = u / scale.

    A (N, n, n), B (N, n, m), C (N, p, n): of each step, and of the output after it.   scale: (m,).
    """
    N, n, m = B.shape
    p = C.shape[1]
    Y, Z = np.zeros((N, p, N * m)), np.zeros((N, p, n))
    columns = n + N * m
    S, following = np.zeros((n, columns)), np.zeros((n, columns))
    for i in range(n):
        S[i, i] = 1.0
    for k in range(N):
        used = n + k * m
        for i in range(n):
            for j in range(used):
                following[i, j] = 0.0
            for r in range(n):
                a = A[k, i, r]
                for j in range(used):
                    following[i, j] += a * S[r, j]
            for j in range(m):
                following[i, used + j] = B[k, i, j] * scale[j]
        S, following = following, S
        for o in range(p):
            for r in range(n):
                c = C[k, o, r]
                if c != 0.0:
                    for j in range(n):
                        Z[k, o, j] += c * S[r, j]
                    for j in range((k + 1) * m):
                        Y[k, o, j] += c * S[r, n + j]
    return Y, Z


@compiled
def gauss_newton(Y, weight, R):
    """2 (Σ_k Y_kᵀ Q_k Y_k + R) with weight (N, p) = 2 Q and R (m,) = 2 R, both divided by the cost's scale."""
    N, p, size = Y.shape
    m = len(R)
    hessian = np.zeros((size, size))
    for k in range(N):
        for o in range(p):
            w = weight[k, o]
            if w != 0.0:
                for i in range((k + 1) * m):
                    y = w * Y[k, o, i]
                    for j in range(i + 1):
                        hessian[i, j] += y * Y[k, o, j]
    for i in range(size):
        hessian[i, i] += R[i % m]
        for j in range(i):
            hessian[j, i] = hessian[i, j]
    return hessian


@compiled
def gradient(Y, outputs, reference, weight, R, inputs, scale):
    """2 (Σ_k Y_kᵀ Q_k e_k + R v) for errors e = outputs − reference (N, p), inputs (N, m); scaled as `gauss_newton`."""
    N, p, size = Y.shape
    m = len(R)
    total = np.empty(size)
    for i in range(size):
        total[i] = R[i % m] * inputs[i // m, i % m] / scale[i % m]
    for k in range(N):
        for o in range(p):
            w = weight[k, o]
            if w != 0.0:
                w *= outputs[k, o] - reference[k, o]
                for i in range((k + 1) * m):
                    total[i] += w * Y[k, o, i]
    return total


@compiled
def around(hessian, gradient, inputs, scale):
    """gradient − hessian · v (N m,), v = inputs / scale: the linear term of the program in v itself."""
    m, size = len(scale), len(gradient)
    linear = gradient.copy()
    for j in range(size):
        v = inputs[j // m, j % m] / scale[j % m]
        for i in range(size):
            linear[i] -= hessian[j, i] * v
    return linear


@compiled
def condensed(outputs, A, B, C, reference, inputs, scale, weight, R):
    """All at once: hessian, gradient, linear, Y, Z, of `gauss_newton`, `gradient`, `around` and `sensitivities`."""
    Y, Z = sensitivities(A, B, C, scale)
    hessian = gauss_newton(Y, weight, R)
    slope = gradient(Y, outputs, reference, weight, R, inputs, scale)
    return hessian, slope, around(hessian, slope, inputs, scale), Y, Z


@compiled
def tracking_cost(outputs, inputs, reference, weight, input_weight):
    """Σ_k ‖y_k − ŷ_k‖²_Q + ‖u_k‖²_R with weight (N, p) and input_weight (m,)."""
    cost = 0.0
    for k in range(outputs.shape[0]):
        for o in range(outputs.shape[1]):
            error = outputs[k, o] - reference[k, o]
            cost += weight[k, o] * error * error
    for k in range(inputs.shape[0]):
        for j in range(inputs.shape[1]):
            cost += input_weight[j] * inputs[k, j] * inputs[k, j]
    return cost


@compiled
def clipped(inputs, bounds):
    """The inputs (N, m) clipped to the bounds (2, m); NaN stays NaN."""
    moved = inputs.copy()
    for k in range(inputs.shape[0]):
        for j in range(inputs.shape[1]):
            if moved[k, j] < bounds[0, j]:
                moved[k, j] = bounds[0, j]
            elif moved[k, j] > bounds[1, j]:
                moved[k, j] = bounds[1, j]
    return moved


@compiled
def continues(reference, former, tolerance):
    """Whether ŷ_1 … ŷ_{N−1} agree with the former ŷ_2 … ŷ_N, which are for the same times, within the tolerance."""
    for k in range(len(reference) - 1):
        for o in range(reference.shape[1]):
            if not abs(reference[k, o] - former[k + 1, o]) <= tolerance:
                return False
    return True


@compiled
def output_rows(Y, v, normals, weights, lacking, length):
    """Rows C (N r, N m) and lower bounds (N r,) of normalᵀ Σ_j weights_j Y_j Δv ≥ lacking over v + Δv, in units of
    `length`.

    normals (N, r, p), weights (N, r, N), lacking (N, r) m; in a row without an obstacle, lacking is −∞.
    """
    N, r, p = normals.shape
    size = Y.shape[2]
    C, lower = np.zeros((N * r, size)), np.empty(N * r)
    for k in range(N):
        for i in range(r):
            row = k * r + i
            for j in range(N):
                if weights[k, i, j] != 0.0:
                    for o in range(p):
                        a = weights[k, i, j] * normals[k, i, o] / length
                        if a != 0.0:
                            for column in range(size):
                                C[row, column] += a * Y[j, o, column]
            moved = lacking[k, i] / length
            for column in range(size):
                moved += C[row, column] * v[column]
            lower[row] = moved
    return C, lower
