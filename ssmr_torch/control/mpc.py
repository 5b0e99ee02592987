"""Model predictive control: measurements → reduced state → plan → first input, at every control step."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Sequence
from math import inf, isfinite, sqrt
from time import thread_time
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ssmr_torch import data_sheet as sheet
from ssmr_torch.control.actuator import ActuatorState
from ssmr_torch.control.base import Command
from ssmr_torch.control.chart_estimator import ChartEstimator
from ssmr_torch.control.condensing import continues
from ssmr_torch.control.horizon import horizon_for
from ssmr_torch.control.input_bounds import admissible_input
from ssmr_torch.control.model_step import Stepper
from ssmr_torch.control.mpc_settings import PredictiveControlSettings
from ssmr_torch.control.problem_from_settings import TrackedReference, actuator_of, names_seen, tracking_problem
from ssmr_torch.control.sampling import Sample, Sampling
from ssmr_torch.control.scp import Plan, solve_scp
from ssmr_torch.control.solvers import solver_named
from ssmr_torch.data_sheet import DataSheet
from ssmr_torch.keywords import configurable
from ssmr_torch.periods import whole_steps
from ssmr_torch.status import Status

if TYPE_CHECKING:
    from ssmr_torch.models.base import Model
    from ssmr_torch.tasks.references import Task
    from ssmr_torch.trained_model import TrainedModel

# m: a reference that differs by more than this from the planned one counts as a new reference.
REFERENCE_CHANGE = 1e-6
# If an input has changed by more than this share of its range, the measurement must change, too.
MOVED = 0.05


class ModelPredictiveController(DataSheet):
    """Receding-horizon tracking with a reduced model (paper, section 4.4; see `TrackingProblem`).

    model: a `Model`, or an object that has one as `reduced`, such as a Torch module.
    task: with `columns(output_names)` and `reference(time)`, perhaps `obstacles`, such as `tasks.references.Task`.
    input_bounds: (2, m).   timestep: s, between two measurements; default: the model's window_timestep.
    output_names: of the observations; default: those of the model.
    settings: `PredictiveControlSettings`, where each one is explained; changes: some of them by name.
    solver: an object with `solve(QuadraticProgram)` and `reset()`, in place of the solver in the setting qp; it may
    have `advance`, see `ProxQP`.

    A step without a usable result falls back to the last plan, and later to safe_input, under the same bounds and rate.
    `fallbacks` counts the reasons by Status. `counts` counts events in time and measurements, see `Sampling`,
    `KalmanObserver`, and below. The time of a call gives its place among the samples. Skipped samples are missing
    measurements for the estimator. After a jump in time the controller starts again at the robot's position.
    `input_bounds` can be changed between steps; window, plan and observer are kept. A controller can be copied and
    pickled, and the copy gives exactly the same commands. Everything is compiled and run once at construction.
    `prepare` may be called between two measurements: it linearizes and condenses around the shifted plan, so that the
    next step only has to solve.
    Raises ValueError when a period is not a multiple of the timestep, or when sizes or names disagree; TypeError for an
    unknown setting, and for a model or settings of the wrong type.
    """

    @configurable(PredictiveControlSettings, given=("settings", "timestep", "output_names", "solver"))
    def __init__(self, model: Model | TrainedModel, task: Task, input_bounds: npt.ArrayLike,
                 settings: PredictiveControlSettings | None = None, *, timestep: float | None = None,
                 output_names: Sequence[str] | None = None, solver: Any = None, **changes: Any):
        if not isinstance(settings, PredictiveControlSettings | None) or not hasattr(model, "reduced"):
            raise TypeError(f"model is a {type(model).__name__}, settings a {type(settings).__name__}; "
                            "expected a model, as ssmr_torch.load returns it, and PredictiveControlSettings")
        settings = (PredictiveControlSettings() if settings is None else settings).changed(**changes)
        self.output_names = output_names = names_seen(model, output_names)
        self.model, self.task, self.settings = model.reduced.numpy(), task, settings
        model = self.model
        self.timestep = float(model.window_timestep if timestep is None else timestep)
        self.period = settings.period
        every = whole_steps("period", self.period, self.timestep)
        stride = whole_steps("the model's window_timestep", model.window_timestep, self.timestep)
        self._age = whole_steps("measurement_delay", settings.measurement_delay, self.timestep) \
            if settings.measurement_delay else 0
        self._bounds = np.array(input_bounds, dtype=np.float64)
        self.actuator = ActuatorState(actuator_of(settings, self._bounds, self.timestep))
        self._lead = self.actuator.actuator.delay * self.timestep
        self._reference = TrackedReference(task, output_names, model.output_dim, settings.approach,
                                           settings.posture)
        self.problem = tracking_problem(settings, self._reference, self._bounds, self.actuator.actuator)
        self.horizon = horizon_for(model, self.problem, self.actuator.actuator)
        self.safe_input = self._safe = admissible_input("safe_input", settings.safe_input, self._bounds)
        self.solver = solver_named(settings.qp, *self.problem.size) if solver is None else solver
        # With a rate limit and obstacles, a start from the next stage took more iterations, not fewer.
        self._advance = None if self.problem.input_step is not None else getattr(self.solver, "advance", None)
        self._largest_norm = settings.range_factor * float(np.linalg.norm(model.state_scale))
        # A model in discrete time may not have steps as short as the timestep of the measurements.
        observer = settings.observer
        fine = model.at_timestep(self.timestep) if observer or self._age or self._lead else None
        self._step = None if fine is None else Stepper(fine)
        self.estimator = observer(fine, self.problem.input_scale) if observer else ChartEstimator(model, stride)
        self._sampling = Sampling(model, self.timestep, every, max(settings.horizon * every, model.delays * stride))
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
            "weights": f"outputs {settings.output_weight:g} 1/m²; of the range: inputs {settings.input_weight}, moves "
                       f"{settings.move_weight}",
            "programs": f"{settings.iterations} per step, {settings.first_iterations} after a start",
            "state from": type(self.estimator).__name__,
            "fallbacks": sum(self.fallbacks.values()),
            "counted": ", ".join(f"{count} {name}" for name, count in sorted(self.counts.items())) or "nothing else"}

    @property
    def counts(self) -> Counter[str]:
        """Counts of events since the last reset, by name. Besides those of sampling and estimator: "cut short", steps
        that the budget ended early; "late", steps over the budget; "arithmetic", steps with a numerical error.
        """
        return self._counts + self._sampling.counts + getattr(self.estimator, "counts", Counter())

    @property
    def input_bounds(self) -> np.ndarray:
        """(2, m), for all later commands. With equal bounds the input stays constant.

        Bounds that cannot be reached at the allowed rate are applied at once. Setting them raises ValueError, with both
        numbers, where they are crossed or not finite.
        """
        return self._bounds.copy()

    @input_bounds.setter
    def input_bounds(self, bounds) -> None:
        self.problem = self.horizon.problem = self.problem.bounded(self._plannable(bounds))
        self._bounds = np.array(bounds, dtype=np.float64)
        self.safe_input = np.clip(self._safe, *self._bounds)
        self._last_input = np.clip(self._last_input, *self._bounds)
        self._prepared = None

    def _plannable(self, bounds) -> np.ndarray:
        """Bounds of the planned (transmitted) inputs, for commands within bounds (2, m)."""
        return self.actuator.actuator.reachable(bounds) if self.actuator.actuator.rubs else bounds

    def _warm_up(self) -> None:
        self._budget = inf  # compiling takes time
        self.reset()
        zero = np.zeros(self.model.output_dim)
        for k in range(self._sampling.every + 1):
            self(k * self.timestep, zero)
            self.prepare()
        self.reset()
        if self.settings.step_budget is not None:
            self._budget = self.settings.step_budget * self.period

    def reset(self) -> None:
        """Forget measurements, plans and counts."""
        self.estimator.reset()
        self._sampling.reset()
        self.fallbacks: Counter[Status] = Counter()
        self._counts: Counter[str] = Counter()
        self.actuator.rest_at(self.safe_input)
        self._last_input = self.safe_input
        self._start_anew()

    def _start_anew(self) -> None:
        """Forget the robot's past, except the last input that it got."""
        getattr(self.estimator, "forget", self.estimator.reset)()
        # The inputs that acted before the next measurement, and since then.
        self._applied = deque([self.actuator.acting] * (self._age + 1), maxlen=self._age + 1)
        self._reference.begin_at(None, 0.0)
        self._plan: Plan | None = None
        self._planned_now, self._prepared = False, None
        self._seen, self._repeats, self._input_then = None, 0, self._last_input
        self.horizon.input_offset = self.horizon.output_offset = None
        self.solver.reset()

    def __call__(self, time: float, observation: np.ndarray) -> Command:
        """The command at time s for any observation (p,), m. Raises ValueError for an observation of another size."""
        began = thread_time()
        self._deadline = began + self._budget
        if hasattr(self.solver, "deadline"):
            self.solver.deadline = self._deadline
        sample = self._sampling.take(time, observation)
        if not sample.new:
            self.fallbacks[Status.WRONG_TIME] += 1
            return Command(self._last_input.copy(), fallback=Status.WRONG_TIME)
        # Overflow is expected here: it shows that a state is far outside the model's range.
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            try:
                command = self._answered(sample)
            except (ArithmeticError, np.linalg.LinAlgError):  # for a state or measurement outside the model's domain
                self._counts["arithmetic"] += 1
                self._start_anew()
                command = self._fall_back(sample.time, None, Status.NOT_FINITE)
        self._last_input = command.input.copy()
        self._act()
        self._counts["late"] += thread_time() - began > self._budget
        return command

    def _answered(self, sample: Sample) -> Command:
        if sample.anew:
            self._start_anew()
        for _ in range(sample.missed):
            self.estimator.measure(np.full_like(sample.observation, np.nan), self._applied[0])
            self._act()
        self._watch_sensor(sample.observation)
        self.estimator.measure(sample.observation, self._applied[0])
        if not self._reference.begun and np.isfinite(sample.observation).all():
            self._reference.begin_at(sample.observation, sample.time + self._lead)
        return self._decide(sample.time) if sample.due else Command(self._last_input.copy(), held=True)

    def _act(self) -> None:
        """The last input is applied until the next sample."""
        self.actuator.apply(self._last_input)
        self._applied.append(self.actuator.acting)

    def prepare(self) -> None:
        """Linearize and condense around the plan for the next step. Call it after the input has been sent."""
        self._prepared = None
        disturbed = self._lead or self.horizon.input_offset is not None or self.horizon.output_offset is not None
        if disturbed or self._plan is None or not self._planned_now or not self._sampling.due_next:
            return  # the next measurement changes an estimated disturbance, and so the linearization
        time, guess = self._plan.time + self.period, self._plan.shifted()
        reference = self.problem.reference_ahead(time)
        guess = self.problem.admissible(guess, self._held)
        with np.errstate(over="ignore", invalid="ignore"):
            self._prepared = time, self.horizon.condense(self._plan.states[1], guess, reference)

    def _watch_sensor(self, observation: np.ndarray) -> None:
        """Count equal measurements in a row, and store the input at the first of them."""
        if self._seen is None or (observation != self._seen).any():
            self._seen, self._repeats, self._input_then = observation, 0, self._last_input
        else:
            self._repeats += 1

    @property
    def _frozen(self) -> bool:
        if not 0 < self.settings.frozen_after <= self._repeats:
            return False
        return bool((np.abs(self._last_input - self._input_then) > MOVED * self.problem.input_scale).any())

    @property
    def _held(self) -> np.ndarray:
        """The transmitted part of the last command, from which changes are counted."""
        return self.actuator.transmitted

    def _decide(self, time: float) -> Command:
        time = time + self._lead  # when the first input acts that can still be chosen
        state, self.horizon.input_offset, self.horizon.output_offset = self.estimator.state()
        self._reference.disturbance, plan = self.horizon.output_offset, None
        decided, self.horizon.lagged_from = self.actuator.decided()
        if self._age or self._lead:
            state = self._bridged(state, [*list(self._applied)[1:], *decided])
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
        return Command(self._crossing(plan.inputs[0]), plan)

    def _crossing(self, wanted: np.ndarray) -> np.ndarray:
        """The command (m,) within the bounds that transmits this input."""
        if not self.actuator.actuator.rubs:
            return wanted.copy()
        return np.clip(self.actuator.actuator.crossing(self._held, wanted), *self._bounds)

    def _bridged(self, state: np.ndarray, acting) -> np.ndarray:
        """The state when the next input acts, from a state that is as old as the measurements."""
        offset = self.horizon.input_offset
        for applied in acting:
            state, _ = self._step(state, applied if offset is None else applied + offset)
        return state

    def _solve(self, time: float, state: np.ndarray) -> Plan:
        steps = self._steps_since_plan(time)
        if steps is None:
            guess = np.tile(self._held, (self.problem.horizon, 1))
        else:
            guess = self._plan.shifted(steps)
        reference = self.problem.reference_ahead(time)
        in_time = steps == 1 and abs(time - self._plan.time - self.period) < 0.1 * self.period
        tracked = self._reference.columns  # a posture changes with the disturbance, which is not a new reference
        continued = self._planned_now and in_time and continues(reference[:, tracked], self._plan.reference[:, tracked],
                                                                REFERENCE_CHANGE)
        iterations = self.settings.iterations
        if not continued:
            iterations = max(iterations, self.settings.first_iterations)
        if continued and self._advance is not None:
            self._advance(*self.problem.continuation)
        prepared = None
        if continued and self._prepared is not None and abs(self._prepared[0] - time) < 0.1 * self.period:
            prepared = self._prepared[1]
        plan = solve_scp(self.problem, self.horizon, state, guess, self.solver, time=time,
                         reference=reference, last_input=self._held, max_iterations=iterations,
                         tolerance=self.settings.tolerance, prepared=prepared, deadline=self._deadline)
        stopped = plan.status is Status.ITERATION_LIMIT and (plan.qp_status.success or not plan.iterations)
        self._counts["cut short"] += stopped and plan.iterations < iterations
        return plan

    def _steps_since_plan(self, time: float) -> int | None:
        """Control steps since the last plan, rounded; None where the plan does not cover the present time."""
        if self._plan is None:
            return None
        steps = (time - self._plan.time) / self.period
        return round(steps) if 0.5 < steps < self.problem.horizon - 0.5 else None

    def _fall_back(self, time: float, plan: Plan | None, status: Status) -> Command:
        self.fallbacks[status] += 1
        self._planned_now, self._prepared = False, None
        self.solver.reset()
        steps = self._steps_since_plan(time) if isfinite(time) else None
        intended = self.safe_input if steps is None else self._plan.inputs[steps]
        admissible = self.problem.admissible(intended[None], self._held)[0]
        return Command(self._crossing(admissible), plan, status)
