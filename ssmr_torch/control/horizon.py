"""A model over the horizon: rollout, sensitivities, condensing to a quadratic program in the inputs.

`horizon_for` chooses: constant matrices for affine models, the compiled kernel that a model names, and the batched
linearization in NumPy for every other model.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import NamedTuple

import numpy as np

from ssmr_torch.control import condensing, kernel
from ssmr_torch.control.constraints import ConstraintsAhead
from ssmr_torch.control.problem import TrackingProblem
from ssmr_torch.lazy import found

# T dy/dt from y_0 and those one, two and three periods later: differences of first to third order.
VELOCITY = [np.array([-1.0, 1.0]), np.array([-1.5, 2.0, -0.5]), np.array([-11.0, 18.0, -9.0, 2.0]) / 6]


class Condensed(NamedTuple):
    """The problem around the inputs U: states (N+1, n), outputs y_1 … y_N (N, p), and in v = u / input_scale

        hessian (N m, N m) = 2 (Σ_k Y_kᵀ Q_k Y_k + R),   Y_k = ∂y_k/∂v,
        gradient (N m,)    = 2 (Σ_k Y_kᵀ Q_k (y_k − ŷ_k) + R v),
        linear (N m,)      = gradient − hessian v,

    the Gauss-Newton matrix and the exact gradient of the tracking cost / cost_scale, with Q and R scaled alike; the
    hessian is at least twice the identity. sensitivity (N, p, N m): Y; initial (N, p, n): ∂y_k/∂z_0.
    """

    states: np.ndarray
    outputs: np.ndarray
    hessian: np.ndarray
    gradient: np.ndarray
    linear: np.ndarray
    sensitivity: np.ndarray
    initial: np.ndarray


class Horizon(ABC):
    """A model, stepping by the problem's period, and a problem: single shooting from a measured state.

    input_offset (m,), output_offset (p,): of a constant disturbance, z⁺ = f(z, u + input_offset), y = w(z) +
    output_offset; None: none.
    """

    def __init__(self, model, problem: TrackingProblem):
        self.model, self.problem = model, problem
        self.input_offset: np.ndarray | None = None
        self.output_offset: np.ndarray | None = None
        self._weight = 2.0 * problem.stage_weight / problem.cost_scale
        self._R = 2.0 * problem.input_weight * problem.input_scale**2 / problem.cost_scale

    @abstractmethod
    def _rollout(self, state: np.ndarray, inputs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """`rollout` without a disturbance."""

    def _acting(self, inputs: np.ndarray) -> np.ndarray:
        return inputs if self.input_offset is None else inputs + self.input_offset

    def _seen(self, outputs: np.ndarray) -> np.ndarray:
        return outputs if self.output_offset is None else outputs + self.output_offset

    def constraints_ahead(self, time: float, state: np.ndarray, held: np.ndarray) -> ConstraintsAhead | None:
        """The problem's constraints, where there are any, seen from a state (n,) at a time in s.

        The velocity there is that of the predictions under the input held so far (m,): whatever comes next, it is the
        same at first.
        """
        if self.problem.constraints is None:
            return None
        here = self._seen(self.model.decode(state[None]))[0]
        later = self.rollout(state, np.tile(held, (self.problem.horizon, 1)))[1]
        weights = VELOCITY[min(len(later), len(VELOCITY)) - 1]
        velocity = weights[0] * here + weights[1:] @ later[:len(weights) - 1]
        return self.problem.constraints.ahead(time, self.problem.period, np.stack([here, velocity]))

    def rollout(self, state: np.ndarray, inputs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """States (N+1, n) and outputs y_1 … y_N (N, p) from state (n,) under inputs (N, m)."""
        states, outputs = self._rollout(state, self._acting(inputs))
        return states, self._seen(outputs)

    @abstractmethod
    def condense(self, state: np.ndarray, inputs: np.ndarray, reference: np.ndarray) -> Condensed:
        """The problem around these inputs with ŷ_1 … ŷ_N = reference (N, p)."""

    def moved(self, point: Condensed, state: np.ndarray, inputs: np.ndarray, reference: np.ndarray) -> Condensed:
        """The same linearization seen from another measured state and reference: the feedback phase."""
        outputs = point.outputs + point.initial @ (state - point.states[0])
        gradient, linear = self._gradients(point.hessian, point.sensitivity, outputs, reference, inputs)
        return point._replace(outputs=outputs, gradient=gradient, linear=linear)

    def _gradients(self, hessian, Y, outputs, reference, inputs) -> tuple[np.ndarray, np.ndarray]:
        scale = self.problem.input_scale
        gradient = condensing.gradient(Y, outputs, reference, self._weight, self._R, inputs, scale)
        return gradient, condensing.around(hessian, gradient, inputs, scale)


class LinearizedHorizon(Horizon):
    """Any model, through `states`, `linearize` and `linearize_output`, batched over the horizon."""

    def _rollout(self, state: np.ndarray, inputs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        states = self.model.states(state, inputs)
        return states, self.model.decode(states[1:])

    def condense(self, state: np.ndarray, inputs: np.ndarray, reference: np.ndarray) -> Condensed:
        acting = self._acting(inputs)
        states, outputs = self._rollout(state, acting)
        A, B, _ = self.model.linearize(states[:-1], acting)
        C, _ = self.model.linearize_output(states[1:])
        outputs, parts = self._seen(outputs), (np.ascontiguousarray(part) for part in (A, B, C))
        return Condensed(states, outputs, *condensing.condensed(outputs, *parts, reference, inputs,
                                                                self.problem.input_scale, self._weight, self._R))


class CompiledHorizon(Horizon):
    """Tables of a kernel and its two functions, `rollout` and `condense`; `LinearizedHorizon` is the reference."""

    def __init__(self, model, problem: TrackingProblem, tables, rollout, condense):
        super().__init__(model, problem)
        self._tables, self._compiled_rollout, self._compiled_condense = tables, rollout, condense
        self._settings = problem.input_scale, self._weight, self._R

    def _rollout(self, state: np.ndarray, inputs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return self._compiled_rollout(state, inputs, self._tables)

    def condense(self, state: np.ndarray, inputs: np.ndarray, reference: np.ndarray) -> Condensed:
        target = reference if self.output_offset is None else reference - self.output_offset
        states, outputs, *program = self._compiled_condense(state, inputs, self._acting(inputs), target, self._tables,
                                                            *self._settings)
        return Condensed(states, self._seen(outputs), *program)


class LinearHorizon(LinearizedHorizon):
    """z⁺ = A z + B u + c, y = C z + d: all matrices over the horizon are made once; a step costs two products."""

    def __init__(self, model, problem: TrackingProblem):
        super().__init__(model, problem)
        N, n, m = problem.horizon, model.state_dim, problem.input_dim
        zero, none = np.zeros(n), np.zeros((N, m))
        self._offset_states = model.states(zero, none)
        A, B, _ = model.linearize(zero, none[0])
        C, _ = model.linearize_output(zero)
        repeated = [np.ascontiguousarray(np.broadcast_to(part, (N, *part.shape))) for part in (A, B, C)]
        self._Y, self._Z = condensing.sensitivities(*repeated, problem.input_scale)
        self._hessian = condensing.gauss_newton(self._Y, self._weight, self._R)
        self._A, self._B, self._step = np.ascontiguousarray(A), B, self._offset_states[1]
        self._of_state = self._Z.reshape(-1, n)
        self._of_inputs = (self._Y.reshape(-1, N, m) / problem.input_scale).reshape(-1, N * m)
        self._offset = model.decode(self._offset_states[1:])

    def _rollout(self, state: np.ndarray, inputs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        states = kernel.linear_states(state, inputs @ self._B.T + self._step, self._A)
        return states, self._outputs(state, inputs)

    def _outputs(self, state: np.ndarray, inputs: np.ndarray) -> np.ndarray:
        reached = self._of_state @ state + self._of_inputs @ inputs.ravel()
        return self._offset + reached.reshape(self._offset.shape)

    def condense(self, state: np.ndarray, inputs: np.ndarray, reference: np.ndarray) -> Condensed:
        """The constant matrices; states holds the first state alone."""
        outputs = self._seen(self._outputs(state, self._acting(inputs)))
        gradients = self._gradients(self._hessian, self._Y, outputs, reference, inputs)
        return Condensed(state[None], outputs, self._hessian, *gradients, self._Y, self._Z)


def horizon_for(model, problem: TrackingProblem) -> Horizon:
    """The fastest horizon for this model, stepping by the problem's period.

    Raises ValueError when the model's inputs or outputs are not those of the problem.
    """
    if (model.input_dim, model.output_dim) != (problem.input_dim, problem.output_dim):
        raise ValueError(f"the model has {model.input_dim} inputs and {model.output_dim} outputs; "
                         f"the problem has {problem.input_dim} and {problem.output_dim}")
    model = model.at_timestep(problem.period)
    if model.affine:
        return LinearHorizon(model, problem)
    compiled = found(model.compiled)(model) if model.compiled else None
    return LinearizedHorizon(model, problem) if compiled is None else CompiledHorizon(model, problem, *compiled)
