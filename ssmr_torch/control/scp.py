"""Sequential convex programming: linearize, condense, solve, until the cost stops falling."""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter

import numpy as np

from ssmr_torch.control.horizon import Condensed, Horizon
from ssmr_torch.control.problem import TrackingProblem
from ssmr_torch.control.qp import QPSolution, QuadraticProgram
from ssmr_torch.status import Status

ARMIJO = 1e-4
HALVINGS = 12


@dataclass(frozen=True, eq=False)
class Plan:
    """What the controller intends over the horizon; `shifted` is the next warm start.

    states (N+1, n), inputs (N, m), outputs y_1 … y_N (N, p), reference (N, p); time of the first input, s.
    cost: that of the model's own rollout under `inputs`, never of its linearization.
    status: how the optimization ended. qp_status: how its last quadratic program ended; where that is a
    success, the inputs are usable although the sequence may not have converged.
    iterations: quadratic programs solved. primal_residual, dual_residual, gap: of the last one.
    solve_time: linearization, condensing and solution, s.
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

    def shifted(self, steps: int = 1) -> np.ndarray:
        """The inputs from `steps` control steps later on, the last one repeated, (N, m)."""
        steps = min(steps, len(self.inputs) - 1)
        return np.concatenate([self.inputs[steps:], np.repeat(self.inputs[-1:], steps, axis=0)])


def solve_scp(problem: TrackingProblem, horizon: Horizon, state: np.ndarray, guess: np.ndarray, solver, *,
              time: float = 0.0, reference: np.ndarray | None = None, last_input: np.ndarray | None = None,
              max_iterations: int = 20, tolerance: float = 1e-8) -> Plan:
    """Gauss-Newton sequence of quadratic programs from the inputs `guess` (N, m) and the measured state (n,).

    time: of the first input, s. reference: (N, p) m, default the problem's own from there on. last_input:
    (m,), the input before the first, from which the rate limit counts; None leaves the first input free.
    max_iterations = 1 is the real-time iteration [Diehl et al. 2005]: one full step, SOLVED when its program
    is. More iterations search along each step until the cost of the rollout falls enough [Armijo 1966]; they
    have converged when the decrease that the gradient promises is below `tolerance` times the cost.
    Pure but for the solver's workspace. Never raises for lack of convergence: the status says how it ended.
    """
    start = perf_counter()
    reference = problem.reference_ahead(time) if reference is None else reference
    inputs = problem.admissible(np.array(guess, dtype=np.float64), last_input)
    bounds = problem.scaled_bounds(last_input)
    solution, status, iterations = None, Status.ITERATION_LIMIT, 0
    point = horizon.condense(state, inputs, reference)
    cost = problem.cost(point.outputs, inputs, reference)
    states, outputs = point.states, point.outputs
    if not np.isfinite(cost):
        status = Status.NOT_FINITE
    while iterations < max_iterations and status is Status.ITERATION_LIMIT:
        if iterations:
            point = horizon.condense(state, inputs, reference)
        solution = solver.solve(_quadratic_program(problem, point, inputs, bounds))
        iterations += 1
        if not solution.status.success:
            status = solution.status
            break
        proposed = problem.admissible(solution.x.reshape(inputs.shape) * problem.input_scale, last_input)
        slope = point.gradient @ ((proposed - inputs) / problem.input_scale).ravel() * problem.cost_scale
        if max_iterations > 1 and -slope <= tolerance * cost:
            status = Status.SOLVED
            break
        found = _line_search(problem, horizon, state, reference, inputs, proposed, cost, slope,
                             0 if max_iterations == 1 else HALVINGS)
        if found is None:
            status = Status.NOT_FINITE if max_iterations == 1 else Status.NOT_DESCENDING
            break
        inputs, states, outputs, cost = found
    if max_iterations == 1 and status is Status.ITERATION_LIMIT:
        status = Status.SOLVED
    return _plan(time, states, inputs, outputs, reference, cost, status, solution, iterations, start)


def _quadratic_program(problem: TrackingProblem, point: Condensed, inputs: np.ndarray,
                       bounds: tuple[np.ndarray, np.ndarray]) -> QuadraticProgram:
    """J / cost_scale to second order around the inputs, in v = u / input_scale."""
    v = (inputs / problem.input_scale).ravel()
    gradient = point.gradient - point.hessian @ v
    if problem.rate_rows is None:
        return QuadraticProgram(point.hessian, gradient, *bounds)
    C, limit = problem.rate_rows
    return QuadraticProgram(point.hessian, gradient, *bounds, C, -limit, limit)


def _line_search(problem, horizon, state, reference, inputs, proposed, cost, slope, halvings):
    """(inputs, states, outputs, cost) of the first step 1, ½, ¼, … that lowers the cost enough, or None.

    Without halvings the full step is taken wherever its rollout is finite.
    """
    for halving in range(halvings + 1):
        length = 0.5**halving
        candidate = proposed if halving == 0 else inputs + length * (proposed - inputs)
        states, outputs = horizon.rollout(state, candidate)
        candidate_cost = problem.cost(outputs, candidate, reference)
        enough = np.inf if halvings == 0 else cost + ARMIJO * length * slope
        if np.isfinite(candidate_cost) and candidate_cost <= enough:
            return candidate, states, outputs, candidate_cost
    return None


def _plan(time, states, inputs, outputs, reference, cost, status, solution: QPSolution | None, iterations,
          start) -> Plan:
    if solution is None:
        residuals, qp_status = (np.inf, np.inf, np.inf), status
    else:
        residuals = (solution.primal_residual, solution.dual_residual, solution.gap)
        qp_status = status if status is Status.NOT_FINITE else solution.status
    return Plan(time, states, inputs, outputs, reference, cost, status, qp_status, iterations, *residuals,
                perf_counter() - start)
