"""Sequential convex programming: linearize, condense, solve, and repeat until the cost no longer falls."""

from __future__ import annotations

from dataclasses import dataclass, replace
from time import perf_counter, thread_time

import numpy as np

from ssmr_torch.control.condensing import output_rows
from ssmr_torch.control.constraints import HEAVIER, ConstraintsAhead
from ssmr_torch.control.horizon import Condensed, Horizon
from ssmr_torch.control.quadratic_program import QPSolution, QuadraticProgram
from ssmr_torch.control.tracking_problem import SLACK_SCALE, TrackingProblem
from ssmr_torch.status import Status

ARMIJO = 1e-4
HALVINGS = 12
# A smaller slack, in units of SLACK_SCALE, counts as none.
KEPT = 1e-3


@dataclass(frozen=True, eq=False)
class Plan:
    """The plan of the controller over the horizon; `shifted` is the next warm start.

    states (N+1, n), inputs (N, m), outputs y_1 … y_N (N, p), reference (N, p); time of the first input, s.
    cost: of the model's own rollout under `inputs`, not of its linearization.
    status: how the optimization ended. qp_status: how its last quadratic program ended; if that is a success, the
    inputs can be used, although the sequence may not have converged.
    iterations: number of quadratic programs. primal_residual, dual_residual, gap: of the last one.
    solve_time: s, of linearization, condensing and solution.
    violation: m, the largest one of the constraints on the way to y_N, with margins; NaN without constraints.
    """

    time: float
    states: np.ndarray
    inputs: np.ndarray
    outputs: np.ndarray
    reference: np.ndarray
    cost: float
    status: Status
    qp_status: Status
    iterations: int
    primal_residual: float
    dual_residual: float
    gap: float
    solve_time: float
    violation: float = np.nan

    def shifted(self, steps: int = 1) -> np.ndarray:
        """The inputs from `steps` control steps later on, (N, m); the last one is repeated."""
        shifted, kept = np.empty_like(self.inputs), max(len(self.inputs) - steps, 1)
        shifted[:kept], shifted[kept:] = self.inputs[-kept:], self.inputs[-1]
        return shifted


def solve_scp(problem: TrackingProblem, horizon: Horizon, state: np.ndarray, guess: np.ndarray, solver, *,
              time: float = 0.0, reference: np.ndarray | None = None, last_input: np.ndarray | None = None,
              max_iterations: int = 20, tolerance: float = 1e-8, prepared: Condensed | None = None,
              deadline: float = np.inf) -> Plan:
    """Gauss-Newton sequence of quadratic programs from the inputs `guess` (N, m) and the measured state (n,).

    time: of the first input, s. reference: (N, p) m; default: the problem's own from this time on. last_input:
    (m,), the input before the first, from which the rate limit counts; None: the first input is free.
    max_iterations = 1 is the real-time iteration [Diehl et al. 2005]: one full step; it is SOLVED when its program
    is. More iterations search along each step until the cost of the rollout falls enough [Armijo 1966]. They have
    converged when the decrease that the program promises is below `tolerance` times the cost.
    prepared: `horizon.condense` of this guess at a predicted state; the first program then needs no linearization.
    deadline: s of CPU time, as `time.thread_time` gives it; a program that would end later is not started
    (ITERATION_LIMIT). The only side effect is in the solver's workspace. Never raises for lack of convergence: the
    status shows it.
    """
    start = perf_counter()
    reference = problem.reference_ahead(time) if reference is None else reference
    inputs = problem.admissible(np.asarray(guess, dtype=np.float64), last_input)
    bounds, horizon.last_input = problem.scaled_bounds(last_input), last_input
    solution, status, iterations, kept = None, Status.ITERATION_LIMIT, 0, True
    ahead = horizon.constraints_ahead(time, state, inputs[0] if last_input is None else last_input)
    point = horizon.condense(state, inputs, reference) if prepared is None \
        else horizon.moved(prepared, state, inputs, reference)
    states, outputs = point.states, point.outputs
    cost = np.nan
    if max_iterations > 1:  # a real-time iteration compares no costs, and its program shows values that are not finite
        cost = problem.cost(outputs, inputs, reference, ahead, last_input)
        if not np.isfinite(cost):
            status = Status.NOT_FINITE
    budget = _Budget(deadline if max_iterations > 1 else np.inf)
    while iterations < max_iterations and status is Status.ITERATION_LIMIT and budget.allows_another():
        if iterations:
            point = horizon.condense(state, inputs, reference)
        solution, kept = _solved(problem, _quadratic_program(problem, point, inputs, bounds, ahead), solver)
        iterations += 1
        if not solution.status.success:
            status = solution.status
            break
        proposed = _proposed(problem, solution, inputs, last_input)
        slope = _promised(problem, point, inputs, proposed, outputs, ahead, solution.x) if max_iterations > 1 else 0.0
        if max_iterations > 1 and -slope <= tolerance * cost:
            status = Status.SOLVED
            break
        found = _line_search(problem, horizon, state, reference, inputs, proposed, cost, slope, ahead, last_input,
                             0 if max_iterations == 1 else HALVINGS)
        if found is None:
            status = Status.NOT_FINITE if max_iterations == 1 else Status.NOT_DESCENDING
            break
        inputs, states, outputs, cost = found
    if len(states) <= len(inputs):  # the condensed problem of a linear model holds only the first state
        states, outputs = horizon.rollout(state, inputs)
    status = _as_told(status, max_iterations, solution, kept)
    return _plan(time, states, inputs, outputs, reference, cost, status, solution, iterations, ahead, start)


def _proposed(problem: TrackingProblem, solution: QPSolution, inputs: np.ndarray, last_input) -> np.ndarray:
    """Inputs (N, m) from a program's solution."""
    return problem.admissible(solution.x[:inputs.size].reshape(inputs.shape) * problem.input_scale, last_input)


def _as_told(status: Status, max_iterations: int, solution: QPSolution | None, kept: bool) -> Status:
    """The status: a real-time iteration is SOLVED by its one program; violated hard constraints mean SOFTENED."""
    if not kept and solution.status.success:
        return Status.SOFTENED
    return Status.SOLVED if max_iterations == 1 and status is Status.ITERATION_LIMIT else status


class _Budget:
    """Tells before every program whether it can end before the deadline, if it takes as long as the longest so far."""

    def __init__(self, deadline: float):
        self.deadline, self._longest, self._before = deadline, 0.0, np.inf

    def allows_another(self) -> bool:
        if self.deadline == np.inf:
            return True
        now = thread_time()
        self._longest, self._before = max(self._longest, now - self._before), now
        return now + self._longest <= self.deadline


def _quadratic_program(problem: TrackingProblem, point: Condensed, inputs: np.ndarray,
                       bounds: tuple[np.ndarray, np.ndarray], ahead: ConstraintsAhead | None) -> QuadraticProgram:
    """J / cost_scale to second order around the inputs, in v = u / input_scale and slacks s / SLACK_SCALE."""
    if problem.constraints is None:
        if problem.rate_rows is None:
            return QuadraticProgram(point.hessian, point.linear, *bounds, convex=True)
        C, limit = problem.rate_rows
        return QuadraticProgram(point.hessian, point.linear, *bounds, C, -limit, limit, convex=True)
    v = (inputs / problem.input_scale).ravel()
    constraints, soft, d = problem.constraints, problem.soft_rows, len(v)
    rows, lowest = output_rows(point.sensitivity, v, *ahead.rows(point.outputs), SLACK_SCALE)
    size, count = problem.size
    H, C = np.zeros((size, size)), np.zeros((count, size))
    row_lower, row_upper = np.empty(count), np.full(count, np.inf)
    H[:d, :d] = point.hessian
    H.flat[d * (size + 1)::size + 1] = 2.0 * constraints.quadratic * SLACK_SCALE**2 / problem.cost_scale
    g = np.concatenate([point.linear, np.full(soft, constraints.linear * SLACK_SCALE / problem.cost_scale)])
    hard = count - soft
    if hard:
        C[:hard, :d], limit = problem.rate_rows
        row_lower[:hard], row_upper[:hard] = -limit, limit
    C[hard:, :d], row_lower[hard:] = rows, lowest
    C.flat[hard * size + d::size + 1] = 1.0
    lower, upper = np.concatenate([bounds[0], np.zeros(soft)]), np.concatenate([bounds[1], np.full(soft, np.inf)])
    return QuadraticProgram(H, g, lower, upper, C, row_lower, row_upper, convex=True)


def _solved(problem: TrackingProblem, program: QuadraticProgram, solver) -> tuple[QPSolution, bool]:
    """The program's solution, and whether it keeps hard constraints.

    A penalty that exceeds the multipliers of the program without slack has the same solution. So a hard program is
    first solved with its normal penalties, and again with heavier ones if it needs slack. Constraints that no input can
    keep so have an answer, too.
    """
    solution, soft, constraints = solver.solve(program), problem.soft_rows, problem.constraints
    if constraints is None or not constraints.hard:
        return solution, True
    for factor in HEAVIER:
        if not solution.status.success or solution.x[-soft:].max(initial=0.0) <= KEPT:
            break
        g = program.g.copy()
        g[-soft:] *= factor
        heavier = solver.solve(replace(program, g=g))
        if not heavier.status.success:
            break
        solution = heavier
    return solution, bool(not solution.status.success or solution.x[-soft:].max(initial=0.0) <= KEPT)


def _promised(problem, point: Condensed, inputs, proposed, outputs, ahead, x) -> float:
    """Directional derivative of J along the step; for the penalty its decrease in the program, an upper bound."""
    slope = point.gradient @ ((proposed - inputs) / problem.input_scale).ravel() * problem.cost_scale
    if problem.constraints is None:
        return slope
    s = SLACK_SCALE * np.maximum(x[inputs.size:], 0.0)
    constraints = problem.constraints
    there = constraints.price * s.sum() + constraints.quadratic * np.square(s).sum()
    return slope + there - ahead.penalty(outputs)


def _line_search(problem, horizon, state, reference, inputs, proposed, cost, slope, ahead, last_input, halvings):
    """(inputs, states, outputs, cost) of the first step 1, ½, ¼, … that lowers the cost enough, or None.

    Without halvings the full step is taken if its rollout is finite.
    """
    for halving in range(halvings + 1):
        length = 0.5**halving
        candidate = proposed if halving == 0 else inputs + length * (proposed - inputs)
        states, outputs = horizon.rollout(state, candidate)
        candidate_cost = problem.cost(outputs, candidate, reference, ahead, last_input)
        enough = np.inf if halvings == 0 else cost + ARMIJO * length * slope
        if np.isfinite(candidate_cost) and candidate_cost <= enough:
            return candidate, states, outputs, candidate_cost
    return None


def _plan(time, states, inputs, outputs, reference, cost, status, solution: QPSolution | None, iterations,
          ahead, start) -> Plan:
    if solution is None:
        residuals, qp_status = (np.inf, np.inf, np.inf), status
    else:
        residuals = (solution.primal_residual, solution.dual_residual, solution.gap)
        qp_status = status if status is Status.NOT_FINITE else solution.status
    return Plan(time, states, inputs, outputs, reference, cost, status, qp_status, iterations, *residuals,
                perf_counter() - start, np.nan if ahead is None else ahead.violation(outputs))
