"""Model predictive control: window of measurements → chart → plan → first input, at every control step."""

from __future__ import annotations

from collections import Counter, deque

import numpy as np

from ssmr_torch.control.base import Command, whole_steps
from ssmr_torch.control.horizon import horizon_for
from ssmr_torch.control.problem import INPUT_WEIGHT, OUTPUT_WEIGHT, TrackingProblem
from ssmr_torch.control.qp import ProxQP
from ssmr_torch.control.scp import Plan, solve_scp
from ssmr_torch.status import Status

# A reference that differs by more than this from the one planned for is a new one, m.
REFERENCE_CHANGE = 1e-6


class ModelPredictiveController:
    """Receding-horizon tracking with a reduced model (paper, section 4.4; see `TrackingProblem`).

    model: NumPy encode, decode, rollout, linearize, linearize_output, at_timestep; such as PolynomialTables.
    task: `columns(output_names)` and `reference(time)`, such as `tasks.references.Task`.
    input_bounds: (2, m).   timestep: time between two measurements, s; default the model's window_timestep.
    period: time between two plans, s, a multiple of timestep; the input is held in between.
    output_weight: on every tracked output, 1/m².   terminal_weight: added to it at the horizon's end, 1/m².
    input_weight: 1/N².   input_rate: N/s.   safe_input: (m,), default the admissible input nearest to zero.
    iterations: quadratic programs per step; one is the real-time iteration.   first_iterations: the same
    after a start, a fallback, a gap in time or a change of the reference.
    range_factor: a state is not believed when its norm exceeds that of state_scale by this factor.
    solver: with `solve(QuadraticProgram)` and `reset()`; default ProxQP.

    A step that cannot be trusted falls back to the plan made last, then to safe_input, under the same bounds
    and rate; `fallbacks` counts the reasons by Status. Everything is compiled and run once at construction.
    Raises ValueError when a period is not a multiple of the timestep or sizes disagree.
    """

    def __init__(self, model, task, input_bounds, *, timestep: float | None = None, output_names=None,
                 horizon: int = 5, period: float = 0.02, output_weight: float = OUTPUT_WEIGHT,
                 input_weight=INPUT_WEIGHT, terminal_weight: float = 0.0, input_rate=None, safe_input=None,
                 iterations: int = 1, first_iterations: int = 3, tolerance: float = 1e-6,
                 range_factor: float = 3.0, solver=None):
        if iterations < 1 or first_iterations < 1:
            raise ValueError(f"iterations is {iterations} and first_iterations {first_iterations}; "
                             "expected 1 or more")
        self.model, self.task = model, task
        self.timestep = float(model.window_timestep if timestep is None else timestep)
        self.period = float(period)
        self._samples_per_step = whole_steps("period", period, self.timestep)
        self._stride = whole_steps("the model's window_timestep", model.window_timestep, self.timestep)
        columns = task.columns(output_names)
        tracked = np.zeros(model.output_dim)
        if max(columns) >= model.output_dim:
            raise ValueError(f"the task tracks output {max(columns)}; "
                             f"the model has {model.output_dim} outputs")
        tracked[list(columns)] = 1.0
        self.problem = TrackingProblem(
            _Reference(task, columns, model.output_dim), input_bounds, output_weight * tracked, input_weight,
            terminal_weight * tracked, input_rate, horizon, period)
        self.horizon = horizon_for(model, self.problem)
        self.safe_input = self._safe_input(safe_input)
        rows = 0 if self.problem.rate_rows is None else len(self.problem.rate_rows[1])
        self.solver = ProxQP(horizon * self.problem.input_dim, rows) if solver is None else solver
        self.iterations, self.first_iterations = int(iterations), int(first_iterations)
        self.tolerance = float(tolerance)
        self._largest_norm = float(range_factor) * float(np.linalg.norm(model.state_scale))
        self._warm_up()

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
        self.reset()

    def reset(self) -> None:
        """Forget measurements, plans and counts."""
        length = self.model.delays * self._stride
        self._observations, self._inputs = deque(maxlen=length + 1), deque(maxlen=length)
        self._last_input = self.safe_input
        self._plan: Plan | None = None
        self._planned_now = False
        self._sample = 0
        self.fallbacks: Counter[Status] = Counter()
        self.solver.reset()

    def __call__(self, time: float, observation: np.ndarray) -> Command:
        """time in s; observation (p,), m. Raises ValueError for an observation of another size."""
        observation = np.array(observation, dtype=np.float64)
        if observation.shape != (self.model.output_dim,):
            raise ValueError(f"the observation has shape {observation.shape}; "
                             f"expected ({self.model.output_dim},)")
        if not self._observations:
            # Before the first measurement the robot is taken to have rested where it is.
            self._observations.extend([observation] * self._observations.maxlen)
            self._inputs.extend([self._last_input] * self._inputs.maxlen)
        self._observations.append(observation)
        due = self._sample % self._samples_per_step == 0
        command = self._decide(time) if due else Command(self._last_input.copy(), held=True)
        self._last_input = command.input.copy()
        self._inputs.append(self._last_input)
        self._sample += 1
        return command

    def _decide(self, time: float) -> Command:
        window, inputs = self._window()
        plan = None
        if not (np.isfinite(window).all() and np.isfinite(time)):
            status = Status.NOT_FINITE
        else:
            # Overflow is no accident here: it is how a state far outside the model's range shows.
            with np.errstate(over="ignore", invalid="ignore"):
                state = self.model.encode(window, inputs)
                plan = self._solve(time, state) if np.linalg.norm(state) <= self._largest_norm else None
            status = Status.OUT_OF_RANGE if plan is None else plan.qp_status
        if not status.success:
            return self._fall_back(time, plan, status)
        self._plan, self._planned_now = plan, True
        return Command(plan.inputs[0].copy(), plan)

    def _window(self) -> tuple[np.ndarray, np.ndarray]:
        """The delay window, oldest first, and the input set at each of its samples but the newest."""
        observations = np.stack(list(self._observations)[::self._stride])
        inputs = np.stack(list(self._inputs)[::self._stride]) if self._inputs.maxlen \
            else np.empty((0, self.problem.input_dim))
        return observations, inputs

    def _solve(self, time: float, state: np.ndarray) -> Plan:
        steps = self._steps_since_plan(time)
        if steps is None:
            guess = np.tile(self._last_input, (self.problem.horizon, 1))
        else:
            guess = self._plan.shifted(steps)
        reference = self.problem.reference_ahead(time)
        continued = self._planned_now and steps == 1 and self._continues(reference)
        iterations = self.iterations if continued else max(self.iterations, self.first_iterations)
        return solve_scp(self.problem, self.horizon, state, guess, self.solver, time=time,
                         reference=reference, last_input=self._last_input, max_iterations=iterations,
                         tolerance=self.tolerance)

    def _steps_since_plan(self, time: float) -> int | None:
        """Control steps since the last plan, or None where it says nothing about now."""
        if self._plan is None:
            return None
        steps = (time - self._plan.time) / self.period
        inside = abs(steps - round(steps)) < 0.1 and 0 < round(steps) < self.problem.horizon
        return round(steps) if inside else None

    def _continues(self, reference: np.ndarray) -> bool:
        return np.abs(reference[:-1] - self._plan.reference[1:]).max(initial=0.0) <= REFERENCE_CHANGE

    def _fall_back(self, time: float, plan: Plan | None, status: Status) -> Command:
        self.fallbacks[status] += 1
        self._planned_now = False
        self.solver.reset()
        steps = self._steps_since_plan(time) if np.isfinite(time) else None
        intended = self.safe_input if steps is None else self._plan.inputs[steps]
        admissible = self.problem.admissible(intended[None].copy(), self._last_input)[0]
        return Command(admissible, plan, status)


class _Reference:
    """The task's reference in the columns that it tracks, zero in the others, which weigh nothing."""

    def __init__(self, task, columns: tuple[int, ...], output_dim: int):
        self.task, self.columns, self.output_dim = task, list(columns), output_dim

    def __call__(self, time: np.ndarray) -> np.ndarray:
        reference = np.zeros((len(time), self.output_dim))
        reference[:, self.columns] = self.task.reference(time)
        return reference
