"""A model over the horizon: rollout, sensitivities, and condensing to a quadratic program in the inputs.

`horizon_for` chooses how: with constant matrices for affine models, with the compiled kernel that a model names, or
with the batched linearization in NumPy for every other model.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ssmr_torch.control import condensing
from ssmr_torch.control import horizon_kernel as kernel
from ssmr_torch.control.actuator import Actuator, lag_matrix, lagged
from ssmr_torch.control.constraints import ConstraintsAhead
from ssmr_torch.control.tracking_problem import TrackingProblem
from ssmr_torch.lazy import found

# T dy/dt from y_0 and the outputs one, two and three periods later: differences of first to third order.
VELOCITY = [np.array([-1.0, 1.0]), np.array([-1.5, 2.0, -0.5]), np.array([-11.0, 18.0, -9.0, 2.0]) / 6]


class Condensed(NamedTuple):
    """The problem around the inputs U: states (N+1, n), outputs y_1 … y_N (N, p), and in v = u / input_scale

        hessian (N m, N m) = 2 (Σ_k Y_kᵀ Q_k Y_k + R + Dᵀ S D),   Y_k = ∂y_k/∂v,   D v = v_k − v_{k−1},
        gradient (N m,)    = 2 (Σ_k Y_kᵀ Q_k (y_k − ŷ_k) + R (v − v̄) + Dᵀ S D v),
        linear (N m,)      = gradient − hessian v,

    the Gauss-Newton matrix and the exact gradient of the tracking cost / cost_scale, with Q and R scaled the same way.
    The hessian is at least twice the identity. sensitivity (N, p, N m): Y; initial (N, p, n): ∂y_k/∂z_0.
    """

    states: np.ndarray
    outputs: np.ndarray
    hessian: np.ndarray
    gradient: np.ndarray
    linear: np.ndarray
    sensitivity: np.ndarray
    initial: np.ndarray


class Horizon(ABC):
    """A model that steps by the problem's period, and a problem: single shooting from a measured state.

    input_offset (m,), output_offset (p,): of a constant disturbance, z⁺ = f(z, u + input_offset), y = w(z) +
    output_offset; None: none.
    actuator: if given, not the planned inputs act, but the inputs after its lag and gains, starting at `lagged_from`
    (m,).   last_input: (m,), u_{−1}, from which changes are counted; None: the first input is free.
    """

    def __init__(self, model, problem: TrackingProblem, actuator: Actuator | None = None):
        self.model, self.problem = model, problem
        self.input_offset: np.ndarray | None = None
        self.output_offset: np.ndarray | None = None
        changes = actuator is not None and (actuator.lag or actuator.gain or actuator.offset)
        self.actuator = actuator if changes else None
        self.lagged_from = np.zeros(problem.input_dim)
        self.last_input: np.ndarray | None = None
        self._weight = 2.0 * problem.stage_weight / problem.cost_scale
        self._R = 2.0 * problem.input_weight / problem.cost_scale
        self._mixing = None if self.actuator is None else lag_matrix(self.actuator, problem.horizon)
        self._changes = _change_matrix(problem) if problem.moves else None
        self._plain = self._mixing is None and self._changes is None and problem.huber is None \
            and problem.input_target is None
        # The weights of the inputs are added later where they are not a diagonal.
        self._own_R = self._R if self._plain else np.zeros_like(self._R)

    @abstractmethod
    def _rollout(self, state: np.ndarray, inputs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """`rollout` under acting inputs, without a disturbance."""

    def _acting(self, inputs: np.ndarray) -> np.ndarray:
        if self.actuator is not None:
            actuator = self.actuator
            inputs = lagged(inputs, self.lagged_from, actuator.share, actuator.factor, actuator.shift)
        return inputs if self.input_offset is None else inputs + self.input_offset

    def _seen(self, outputs: np.ndarray) -> np.ndarray:
        return outputs if self.output_offset is None else outputs + self.output_offset

    def constraints_ahead(self, time: float, state: np.ndarray, held: np.ndarray) -> ConstraintsAhead | None:
        """The problem's constraints seen from a state (n,) at a time in s; None where there are none.

        The velocity there is that of the predictions under the present input (m,). It does not depend on the inputs
        that follow.
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
    def _condense(self, state: np.ndarray, inputs: np.ndarray, reference: np.ndarray) -> Condensed:
        """`condense` for acting inputs, with `_own_R` and without changes of the inputs."""

    def condense(self, state: np.ndarray, inputs: np.ndarray, reference: np.ndarray) -> Condensed:
        """The problem around these inputs, where ŷ_1 … ŷ_N = reference (N, p)."""
        point = self._condense(state, inputs, reference)
        return point if self._plain else self._with_inputs(point, inputs, reference)

    def _with_inputs(self, point: Condensed, inputs: np.ndarray, reference: np.ndarray) -> Condensed:
        """The problem for planned inputs, with their weights, the weights of their changes, and Huber's weights."""
        Y, hessian, size = point.sensitivity, point.hessian, inputs.size
        if self._mixing is not None:
            Y = (Y.reshape(-1, size) @ self._mixing).reshape(Y.shape)
        weight = self._weight_at(point.outputs, reference)
        if weight is not self._weight:
            hessian = condensing.gauss_newton(Y, weight, self._own_R)
        elif self._mixing is not None:
            hessian = self._mixing.T @ hessian @ self._mixing
        hessian = hessian + self._of_inputs_alone
        gradient, linear = self._gradients(hessian, Y, point.outputs, reference, inputs)
        return point._replace(hessian=hessian, gradient=gradient, linear=linear, sensitivity=Y)

    def _weight_at(self, outputs: np.ndarray, reference: np.ndarray) -> np.ndarray:
        if self.problem.huber is None:
            return self._weight
        weight = self.problem.huber_weight(outputs, reference)
        return self._weight if weight is self.problem.stage_weight else 2.0 / self.problem.cost_scale * weight

    @cached_property
    def _of_inputs_alone(self) -> np.ndarray:
        """2 (R + Dᵀ S D) / cost_scale, (N m, N m)."""
        whole = np.diag(np.tile(self._R, self.problem.horizon))
        return whole if self._changes is None else whole + self._changes

    def moved(self, point: Condensed, state: np.ndarray, inputs: np.ndarray, reference: np.ndarray) -> Condensed:
        """The same linearization for another measured state and reference: the feedback phase."""
        outputs = point.outputs + point.initial @ (state - point.states[0])
        gradient, linear = self._gradients(point.hessian, point.sensitivity, outputs, reference, inputs)
        return point._replace(outputs=outputs, gradient=gradient, linear=linear)

    def _gradients(self, hessian, Y, outputs, reference, inputs) -> tuple[np.ndarray, np.ndarray]:
        scale = self.problem.input_scale
        weight = self._weight_at(outputs, reference)
        target = self.problem.input_target
        from_target = inputs if target is None else inputs - target
        gradient = condensing.gradient(Y, outputs, reference, weight, self._R, from_target, scale)
        if self._changes is not None:
            gradient += self._changes @ (inputs / scale).ravel()
            before = inputs[0] if self.last_input is None else self.last_input
            gradient[:len(scale)] -= 2.0 * self.problem.move_weight / self.problem.cost_scale * before / scale
        return gradient, condensing.around(hessian, gradient, inputs, scale)


class LinearizedHorizon(Horizon):
    """Any model, through `states`, `linearize` and `linearize_output`, batched over the horizon."""

    def _rollout(self, state: np.ndarray, inputs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        states = self.model.states(state, inputs)
        return states, self.model.decode(states[1:])

    def _condense(self, state: np.ndarray, inputs: np.ndarray, reference: np.ndarray) -> Condensed:
        acting = self._acting(inputs)
        states, outputs = self._rollout(state, acting)
        A, B, _ = self.model.linearize(states[:-1], acting)
        C, _ = self.model.linearize_output(states[1:])
        outputs, parts = self._seen(outputs), (np.ascontiguousarray(part) for part in (A, B, C))
        return Condensed(states, outputs, *condensing.condensed(outputs, *parts, reference, inputs,
                                                                self.problem.input_scale, self._weight, self._own_R))


class CompiledHorizon(Horizon):
    """A kernel's tables and its two functions, `rollout` and `condense`. `LinearizedHorizon` is the reference."""

    def __init__(self, model, problem: TrackingProblem, actuator, tables, rollout, condense):
        super().__init__(model, problem, actuator)
        self._tables, self._compiled_rollout, self._compiled_condense = tables, rollout, condense
        self._settings = problem.input_scale, self._weight, self._own_R

    def _rollout(self, state: np.ndarray, inputs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return self._compiled_rollout(state, inputs, self._tables)

    def _condense(self, state: np.ndarray, inputs: np.ndarray, reference: np.ndarray) -> Condensed:
        target = reference if self.output_offset is None else reference - self.output_offset
        states, outputs, *program = self._compiled_condense(state, inputs, self._acting(inputs), target, self._tables,
                                                            *self._settings)
        return Condensed(states, self._seen(outputs), *program)


class LinearHorizon(LinearizedHorizon):
    """z⁺ = A z + B u + c, y = C z + d: all matrices over the horizon are made once, and a step costs two products."""

    def __init__(self, model, problem: TrackingProblem, actuator: Actuator | None = None):
        super().__init__(model, problem, actuator)
        N, n, m = problem.horizon, model.state_dim, problem.input_dim
        zero, none = np.zeros(n), np.zeros((N, m))
        self._offset_states = model.states(zero, none)
        A, B, _ = model.linearize(zero, none[0])
        C, _ = model.linearize_output(zero)
        repeated = [np.ascontiguousarray(np.broadcast_to(part, (N, *part.shape))) for part in (A, B, C)]
        self._Y, self._Z = condensing.sensitivities(*repeated, problem.input_scale)
        self._of_inputs = (self._Y.reshape(-1, N, m) / problem.input_scale).reshape(-1, N * m)
        if self._mixing is not None:
            self._Y = (self._Y.reshape(-1, N * m) @ self._mixing).reshape(self._Y.shape)
        self._hessian = condensing.gauss_newton(self._Y, self._weight, self._own_R)
        if not self._plain:
            self._hessian += self._of_inputs_alone
        self._A, self._B, self._step = np.ascontiguousarray(A), B, self._offset_states[1]
        self._of_state = self._Z.reshape(-1, n)
        self._offset = model.decode(self._offset_states[1:])

    def _rollout(self, state: np.ndarray, inputs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        states = kernel.linear_states(state, inputs @ self._B.T + self._step, self._A)
        return states, self._outputs(state, inputs)

    def _outputs(self, state: np.ndarray, inputs: np.ndarray) -> np.ndarray:
        reached = self._of_state @ state + self._of_inputs @ inputs.ravel()
        return self._offset + reached.reshape(self._offset.shape)

    def condense(self, state: np.ndarray, inputs: np.ndarray, reference: np.ndarray) -> Condensed:
        """The problem with the constant matrices. `states` holds only the first state."""
        outputs, hessian = self._seen(self._outputs(state, self._acting(inputs))), self._hessian
        weight = self._weight_at(outputs, reference)
        if weight is not self._weight:
            hessian = condensing.gauss_newton(self._Y, weight, self._own_R) + self._of_inputs_alone
        gradients = self._gradients(hessian, self._Y, outputs, reference, inputs)
        return Condensed(state[None], outputs, hessian, *gradients, self._Y, self._Z)

    _condense = condense


def _change_matrix(problem: TrackingProblem) -> np.ndarray:
    """2 Dᵀ S D / cost_scale, (N m, N m)."""
    size, m = problem.horizon * problem.input_dim, problem.input_dim
    D = np.eye(size) - np.eye(size, k=-m)
    return D.T @ (np.tile(2.0 * problem.move_weight / problem.cost_scale, problem.horizon)[:, None] * D)


def horizon_for(model, problem: TrackingProblem, actuator: Actuator | None = None) -> Horizon:
    """The fastest horizon for this model, with steps of the problem's period.

    Raises ValueError when the number of the model's inputs or outputs differs from the problem's.
    """
    if (model.input_dim, model.output_dim) != (problem.input_dim, problem.output_dim):
        raise ValueError(f"the model has {model.input_dim} inputs and {model.output_dim} outputs; "
                         f"expected {problem.input_dim} and {problem.output_dim}, as in the problem")
    model = model.at_timestep(problem.period)
    if model.affine:
        return LinearHorizon(model, problem, actuator)
    compiled = found(model.compiled)(model) if model.compiled else None
    if compiled is None:
        return LinearizedHorizon(model, problem, actuator)
    return CompiledHorizon(model, problem, actuator, *compiled)
