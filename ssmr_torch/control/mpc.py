"""Model predictive control: measurements → reduced state → plan → first input, at every control step."""

from __future__ import annotations

from collections import Counter, deque
from math import isfinite, sqrt

import numpy as np

from ssmr_torch.control.base import Command, whole_steps
from ssmr_torch.control.condensing import continues
from ssmr_torch.control.constraints import constraints_of
from ssmr_torch.control.estimation import ChartEstimator
from ssmr_torch.control.horizon import horizon_for
from ssmr_torch.control.problem import INPUT_WEIGHT, OUTPUT_WEIGHT, TrackingProblem
from ssmr_torch.control.scp import Plan, solve_scp
from ssmr_torch.control.solvers import solver_named
from ssmr_torch.status import Status

# A reference that differs by more than this from the one planned for is a new one, m.
REFERENCE_CHANGE = 1e-6
# A violation costs more than tracking errors of this size at every stage would, m: more than any in the workspace.
PULL = 0.05
# Share of an input's range by which it must have changed for a measurement to have to change.
MOVED = 0.05


class ModelPredictiveController:
    """Receding-horizon tracking with a reduced model (paper, section 4.4; see `TrackingProblem`).

    model: NumPy encode, decode, rollout, linearize, linearize_output, at_timestep; such as PolynomialTables.
    task: `columns(output_names)` and `reference(time)`, perhaps `obstacles`, such as `tasks.references.Task`.
    input_bounds: (2, m).   timestep: time between two measurements, s; default the model's window_timestep.
    period: time between two plans, s, a multiple of timestep; the input is held in between.
    output_weight: on every tracked output, 1/m².   terminal_weight: added to it at the horizon's end, 1/m².
    input_weight: 1/N².   input_rate: N/s.   safe_input: (m,), default the admissible input nearest to zero.
    output_bounds: (2, p) m, soft.   margins: (N,) m, by which obstacles and output bounds are tightened at each stage.
    violation_weight: (1/m, 1/m²) of the exact penalty, see `OutputConstraints`; default from output_weight.
    iterations: quadratic programs per step; one is the real-time iteration.   first_iterations: the same
    after a start, a fallback, a gap in time or a change of the reference.
    range_factor: a state is not believed when its norm exceeds that of state_scale by this factor.
    observer: (model at timestep, input range) → `Estimator`, such as a partial `KalmanObserver`; nothing: the chart.
    measurement_delay: s, a whole number of timesteps, by which measurements are old; the model bridges it.
    frozen_after: so many measurements, equal to the last bit while the input changed, are a frozen sensor; 0: never.
    qp: proxqp, daqp or qpsolvers:NAME.   solver: an object with `solve(QuadraticProgram)` and `reset()` instead, and
    perhaps `advance`, see `ProxQP`.

    A step that cannot be trusted falls back to the plan made last, then to safe_input, under the same bounds
    and rate; `fallbacks` counts the reasons by Status. Everything is compiled and run once at construction.
    `prepare` may be called between two measurements: it linearizes and condenses around the shifted plan, and the next
    step only has to solve.
    Raises ValueError when a period is not a multiple of the timestep or sizes disagree.
    """

    def __init__(self, model, task, input_bounds, *, timestep: float | None = None, output_names=None,
                 horizon: int = 5, period: float = 0.02, output_weight: float = OUTPUT_WEIGHT,
                 input_weight=INPUT_WEIGHT, terminal_weight: float = 0.0, input_rate=None, safe_input=None,
                 output_bounds=None, margins=None, violation_weight=None, iterations: int = 1,
                 first_iterations: int = 3, tolerance: float = 1e-6, range_factor: float = 3.0, observer=None,
                 measurement_delay: float = 0.0, frozen_after: int = 5, qp: str = "proxqp", solver=None):
        if iterations < 1 or first_iterations < 1 or frozen_after < 0:
            raise ValueError(f"iterations is {iterations}, first_iterations {first_iterations} and frozen_after "
                             f"{frozen_after}; expected 1 or more, and no negative number")
        self.model, self.task = model, task
        self.timestep = float(model.window_timestep if timestep is None else timestep)
        self.period = float(period)
        self._samples_per_step = whole_steps("period", period, self.timestep)
        stride = whole_steps("the model's window_timestep", model.window_timestep, self.timestep)
        self._age = whole_steps("measurement_delay", measurement_delay, self.timestep) if measurement_delay else 0
        self.problem = self._problem(input_bounds, output_names, int(horizon), output_weight, terminal_weight,
                                     input_weight, input_rate, output_bounds, margins, violation_weight)
        self.horizon = horizon_for(model, self.problem)
        self.safe_input = self._safe_input(safe_input)
        self.solver = solver_named(qp, *self.problem.size) if solver is None else solver
        # with a rate limit and obstacles a start one stage on was found to take more iterations, not fewer
        self._advance = None if self.problem.input_step is not None else getattr(self.solver, "advance", None)
        self.iterations, self.first_iterations = int(iterations), int(first_iterations)
        self.tolerance, self.frozen_after = float(tolerance), int(frozen_after)
        self._largest_norm = float(range_factor) * float(np.linalg.norm(model.state_scale))
        # a model in discrete time need not know steps as short as the measurements'
        self._fine = model.at_timestep(self.timestep) if observer or self._age else None
        self.estimator = observer(self._fine, self.problem.input_scale) if observer else ChartEstimator(model, stride)
        self._warm_up()

    def _problem(self, input_bounds, output_names, horizon, output_weight, terminal_weight, input_weight, input_rate,
                 output_bounds, margins, violation_weight) -> TrackingProblem:
        p, columns = self.model.output_dim, self.task.columns(output_names)
        if max(columns) >= p:
            raise ValueError(f"the task tracks output {max(columns)}; the model has {p} outputs")
        tracked = np.zeros(p)
        tracked[list(columns)] = 1.0
        linear, quadratic = (2.0 * horizon * PULL * output_weight, 10.0 * output_weight) if violation_weight is None \
            else violation_weight
        constraints = constraints_of(self.task, columns, p, horizon, output_bounds=output_bounds, margins=margins,
                                     linear=linear, quadratic=quadratic)
        return TrackingProblem(_Reference(self.task, columns, p), input_bounds, output_weight * tracked, input_weight,
                               terminal_weight * tracked, input_rate, horizon, self.period, constraints)

    def _safe_input(self, safe_input) -> np.ndarray:
        zero = np.clip(0.0, *self.problem.input_bounds)
        safe = zero if safe_input is None else np.array(safe_input, dtype=np.float64)
        lower, upper = self.problem.input_bounds
        if safe.shape != lower.shape or not ((lower <= safe) & (safe <= upper)).all():
            raise ValueError(f"safe_input is {safe.tolist()}; expected {len(lower)} numbers "
                             f"between {lower.tolist()} and {upper.tolist()}")
        return safe

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
        if not 0 < self.frozen_after <= self._repeats:
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
        iterations = self.iterations if continued else max(self.iterations, self.first_iterations)
        if continued and self._advance is not None:
            self._advance(*self.problem.continuation)
        prepared = None
        if continued and self._prepared is not None and abs(self._prepared[0] - time) < 0.1 * self.period:
            prepared = self._prepared[1]
        return solve_scp(self.problem, self.horizon, state, guess, self.solver, time=time,
                         reference=reference, last_input=self._last_input, max_iterations=iterations,
                         tolerance=self.tolerance, prepared=prepared)

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


class _Reference:
    """The task's reference in the columns that it tracks, zero in the others, which weigh nothing."""

    def __init__(self, task, columns: tuple[int, ...], output_dim: int):
        self.task, self.columns, self.output_dim = task, list(columns), output_dim

    def __call__(self, time: np.ndarray) -> np.ndarray:
        reference = np.zeros((len(time), self.output_dim))
        reference[:, self.columns] = self.task.reference(time)
        return reference
