"""Claims about the sequence of quadratic programs."""

import numpy as np
import pytest
from scipy.optimize import minimize

from ssmr_torch.control.horizon import horizon_for
from ssmr_torch.control.quadratic_program import QPSolution
from ssmr_torch.control.scp import solve_scp
from ssmr_torch.control.solvers.proxqp import ProxQP
from ssmr_torch.control.tracking_problem import TrackingProblem
from ssmr_torch.status import Status

N = 6


def problem_of(trial, **changes):
    settings = {"reference": lambda time: 0.012 * np.sin(8 * time[:, None] + np.arange(6)),
                "input_bounds": trial.BOUNDS, "output_weight": 1e8 * np.array([1, 1, 0, 0, 0, 0]),
                "input_weight": 3.6, "horizon": N}
    return TrackingProblem(**settings | changes)


def solver_of(problem, tolerance=1e-10):
    rows = 0 if problem.rate_rows is None else len(problem.rate_rows[1])
    return ProxQP(problem.horizon * problem.input_dim, rows, tolerance=tolerance)


def solved(trial, problem, seed=0, **options):
    rng = np.random.default_rng(seed)
    horizon = horizon_for(trial.oscillators(seed), problem)
    state = 0.005 * rng.standard_normal(6)
    guess = np.full((problem.horizon, 4), 0.1)
    plan = solve_scp(problem, horizon, state, guess, solver_of(problem), **options)
    return horizon, state, plan


def test_without_active_bounds_the_plan_is_that_of_dynamic_programming(trial):
    """z⁺ = A z + B u and quadratic costs: backward Riccati recursion with a linear term for the reference."""
    problem = problem_of(trial, input_bounds=[[-9.0] * 4, [9.0] * 4], input_weight=3240.0, terminal_weight=3e8)
    model = trial.oscillators(1, 1, 0).at_timestep(problem.period)
    A, B, _ = model.linearize(np.zeros(6), np.zeros(4))
    reference, R = problem.reference_ahead(0.0), np.diag(problem.input_weight / problem.input_scale**2)
    gains, P, q = [], np.zeros((6, 6)), np.zeros(6)
    for k in reversed(range(N)):
        Q = np.diag(problem.stage_weight[k])
        P, q = P + Q, q - Q @ reference[k]
        inverse = np.linalg.inv(R + B.T @ P @ B)
        K, r = inverse @ B.T @ P @ A, inverse @ B.T @ q
        gains.append((K, r))
        P, q = A.T @ P @ (A - B @ K), (A - B @ K).T @ q
    state, expected = 0.01 * np.random.default_rng(1).standard_normal(6), []
    plan = solve_scp(problem, horizon_for(model, problem), state, np.zeros((N, 4)), solver_of(problem, 1e-12),
                     max_iterations=1)
    for K, r in reversed(gains):
        expected.append(-K @ state - r)
        state = A @ state + B @ expected[-1]
    assert plan.status is Status.SOLVED
    assert np.abs(expected).max() < 9.0
    np.testing.assert_allclose(plan.inputs, expected, rtol=0, atol=1e-8)


@pytest.mark.parametrize("input_rate", [None, 8.0])
@pytest.mark.parametrize("seed", range(3))
def test_a_converged_plan_is_the_minimum_that_a_general_solver_finds(trial, seed, input_rate):
    problem = problem_of(trial, input_rate=input_rate)
    last = np.full(4, 0.1)
    horizon, state, plan = solved(trial, problem, seed, last_input=last, tolerance=1e-13, max_iterations=50)
    assert plan.status is Status.SOLVED
    reference, scale = problem.reference_ahead(0.0), problem.input_scale

    def cost(v):
        u = v.reshape(N, 4) * scale
        return problem.cost(horizon.rollout(state, u)[1], u, reference) / plan.cost

    def gradient(v):
        condensed = horizon.condense(state, v.reshape(N, 4) * scale, reference)
        return condensed.gradient * problem.cost_scale / plan.cost

    constraints = []
    if input_rate is not None:
        C, limit = problem.rate_rows
        constraints = [{"type": "ineq", "fun": lambda v: limit - C @ v, "jac": lambda v: -C},
                       {"type": "ineq", "fun": lambda v: limit + C @ v, "jac": lambda v: C}]
    bounds = list(zip(*problem.scaled_bounds(last)))
    best = minimize(cost, np.full(4 * N, 0.2), jac=gradient, bounds=bounds, constraints=constraints,
                    method="SLSQP", options={"maxiter": 500, "ftol": 1e-12})
    assert best.success
    assert best.fun == pytest.approx(1.0, abs=1e-7)


def test_a_converged_plan_satisfies_the_conditions_of_a_minimum(trial):
    """On a box: the projected gradient step stands still."""
    problem = problem_of(trial)
    horizon, state, plan = solved(trial, problem, 3, tolerance=1e-14, max_iterations=50)
    v = (plan.inputs / problem.input_scale).ravel()
    gradient = horizon.condense(state, plan.inputs, plan.reference).gradient
    assert np.abs(v - np.clip(v - gradient, *problem.scaled_bounds(None))).max() < 1e-4
    assert ((v == 0) | (v == 1)).any() and ((v > 0.01) & (v < 0.99)).any()


def test_every_iteration_lowers_the_cost_of_the_rollout(trial):
    problem = problem_of(trial, reference=lambda time: np.full((len(time), 6), 0.02))
    costs = [solved(trial, problem, 2, max_iterations=k, tolerance=0.0)[2].cost for k in range(2, 8)]
    assert (np.diff(costs) <= 1e-12 * costs[0]).all()


def test_the_cost_is_that_of_the_rollout_under_the_planned_inputs(trial):
    problem = problem_of(trial)
    for iterations in (1, 20):
        horizon, state, plan = solved(trial, problem, max_iterations=iterations)
        states, outputs = horizon.rollout(state, plan.inputs)
        np.testing.assert_array_equal(states, plan.states)
        assert plan.cost == problem.cost(outputs, plan.inputs, problem.reference_ahead(0.0))


@pytest.mark.parametrize("degrees", [(1, 0), (3, 1)])
def test_a_plan_that_was_right_from_the_start_holds_all_states(trial, degrees):
    problem = problem_of(trial, reference=lambda time: np.zeros((len(time), 6)))
    horizon = horizon_for(trial.oscillators(0, *degrees), problem)
    plan = solve_scp(problem, horizon, np.zeros(6), np.zeros((N, 4)), solver_of(problem))
    assert plan.status is Status.SOLVED and plan.iterations == 1 and plan.states.shape == (N + 1, 6)
    np.testing.assert_array_equal(plan.states, horizon.rollout(np.zeros(6), plan.inputs)[0])


def test_the_shifted_plan_is_the_plan_later_on(trial):
    plan = solved(trial, problem_of(trial))[2]
    np.testing.assert_array_equal(plan.shifted()[:-1], plan.inputs[1:])
    np.testing.assert_array_equal(plan.shifted()[-1], plan.inputs[-1])
    np.testing.assert_array_equal(plan.shifted(3), plan.shifted().repeat(1, axis=0)[[2, 3, 4, 5, 5, 5]])
    np.testing.assert_array_equal(plan.shifted(99), np.tile(plan.inputs[-1], (N, 1)))


def test_the_rate_limit_holds_within_the_plan_and_for_its_first_step(trial):
    problem, last = problem_of(trial, input_rate=2.0), np.array([0.3, 0.0, 0.6, 0.1])
    plan = solved(trial, problem, 1, last_input=last)[2]
    changes = np.abs(np.diff(np.vstack([last, plan.inputs]), axis=0))
    assert changes.max() <= 2.0 * problem.period * (1 + 1e-9)
    assert changes[0].max() > 0.9 * 2.0 * problem.period


def test_too_few_iterations_are_reported_and_the_plan_stays_usable(trial):
    plan = solved(trial, problem_of(trial), max_iterations=2, tolerance=0.0)[2]
    assert plan.status is Status.ITERATION_LIMIT and plan.qp_status is Status.SOLVED
    assert plan.iterations == 2


def test_a_state_that_is_not_finite_gives_a_status_and_no_exception(trial):
    problem = problem_of(trial)
    horizon = horizon_for(trial.oscillators(), problem)
    for state in (np.full(6, np.nan), np.full(6, 1e6)):
        with np.errstate(all="ignore"):
            plan = solve_scp(problem, horizon, state, np.zeros((N, 4)), solver_of(problem))
        assert plan.status is plan.qp_status is Status.NOT_FINITE
        assert plan.iterations == 0


def test_a_failed_program_leaves_the_guess_and_says_so(trial):
    class Failing:
        def solve(self, problem):
            return QPSolution.none(problem, Status.PRIMAL_INFEASIBLE)

    problem, guess = problem_of(trial), np.full((N, 4), 0.2)
    plan = solve_scp(problem, horizon_for(trial.oscillators(), problem), np.zeros(6), guess, Failing())
    assert plan.status is plan.qp_status is Status.PRIMAL_INFEASIBLE
    np.testing.assert_array_equal(plan.inputs, guess)
