"""Model predictive control: measurements → reduced state → plan → first input, at every control step."""

from __future__ import annotations

from collections import Counter, deque
from math import isfinite, sqrt

import numpy as np

from ssmr_torch import data_sheet as sheet
from ssmr_torch.control.base import Command, admissible_input, whole_steps
from ssmr_torch.control.condensing import continues
from ssmr_torch.control.constraints import constraints_of
from ssmr_torch.control.estimation import ChartEstimator
from ssmr_torch.control.horizon import horizon_for
from ssmr_torch.control.problem import TrackingProblem
from ssmr_torch.control.scp import Plan, solve_scp
from ssmr_torch.control.settings import PredictiveControlSettings
from ssmr_torch.control.solvers import solver_named
from ssmr_torch.data_sheet import DataSheet
from ssmr_torch.keywords import configurable
from ssmr_torch.status import Status

# A reference that differs by more than this from the one planned for is a new one, m.
REFERENCE_CHANGE = 1e-6
# A violation costs more than tracking errors of this size at every stage would, m: more than any in the workspace.
PULL = 0.05
# Share of an input's range by which it must have changed for a measurement to have to change.
MOVED = 0.05


class ModelPredictiveController(DataSheet):
    """Receding-horizon tracking with a reduced model (paper, section 4.4; see `TrackingProblem`).

    model: a `Model`, or what has one as its `reduced`, such as a Torch module.
    task: `columns(output_names)` and `reference(time)`, perhaps `obstacles`, such as `tasks.references.Task`.
    input_bounds: (2, m).   timestep: time between two measurements, s; default the model's window_timestep.
    output_names: of the observations, those of the model where none are given.
    settings: `PredictiveControlSettings`, which says what each is; changes: some of them by name, in their place.
    solver: an object with `solve(QuadraticProgram)` and `reset()` in place of that named by the setting qp, and
    perhaps `advance`, see `ProxQP`.

    A step that cannot be trusted falls back to the plan made last, then to safe_input, under the same bounds
    and rate; `fallbacks` counts the reasons by Status. Everything is compiled and run once at construction.
    `prepare` may be called between two measurements: it linearizes and condenses around the shifted plan, and the next
    step only has to solve.
    Raises ValueError when a period is not a multiple of the timestep or sizes or names disagree, TypeError for a change
    of what is no setting and for what is no model.
    """

    @configurable(PredictiveControlSettings, given=("settings", "timestep", "output_names", "solver"))
    def __init__(self, model, task, input_bounds, settings: PredictiveControlSettings | None = None, *,
                 timestep: float | None = None, output_names=None, solver=None, **changes):
        if not isinstance(settings, PredictiveControlSettings | None) or not hasattr(model, "reduced"):
            raise TypeError(f"model is a {type(model).__name__}, settings a {type(settings).__name__}; "
                            "expected a model, as ssmr_torch.load returns it, and PredictiveControlSettings")
        settings = (PredictiveControlSettings() if settings is None else settings).changed(**changes)
        output_names = _seen(model, output_names)
        self.model, self.task, self.settings = model.reduced.numpy(), task, settings
        model = self.model
        self.timestep = float(model.window_timestep if timestep is None else timestep)
        self.period = settings.period
        self._samples_per_step = whole_steps("period", self.period, self.timestep)
        stride = whole_steps("the model's window_timestep", model.window_timestep, self.timestep)
        self._age = whole_steps("measurement_delay", settings.measurement_delay, self.timestep) \
            if settings.measurement_delay else 0
        self.problem = self._problem(input_bounds, output_names)
        self.horizon = horizon_for(model, self.problem)
        self.safe_input = admissible_input("safe_input", settings.safe_input, self.problem.input_bounds)
        self.solver = solver_named(settings.qp, *self.problem.size) if solver is None else solver
        # with a rate limit and obstacles a start one stage on was found to take more iterations, not fewer
        self._advance = None if self.problem.input_step is not None else getattr(self.solver, "advance", None)
        self._largest_norm = settings.range_factor * float(np.linalg.norm(model.state_scale))
        # a model in discrete time need not know steps as short as the measurements'
        observer = settings.observer
        self._fine = model.at_timestep(self.timestep) if observer or self._age else None
        self.estimator = observer(self._fine, self.problem.input_scale) if observer else ChartEstimator(model, stride)
        self._warm_up()

    def data_sheet(self) -> tuple[str, dict]:
        settings, (lower, upper) = self.settings, self.problem.input_bounds
        inputs = [f"u{place}" for place in range(1, len(lower) + 1)]
        rate = "" if settings.input_rate is None else f", at most {settings.input_rate} per s"
        model = f"{self.model.state_dim} states, {self.model.input_dim} inputs, {self.model.output_dim} outputs"
        return f"{type(self).__name__}: {self.task.name!r} with {settings.qp}", {
            "model": f"{type(self.model).__name__}, {model}",
            "plans": f"every {sheet.period(self.period)}, over {settings.horizon} of these periods",
            "measurements": f"every {sheet.period(self.timestep)}, "
                            + (f"{settings.measurement_delay:g} s late" if self._age else "without delay"),
            "inputs: bounds" + rate: sheet.spans(inputs, lower, upper, ""),
            "weights": f"outputs {settings.output_weight:g} 1/m², inputs {settings.input_weight}",
            "programs": f"{settings.iterations} per step, {settings.first_iterations} after a start",
            "state from": type(self.estimator).__name__,
            "fallbacks": sum(self.fallbacks.values())}

    def _problem(self, input_bounds, output_names) -> TrackingProblem:
        settings, p, columns = self.settings, self.model.output_dim, self.task.columns(output_names)
        if max(columns) >= p:
            raise ValueError(f"the task tracks output {max(columns)}; the model has {p} outputs")
        tracked = np.zeros(p)
        tracked[list(columns)] = 1.0
        weight = settings.output_weight
        linear, quadratic = (2.0 * settings.horizon * PULL * weight, 10.0 * weight) \
            if settings.violation_weight is None else settings.violation_weight
        constraints = constraints_of(self.task, columns, p, settings, linear=linear, quadratic=quadratic)
        return TrackingProblem(_Reference(self.task, columns, p), input_bounds, weight * tracked,
                               settings.input_weight, settings.terminal_weight * tracked, settings.input_rate,
                               settings.horizon, settings.period, constraints)

    def _warm_up(self) -> None:
        self.reset()
        zero = np.zeros(self.model.output_dim)
        for k in range(self._samples_per_step + 1):
            self(k * self.timestep, zero)
            self.prepare()
        self.reset()

    def reset(self) -> None:
        """Forget measurements, plans and counts."""
        self.estimator.reset()
        # the input before the measurement that comes next, and those since
        self._applied = deque([self.safe_input] * (self._age + 1), maxlen=self._age + 1)
        self._last_input = self.safe_input
        self._plan: Plan | None = None
        self._planned_now, self._prepared = False, None
        self._seen, self._repeats, self._input_then = None, 0, self.safe_input
        self._sample = 0
        self.fallbacks: Counter[Status] = Counter()
        self.solver.reset()

    def __call__(self, time: float, observation: np.ndarray) -> Command:
        """time in s; observation (p,), m. Raises ValueError for an observation of another size."""
        observation = np.array(observation, dtype=np.float64)
        if observation.shape != (self.model.output_dim,):
            raise ValueError(f"the observation has shape {observation.shape}; "
                             f"expected ({self.model.output_dim},)")
        self._watch_sensor(observation)
        # Overflow is no accident here: it is how a state far outside the model's range shows.
        with np.errstate(over="ignore", invalid="ignore"):
            self.estimator.measure(observation, self._applied[0])
            due = self._sample % self._samples_per_step == 0
            command = self._decide(time) if due else Command(self._last_input.copy(), held=True)
        self._last_input = command.input.copy()
        self._applied.append(self._last_input)
        self._sample += 1
        return command

    def follow(self, observation: np.ndarray, last_input: np.ndarray) -> tuple[np.ndarray, ...]:
        """The state now and the offsets of `Estimator.state`, from a measurement that comes after last_input (m,).

        For runs that something else steered: nothing is planned, and `reset` must come before the next call of this
        controller.
        """
        self._applied.append(np.array(last_input, dtype=np.float64))
        with np.errstate(over="ignore", invalid="ignore"):
            self.estimator.measure(np.array(observation, dtype=np.float64), self._applied[0])
            state, self.horizon.input_offset, self.horizon.output_offset = self.estimator.state()
            return (self._bridged(state) if self._age else state), self.horizon.input_offset, self.horizon.output_offset

    def prepare(self) -> None:
        """Linearize and condense around the plan for the next step; to be called when the input has been sent."""
        self._prepared = None
        disturbed = self.horizon.input_offset is not None or self.horizon.output_offset is not None
        if disturbed or self._plan is None or not self._planned_now or self._sample % self._samples_per_step:
            return  # an estimated disturbance moves with the next measurement, and the linearization with it
        time, guess = self._plan.time + self.period, self._plan.shifted()
        reference = self.problem.reference_ahead(time)
        guess = self.problem.admissible(guess, self._last_input)
        with np.errstate(over="ignore", invalid="ignore"):
            self._prepared = time, self.horizon.condense(self._plan.states[1], guess, reference)

    def _watch_sensor(self, observation: np.ndarray) -> None:
        """Count equal measurements in a row, and remember the input at the first of them."""
        if self._seen is None or (observation != self._seen).any():
            self._seen, self._repeats, self._input_then = observation, 0, self._last_input
        else:
            self._repeats += 1

    @property
    def _frozen(self) -> bool:
        if not 0 < self.settings.frozen_after <= self._repeats:
            return False
        return bool((np.abs(self._last_input - self._input_then) > MOVED * self.problem.input_scale).any())

    def _decide(self, time: float) -> Command:
        state, self.horizon.input_offset, self.horizon.output_offset = self.estimator.state()
        plan = None
        if self._age:
            state = self._bridged(state)
        if self._frozen:
            status = Status.FROZEN_SENSOR
        elif isfinite(time) and sqrt(state @ state) <= self._largest_norm:
            plan = self._solve(time, state)
            status = plan.qp_status
        else:
            known = isfinite(time) and np.isfinite(state).all()
            status = Status.OUT_OF_RANGE if known else Status.NOT_FINITE
        if not status.success:
            return self._fall_back(time, plan, status)
        self._plan, self._planned_now, self._prepared = plan, True, None
        return Command(plan.inputs[0].copy(), plan)

    def _bridged(self, state: np.ndarray) -> np.ndarray:
        """The state now, of one that is as old as the measurements are."""
        offset = self.horizon.input_offset
        for applied in list(self._applied)[1:]:
            state = self._fine.step(state, applied if offset is None else applied + offset)
        return state

    def _solve(self, time: float, state: np.ndarray) -> Plan:
        steps = self._steps_since_plan(time)
        if steps is None:
            guess = np.tile(self._last_input, (self.problem.horizon, 1))
        else:
            guess = self._plan.shifted(steps)
        reference = self.problem.reference_ahead(time)
        continued = self._planned_now and steps == 1 and continues(reference, self._plan.reference, REFERENCE_CHANGE)
        iterations = self.settings.iterations
        if not continued:
            iterations = max(iterations, self.settings.first_iterations)
        if continued and self._advance is not None:
            self._advance(*self.problem.continuation)
        prepared = None
        if continued and self._prepared is not None and abs(self._prepared[0] - time) < 0.1 * self.period:
            prepared = self._prepared[1]
        return solve_scp(self.problem, self.horizon, state, guess, self.solver, time=time,
                         reference=reference, last_input=self._last_input, max_iterations=iterations,
                         tolerance=self.settings.tolerance, prepared=prepared)

    def _steps_since_plan(self, time: float) -> int | None:
        """Control steps since the last plan, or None where it says nothing about now."""
        if self._plan is None:
            return None
        steps = (time - self._plan.time) / self.period
        inside = abs(steps - round(steps)) < 0.1 and 0 < round(steps) < self.problem.horizon
        return round(steps) if inside else None

    def _fall_back(self, time: float, plan: Plan | None, status: Status) -> Command:
        self.fallbacks[status] += 1
        self._planned_now, self._prepared = False, None
        self.solver.reset()
        steps = self._steps_since_plan(time) if isfinite(time) else None
        intended = self.safe_input if steps is None else self._plan.inputs[steps]
        admissible = self.problem.admissible(intended[None], self._last_input)[0]
        return Command(admissible, plan, status)


def _seen(model, output_names):
    """The names of the outputs, those of the model where none are given. Raises ValueError for any but these."""
    own = getattr(model, "output_names", None)
    if output_names is None:
        return own
    if own is not None and tuple(output_names) != tuple(own) or len(output_names) != model.reduced.output_dim:
        raise ValueError(f"output_names are {list(output_names)}; the model has {model.reduced.output_dim} outputs"
                         f"{'' if own is None else f', {list(own)}'}: name these, in this order")
    return output_names


class _Reference:
    """The task's reference in the columns that it tracks, zero in the others, which weigh nothing."""

    def __init__(self, task, columns: tuple[int, ...], output_dim: int):
        self.task, self.columns, self.output_dim = task, list(columns), output_dim

    def __call__(self, time: np.ndarray) -> np.ndarray:
        reference = np.zeros((len(time), self.output_dim))
        reference[:, self.columns] = self.task.reference(time)
        return reference
