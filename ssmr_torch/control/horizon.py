"""A model over the horizon: rollout, sensitivities, condensing to a quadratic program in the inputs.

`horizon_for` chooses: a compiled kernel for polynomial tables, its NumPy twin for every other model.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from ssmr_torch.control import kernel
from ssmr_torch.control.problem import TrackingProblem

TABLES = ("drift", "control", "parametrization")


class Condensed(NamedTuple):
    """The problem around the inputs U: states (N+1, n), outputs y_1 … y_N (N, p), and in v = u / input_scale

        hessian (N m, N m) = 2 (Σ_k Y_kᵀ Q_k Y_k + R),   Y_k = ∂y_k/∂v,
        gradient (N m,)    = 2 (Σ_k Y_kᵀ Q_k (y_k − ŷ_k) + R v),

    the Gauss-Newton matrix and the exact gradient of J / cost_scale, with Q and R scaled alike.
    The hessian is at least twice the identity.
    """

    states: np.ndarray
    outputs: np.ndarray
    hessian: np.ndarray
    gradient: np.ndarray


class Horizon(Protocol):
    """A model and a problem, ready for single shooting from a measured state."""

    def rollout(self, state: np.ndarray, inputs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """States (N+1, n) and outputs y_1 … y_N (N, p) from state (n,) under inputs (N, m)."""

    def condense(self, state: np.ndarray, inputs: np.ndarray, reference: np.ndarray) -> Condensed:
        """The problem around these inputs with ŷ_1 … ŷ_N = reference (N, p)."""


def horizon_for(model, problem: TrackingProblem) -> Horizon:
    """The fastest horizon for this model, stepping by the problem's period.

    Raises ValueError when the model's inputs or outputs are not those of the problem.
    """
    if (model.input_dim, model.output_dim) != (problem.input_dim, problem.output_dim):
        raise ValueError(f"the model has {model.input_dim} inputs and {model.output_dim} outputs; "
                         f"the problem has {problem.input_dim} and {problem.output_dim}")
    model = model.at_timestep(problem.period)
    polynomial = all(isinstance(getattr(model, name, None), np.ndarray) for name in TABLES)
    return (PolynomialHorizon if polynomial else LinearizedHorizon)(model, problem)


class LinearizedHorizon:
    """Any model, through `rollout`, `linearize` and `linearize_output`, batched over the horizon.

    The methods are those of `Horizon`.
    """

    def __init__(self, model, problem: TrackingProblem):
        self.model, self.problem = model, problem

    def rollout(self, state: np.ndarray, inputs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        states = self.model.rollout(state, inputs)
        return states, self.model.decode(states[1:])

    def condense(self, state: np.ndarray, inputs: np.ndarray, reference: np.ndarray) -> Condensed:
        """Sensitivities Y = ∂(y_1 … y_N)/∂v, v = u / input_scale, give H = 2 (Yᵀ Q Y + R) and the exact gradient."""
        problem = self.problem
        N, m = inputs.shape
        states, outputs = self.rollout(state, inputs)
        A, B, _ = self.model.linearize(states[:-1], inputs)
        C, _ = self.model.linearize_output(states[1:])
        sensitivity = np.zeros((N + 1, len(state), N, m))
        for k in range(N):
            sensitivity[k + 1] = np.tensordot(A[k], sensitivity[k], 1)
            sensitivity[k + 1, :, k] = B[k] * problem.input_scale
        Y = (C @ sensitivity[1:].reshape(N, len(state), N * m)).reshape(-1, N * m)
        weight = 2.0 * problem.stage_weight.ravel() / problem.cost_scale
        R = np.tile(2.0 * problem.input_weight * problem.input_scale**2 / problem.cost_scale, N)
        hessian = Y.T @ (weight[:, None] * Y)
        hessian.flat[::N * m + 1] += R
        gradient = Y.T @ (weight * (outputs - reference).ravel()) + R * (inputs / problem.input_scale).ravel()
        return Condensed(states, outputs, hessian, gradient)


class PolynomialHorizon:
    """Polynomial tables, compiled: the rate and its Jacobian are both a table times z^{0:d}.

    Runge-Kutta steps of order four carry the sensitivities along; `LinearizedHorizon` is the reference. The methods
    are those of `Horizon`.
    """

    def __init__(self, model, problem: TrackingProblem):
        self.model, self.problem = model, problem
        self._tables = kernel.tables_of(model)
        self._weight = 2.0 * problem.stage_weight / problem.cost_scale
        self._R = 2.0 * problem.input_weight * problem.input_scale**2 / problem.cost_scale

    def rollout(self, state: np.ndarray, inputs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return kernel.rollout(state, inputs, self._tables)

    def condense(self, state: np.ndarray, inputs: np.ndarray, reference: np.ndarray) -> Condensed:
        return Condensed(*kernel.condense(state, inputs, reference, self._tables, self._weight, self._R,
                                          self.problem.input_scale))
