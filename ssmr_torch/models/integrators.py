"""One time step with a held input, by the Runge-Kutta method or by a repeated map, and its exact derivatives.

Only arithmetic and matrix products are used, so that the same lines work for NumPy arrays and Torch tensors.
"""

from collections.abc import Callable

# A rollout has diverged once ‖z‖ exceeds this many times the norm of the largest training values.
DIVERGENCE_FACTOR = 10.0


def rk4_step(rate: Callable, z, timestep: float, substeps: int = 1):
    """Classical Runge-Kutta step of order four: z(t + timestep) from z(t), shape (..., n)."""
    h = timestep / substeps
    for _ in range(substeps):
        k1 = rate(z)
        k2 = rate(z + 0.5 * h * k1)
        k3 = rate(z + 0.5 * h * k2)
        k4 = rate(z + h * k3)
        z = z + (h / 6.0) * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    return z


def rk4_linearization(rate: Callable, jacobians: Callable, z, identity, timestep: float, substeps: int = 1):
    """The Runge-Kutta step and its exact derivatives (∂z⁺/∂z, ∂z⁺/∂u); each stage is differentiated.

    jacobians(z) → (∂f/∂z (..., n, n), ∂f/∂u (..., n, m)) at the held input; identity: (n, n).
    """
    h = timestep / substeps
    A, B = identity, None
    for _ in range(substeps):
        k1, (F, G) = rate(z), jacobians(z)
        k1_z, k1_u = F, G
        z2 = z + 0.5 * h * k1
        k2, (F, G) = rate(z2), jacobians(z2)
        k2_z, k2_u = F @ (identity + 0.5 * h * k1_z), G + 0.5 * h * (F @ k1_u)
        z3 = z + 0.5 * h * k2
        k3, (F, G) = rate(z3), jacobians(z3)
        k3_z, k3_u = F @ (identity + 0.5 * h * k2_z), G + 0.5 * h * (F @ k2_u)
        z4 = z + h * k3
        k4, (F, G) = rate(z4), jacobians(z4)
        k4_z, k4_u = F @ (identity + h * k3_z), G + h * (F @ k3_u)
        z = z + (h / 6.0) * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        step_z = identity + (h / 6.0) * (k1_z + 2.0 * k2_z + 2.0 * k3_z + k4_z)
        step_u = (h / 6.0) * (k1_u + 2.0 * k2_u + 2.0 * k3_u + k4_u)
        A, B = step_z @ A, step_u if B is None else step_z @ B + step_u
    return z, A, B


def repeated_map(advance: Callable, z, repeats: int):
    """z⁺ after `repeats` applications of the map, (..., n)."""
    for _ in range(repeats):
        z = advance(z)
    return z


def map_linearization(linearization: Callable, z, repeats: int):
    """`repeated_map` and its derivatives (∂z⁺/∂z, ∂z⁺/∂u) by the chain rule.

    linearization(z) → z⁺ and its ∂/∂z (..., n, n), ∂/∂u (..., n, m) of one application at the held input.
    """
    A = B = None
    for _ in range(repeats):
        z, F, G = linearization(z)
        A, B = (F, G) if A is None else (F @ A, F @ B + G)
    return z, A, B
