"""The tracking problem that the controller solves at every step, and its scaling."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np

from ssmr_torch.control.condensing import clipped, tracking_cost
from ssmr_torch.control.constraints import ConstraintsAhead, OutputConstraints
from ssmr_torch.control.input_bounds import changed_bounds
from ssmr_torch.control.mpc_settings import PredictiveControlSettings
from ssmr_torch.settings import positive

# The solver sees violations in this unit, m.
SLACK_SCALE = 1e-3


@dataclass(frozen=True, eq=False)
class TrackingProblem:
    """Paper, Eq. 12 with the sums that the choice of u can influence:

        min  Σ_{k=1..N} ρ(‖y_k − ŷ_k‖²_Q) + ‖y_N − ŷ_N‖²_{Q_f} + Σ_{k=0..N−1} ‖v_k − v̄‖²_R + ‖v_k − v_{k−1}‖²_S
        s.t. lower ≤ u_k ≤ upper,   |u_k − u_{k−1}| ≤ rate · period   with u_{−1} the input applied last,

    where v = u / range is the input in units of its range, so that no weight has the unit of an input. Where there are
    `constraints`, their penalty of the path to y_N is added to the cost. ρ is the identity, or Huber's function where
    `huber` is given: from an error of that size on the cost grows linearly, and what is out of reach is not forced; Q
    is then a multiple of the identity in what is tracked, and Q_f in the same, within ρ as well.

    reference: time (K,) s → ŷ (K, p) m.   input_bounds: (2, m), lowest and highest input.
    output_weight, terminal_weight: diagonals of Q and Q_f, (p,) or one number, 1/m².
    input_weight, move_weight: diagonals of R and S, (m,) or one number, without unit.   huber: m, or None.
    input_rate: (m,) or one number, input unit per s, or None.   input_range: (m,), by default that of the bounds.
    posture_weight: (p,), 1/m², added to Q for outputs that are not tracked, from their own reference; None: zero.
    input_target: (m,), range · v̄, which inputs tend to where tracking leaves them free; None: zero.
    constraints: `OutputConstraints` or None.
    Raises ValueError for sizes that disagree, crossed bounds, and weights without a unique minimum.

    The solver sees v and J / cost_scale. The weights of v are then at least the identity, so that a dual residual ε
    leaves an error of at most ε in v.
    """

    reference: Callable[[np.ndarray], np.ndarray]
    input_bounds: np.ndarray
    output_weight: np.ndarray
    input_weight: np.ndarray | float
    terminal_weight: np.ndarray | float = 0.0
    input_rate: np.ndarray | float | None = None
    horizon: int = PredictiveControlSettings.horizon
    period: float = PredictiveControlSettings.period
    constraints: OutputConstraints | None = None
    move_weight: np.ndarray | float = 0.0
    huber: float | None = None
    input_range: np.ndarray | None = None
    input_target: np.ndarray | None = None
    posture_weight: np.ndarray | None = None

    def __post_init__(self):
        bounds = np.array(self.input_bounds, dtype=np.float64)
        if bounds.ndim != 2 or len(bounds) != 2:
            raise ValueError(f"input_bounds has shape {bounds.shape}; "
                             "expected (2, m): lowest and highest input")
        if not (np.isfinite(bounds).all() and (bounds[0] < bounds[1]).all()):
            raise ValueError(f"input_bounds are {bounds.tolist()}; "
                             "expected finite numbers, lowest below highest")
        if int(self.horizon) != self.horizon or self.horizon < 1:
            raise ValueError(f"horizon is {self.horizon}; expected a positive number of control steps")
        if not (np.isfinite(self.period) and self.period > 0):
            raise ValueError(f"period is {self.period} s; expected a positive time")
        outputs, inputs = np.atleast_1d(self.output_weight).shape[0], bounds.shape[1]
        self._set("input_bounds", bounds)
        self._set("output_weight", _diagonal("output_weight", self.output_weight, outputs))
        self._set("terminal_weight", _diagonal("terminal_weight", self.terminal_weight, outputs))
        self._set("input_weight", _diagonal("input_weight", self.input_weight, inputs))
        self._set("move_weight", _diagonal("move_weight", self.move_weight, inputs))
        if self.input_range is not None:
            self._set("input_range", _diagonal("input_range", self.input_range, inputs))
        if self.input_target is not None:
            target = np.array(self.input_target, dtype=np.float64)
            if target.shape != (inputs,) or not np.isfinite(target).all():
                raise ValueError(f"input_target has shape {target.shape}; expected {inputs} finite numbers")
            self._set("input_target", target)
        if self.posture_weight is not None:
            self._set("posture_weight", _diagonal("posture_weight", self.posture_weight, outputs))
        if self.huber is not None:
            self._check_huber()
        if not (self.input_weight > 0).all():
            raise ValueError(f"input_weight is {self.input_weight.tolist()}; expected positive numbers, "
                             "without them the optimal input is not unique")
        if self.input_rate is not None:
            self._set("input_rate", _diagonal("input_rate", self.input_rate, inputs))
            if not (self.input_rate > 0).all():
                raise ValueError(f"input_rate is {self.input_rate.tolist()} per s; "
                                 "expected positive numbers, or None for no limit")

    def _check_huber(self) -> None:
        positive("huber", self.huber, "m")
        tracked = self.output_weight > 0
        for name in ("output_weight", "terminal_weight"):
            weight = getattr(self, name)
            if weight[~tracked].any() or len(set(weight[tracked])) > 1:
                raise ValueError(f"{name} is {weight.tolist()}; expected the same number for everything that "
                                 "output_weight tracks, and zero for the rest, with a huber of "
                                 f"{self.huber} m: it is one distance from the reference")

    def _set(self, name: str, array: np.ndarray) -> None:
        array.setflags(write=False)
        object.__setattr__(self, name, array)

    def __getstate__(self) -> dict:
        """Fields and units; all else is derived from them, and like them read-only."""
        kept = {*(field.name for field in fields(self)), "input_scale", "cost_scale"}
        return {name: value for name, value in self.__dict__.items() if name in kept}

    def __setstate__(self, state: dict) -> None:
        # a copy's arrays could be written to, for which compiled functions would be made anew in its first step
        self.__dict__.update(state)
        for field in fields(self):
            if isinstance(state.get(field.name), np.ndarray):
                state[field.name].setflags(write=False)

    @property
    def input_dim(self) -> int:
        return self.input_bounds.shape[1]

    @property
    def output_dim(self) -> int:
        return len(self.output_weight)

    @cached_property
    def stage_weight(self) -> np.ndarray:
        """(N, p) weights of y_1 … y_N, the last with the terminal weight added."""
        weight = np.tile(self.output_weight, (self.horizon, 1))
        weight[-1] += self.terminal_weight
        if self.posture_weight is not None:
            weight += self.posture_weight
        return weight

    @cached_property
    def input_scale(self) -> np.ndarray:
        """(m,) range of each input: v = u / input_scale."""
        return self.input_bounds[1] - self.input_bounds[0] if self.input_range is None else self.input_range

    @cached_property
    def cost_scale(self) -> float:
        """Smallest weight of v: the solver sees J / cost_scale."""
        slowest = 4.0 * np.sin(0.5 * np.pi / (2 * self.horizon + 1))**2  # of all changes over the horizon
        return float((self.input_weight + slowest * self.move_weight).min())

    @cached_property
    def moves(self) -> bool:
        """Whether changes of the input cost something."""
        return bool(self.move_weight.any())

    @cached_property
    def input_step(self) -> np.ndarray | None:
        """(m,) largest change of the input from one control step to the next."""
        return None if self.input_rate is None else self.input_rate * self.period

    @cached_property
    def rate_rows(self) -> tuple[np.ndarray, np.ndarray] | None:
        """(C, limit) with |C v| ≤ limit for the changes within the horizon; None where there are none."""
        if self.input_step is None or self.horizon == 1:
            return None
        size = (self.horizon - 1) * self.input_dim
        C = np.eye(size, size + self.input_dim, self.input_dim) - np.eye(size, size + self.input_dim)
        return C, np.tile(self.input_step / self.input_scale, self.horizon - 1)

    @cached_property
    def _scaled_box(self) -> tuple[np.ndarray, np.ndarray]:
        """The same two read-only arrays every time: a solver that knows them has less to do."""
        box = tuple(np.tile(self.input_bounds / self.input_scale, self.horizon))
        for bound in box:
            bound.setflags(write=False)
        return box

    def bounded(self, bounds) -> TrackingProblem:
        """The same problem in the same units under other bounds (2, m); equal ones are those of a dead actuator.

        Raises ValueError, with both numbers, for bounds that are not finite or crossed, and for another shape.
        """
        bounds = changed_bounds(bounds, self.input_bounds.shape)
        _ = self.input_scale, self.cost_scale  # the units of the first bounds stay
        changed = copy.copy(self)
        changed._set("input_bounds", bounds)
        changed.__dict__.pop("_scaled_box", None)
        return changed

    def scaled_bounds(self, last_input: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """Bounds of v, each (N m,); those of v_0 also limit the change from `last_input` (m,), which counts from the
        bounds where these have changed since.
        """
        lower, upper = self._scaled_box
        if self.input_step is not None and last_input is not None:
            m, last_input = self.input_dim, np.clip(last_input, *self.input_bounds)
            lower, upper = lower.copy(), upper.copy()
            lower[:m] = np.maximum(lower[:m], (last_input - self.input_step) / self.input_scale)
            upper[:m] = np.minimum(upper[:m], (last_input + self.input_step) / self.input_scale)
        return lower, upper

    def admissible(self, inputs: np.ndarray, last_input: np.ndarray | None = None) -> np.ndarray:
        """The sequence (K, m) moved into the bounds, and each input within reach of the one before."""
        inputs = clipped(inputs, self.input_bounds)
        if self.input_step is not None:
            for k in range(len(inputs)):
                before = inputs[k - 1] if k else last_input
                if before is not None:
                    before = np.clip(before, *self.input_bounds)
                    inputs[k] = np.clip(inputs[k], before - self.input_step, before + self.input_step)
        return inputs

    @property
    def soft_rows(self) -> int:
        """Rows, and slack variables, of the output constraints in the quadratic program."""
        return 0 if self.constraints is None else self.horizon * self.constraints.rows_per_stage

    @property
    def size(self) -> tuple[int, int]:
        """Variables, inputs and slacks, and general rows of the quadratic program."""
        rate = 0 if self.rate_rows is None else len(self.rate_rows[1])
        return self.horizon * self.input_dim + self.soft_rows, rate + self.soft_rows

    @cached_property
    def continuation(self) -> tuple[np.ndarray, np.ndarray]:
        """A control step later: the variables and rows of the last program that those of the next one continue.

        Each continues its like one stage on, and those of the last stage themselves.
        """
        def later(count: int, per_stage: int) -> np.ndarray:
            return np.arange(count) + np.where(np.arange(count) + per_stage < count, per_stage, 0)

        inputs, soft = self.horizon * self.input_dim, self.soft_rows
        slacks, rate = later(soft, soft // self.horizon), self.size[1] - soft
        return (np.concatenate([later(inputs, self.input_dim), inputs + slacks]),
                np.concatenate([later(rate, self.input_dim), rate + slacks]))

    def times_ahead(self, time: float) -> np.ndarray:
        """Times of y_1 … y_N, (N,) s, seen from `time` in s."""
        return time + self._steps_ahead

    @cached_property
    def _steps_ahead(self) -> np.ndarray:
        return self.period * np.arange(1, self.horizon + 1)

    def reference_ahead(self, time: float) -> np.ndarray:
        """ŷ_1 … ŷ_N, (N, p), seen from `time` in s."""
        reference = np.asarray(self.reference(self.times_ahead(time)), dtype=np.float64)
        if reference.shape != self.stage_weight.shape:
            raise ValueError(f"the reference has shape {reference.shape}; "
                             f"expected {self.stage_weight.shape}, "
                             "one row per time and one column per output")
        return reference

    def cost(self, outputs: np.ndarray, inputs: np.ndarray, reference: np.ndarray,
             ahead: ConstraintsAhead | None = None, last_input: np.ndarray | None = None) -> float:
        """J of y_1 … y_N (N, p) and u_0 … u_{N−1} (N, m); not a finite number when the outputs are not.

        ahead: the constraints from the present time and place on; where there are constraints, it is needed. last_input
        (m,): u_{−1}; None: the first input may be any.
        """
        weight = self.stage_weight if self.huber is None else self.huber_weight(outputs, reference, cost=True)
        from_target = inputs if self.input_target is None else inputs - self.input_target
        cost = tracking_cost(outputs, from_target / self.input_scale, reference, weight, self.input_weight)
        if self.moves:
            first = inputs[:1] if last_input is None else last_input[None]
            changes = np.diff(inputs, axis=0, prepend=first) / self.input_scale
            cost += float((np.square(changes) @ self.move_weight).sum())
        return cost if self.constraints is None else cost + ahead.penalty(outputs)

    def huber_weight(self, outputs: np.ndarray, reference: np.ndarray, *, cost: bool = False) -> np.ndarray:
        """(N, p): `stage_weight` times ρ'(‖e‖²) at the tracked errors e of outputs (N, p), m, with which the gradient
        and the Gauss-Newton matrix are those of Huber's function; cost: times ρ(‖e‖²) / ‖e‖², with which the sum is.
        """
        tracked = np.broadcast_to(self.output_weight > 0, self.stage_weight.shape)
        size = np.sqrt(np.square(np.where(tracked, outputs - reference, 0.0)).sum(1))
        if not (size > self.huber).any():
            return self.stage_weight
        share = self.huber / np.maximum(size, self.huber)
        share = (share * (2.0 - share) if cost else share)[:, None]
        return np.where(tracked, share, 1.0) * self.stage_weight


def _diagonal(name: str, value, size: int) -> np.ndarray:
    array = np.array(np.broadcast_to(np.asarray(value, dtype=np.float64), size)) if np.ndim(value) == 0 \
        else np.array(value, dtype=np.float64)
    if array.shape != (size,):
        raise ValueError(f"{name} has shape {array.shape}; expected one number or ({size},)")
    if not (np.isfinite(array).all() and (array >= 0).all()):
        raise ValueError(f"{name} is {array.tolist()}; expected finite numbers, none negative")
    return array
