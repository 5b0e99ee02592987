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
from ssmr_torch.control.mpc_settings import PredictiveControlSettings
from ssmr_torch.control.problem_from_settings import TrackedReference, actuator_of, names_seen, tracking_problem
from ssmr_torch.control.sampling import Sample, Sampling
from ssmr_torch.control.scp import Plan, solve_scp
from ssmr_torch.control.solvers import solver_named
from ssmr_torch.control.stepping import Stepper
from ssmr_torch.data_sheet import DataSheet
from ssmr_torch.keywords import configurable
from ssmr_torch.periods import whole_steps
from ssmr_torch.status import Status

if TYPE_CHECKING:
    from ssmr_torch.models.base import Model
    from ssmr_torch.tasks.references import Task
    from ssmr_torch.trained_model import TrainedModel

# A reference that differs by more than this from the one planned for is a new one, m.
REFERENCE_CHANGE = 1e-6
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
    and rate; `fallbacks` counts the reasons by Status, and `counts` what happened to time and measurements, see
    `Sampling`, `KalmanObserver`, and below. The time of a call places it among the samples: skipped ones are told to
    the estimator as missing, and where the time has jumped the controller begins anew from where the robot is.
    `input_bounds` can be changed between steps without losing window, plan and observer. A controller can be copied and
    pickled, and the copy gives the same commands, to the last bit. Everything is compiled and run once at construction.
    `prepare` may be called between two measurements: it linearizes and condenses around the shifted plan, and the next
    step only has to solve.
    Raises ValueError when a period is not a multiple of the timestep or sizes or names disagree, TypeError for a change
    of what is no setting and for what is no model.
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
        # with a rate limit and obstacles a start one stage on was found to take more iterations, not fewer
        self._advance = None if self.problem.input_step is not None else getattr(self.solver, "advance", None)
        self._largest_norm = settings.range_factor * float(np.linalg.norm(model.state_scale))
        # a model in discrete time need not know steps as short as the measurements'
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
        """How often what happened since the last reset, by name; beside those of sampling and estimator: steps that
        were "cut short" by the budget, or "late" all the same, and "arithmetic" that failed.
        """
        return self._counts + self._sampling.counts + getattr(self.estimator, "counts", Counter())

    @property
    def input_bounds(self) -> np.ndarray:
        """(2, m), of the commands from now on; equal ones hold an actuator still.

        Bounds that cannot be met at the allowed rate are met at once. Setting them raises ValueError, with both
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
        """Of what is planned, under commands within bounds (2, m)."""
        return self.actuator.actuator.reachable(bounds) if self.actuator.actuator.rubs else bounds

    def _warm_up(self) -> None:
        self._budget = inf  # what is compiled takes its time
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
        """Forget the robot's past, all but the input that it was told last."""
        getattr(self.estimator, "forget", self.estimator.reset)()
        # what acted before the measurement that comes next, and since
        self._applied = deque([self.actuator.acting] * (self._age + 1), maxlen=self._age + 1)
        self._reference.begin_at(None, 0.0)
        self._plan: Plan | None = None
        self._planned_now, self._prepared = False, None
        self._seen, self._repeats, self._input_then = None, 0, self._last_input
        self.horizon.input_offset = self.horizon.output_offset = None
        self.solver.reset()

    def __call__(self, time: float, observation: np.ndarray) -> Command:
        """time in s; observation (p,), m, whatever its values. Raises ValueError for one of another size."""
        began = thread_time()
        self._deadline = began + self._budget
        if hasattr(self.solver, "deadline"):
            self.solver.deadline = self._deadline
        sample = self._sampling.take(time, observation)
        if not sample.new:
            self.fallbacks[Status.WRONG_TIME] += 1
            return Command(self._last_input.copy(), fallback=Status.WRONG_TIME)
        # Overflow is no accident here: it is how a state far outside the model's range shows.
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            try:
                command = self._answered(sample)
            except (ArithmeticError, np.linalg.LinAlgError):  # of a state or a measurement that no model knows
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
        """The last input is given until the next sample."""
        self.actuator.apply(self._last_input)
        self._applied.append(self.actuator.acting)

    def prepare(self) -> None:
        """Linearize and condense around the plan for the next step; to be called when the input has been sent."""
        self._prepared = None
        disturbed = self._lead or self.horizon.input_offset is not None or self.horizon.output_offset is not None
        if disturbed or self._plan is None or not self._planned_now or not self._sampling.due_next:
            return  # an estimated disturbance moves with the next measurement, and the linearization with it
        time, guess = self._plan.time + self.period, self._plan.shifted()
        reference = self.problem.reference_ahead(time)
        guess = self.problem.admissible(guess, self._held)
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

    @property
    def _held(self) -> np.ndarray:
        """What the last command transmits, from which the next one counts."""
        return self.actuator.transmitted

    def _decide(self, time: float) -> Command:
        time = time + self._lead  # of the first input that can still be chosen, when it acts
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
        """The command (m,) that transmits this, within the bounds."""
        if not self.actuator.actuator.rubs:
            return wanted.copy()
        return np.clip(self.actuator.actuator.crossing(self._held, wanted), *self._bounds)

    def _bridged(self, state: np.ndarray, acting) -> np.ndarray:
        """The state when the next input acts, of one that is as old as the measurements are."""
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
        tracked = self._reference.columns  # a posture moves with the disturbance, and is no new reference
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
        """Control steps since the last plan, the nearest number, or None where it says nothing about now."""
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
