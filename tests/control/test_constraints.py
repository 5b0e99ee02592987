"""Claims about output bounds and obstacles, and the plans that respect them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize

from ssmr_torch.closed_loop import simulate
from ssmr_torch.control.constraints import OutputConstraints
from ssmr_torch.control.horizon import horizon_for
from ssmr_torch.control.mpc import ModelPredictiveController
from ssmr_torch.control.problem import TrackingProblem
from ssmr_torch.control.scp import solve_scp
from ssmr_torch.control.solvers import solver_named
from ssmr_torch.status import Status
from ssmr_torch.tasks.obstacles import Circle, HalfPlane, drifting, random_circles
from ssmr_torch.tasks.references import figure_eight

N = 6


def constraints_with(obstacles=(), **options):
    return OutputConstraints(6, N, (0, 1), obstacles, **({"linear": 1e7, "quadratic": 1e9} | options))


def problem_of(bench, constraints, **changes):
    settings = {"reference": lambda time: np.tile([0.012, 0.0, 0, 0, 0, 0], (len(time), 1)),
                "input_bounds": bench.BOUNDS, "output_weight": 1e8 * np.array([1, 1, 0, 0, 0, 0]),
                "input_weight": 3.6, "horizon": N, "constraints": constraints}
    return TrackingProblem(**settings | changes)


def plan_of(bench, problem, qp="proxqp", **options):
    horizon = horizon_for(bench.oscillators(), problem)
    solver = solver_named(qp, *problem.size, tolerance=1e-8)
    return solve_scp(problem, horizon, np.zeros(6), np.full((N, 4), 0.1), solver,
                     **({"max_iterations": 50, "tolerance": 1e-10} | options))


def test_rows_touch_the_circle_and_hold_the_prediction_at_its_clearance():
    rng, circles = np.random.default_rng(0), random_circles(3)
    constraints, outputs, times = constraints_with(circles), 0.02 * rng.standard_normal((N, 6)), np.arange(N) * 0.02
    normals, offsets = constraints.rows(times, outputs)
    assert normals.shape == (N, 3, 6)
    for k in range(N):
        clearances = np.sort([circle.clearance(times[k:k + 1], outputs[k:k + 1, :2])[0] for circle in circles])
        held = np.sort(normals[k] @ outputs[k] - offsets[k])
        np.testing.assert_allclose(held, clearances[:3], atol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=-1), 1.0)


def test_a_prediction_at_the_very_center_of_a_circle_still_gets_a_direction():
    normals, offsets = constraints_with((Circle((0.01, 0.0), 0.004),)).rows(np.zeros(N), np.tile([0.01, 0.0], (N, 3)))
    assert np.isfinite(normals).all() and np.linalg.norm(normals[0, 0]) == pytest.approx(1.0)
    assert offsets[0, 0] == pytest.approx(0.014)


def test_the_penalty_counts_every_violation_linearly_and_squared():
    bounds = np.array([[-np.inf] * 6, [0.01] + [np.inf] * 5])
    constraints = constraints_with((Circle((0.0, 0.0), 0.02),), output_bounds=bounds, margins=np.full(N, 0.001))
    outputs = np.zeros((N, 6))
    outputs[:, 0] = 0.012
    s = np.array([0.003, 0.009])
    assert constraints.penalty(np.zeros(N), outputs) == pytest.approx(N * (1e7 * s.sum() + 1e9 * (s**2).sum()))


@pytest.mark.parametrize("qp", ["proxqp", "daqp"])
@pytest.mark.parametrize("rate", [None, 8.0])
def test_a_converged_plan_around_a_circle_is_the_minimum_that_slsqp_finds(bench, qp, rate):
    if qp == "daqp":
        pytest.importorskip("daqp", reason="needs pip install 'ssmr_torch[daqp]'")
    circle = Circle((0.006, 0.001), 0.003)
    problem = problem_of(bench, constraints_with((circle,)), input_rate=rate)
    plan = plan_of(bench, problem, qp)
    times, horizon = problem.times_ahead(0.0), horizon_for(bench.oscillators(), problem)

    def outputs(v):
        return horizon.rollout(np.zeros(6), v.reshape(N, 4) * problem.input_scale)[1]

    def cost(v):
        tracking = replace(problem, constraints=None)
        return tracking.cost(outputs(v), v.reshape(N, 4) * problem.input_scale, plan.reference) / plan.cost

    hard = [{"type": "ineq", "fun": lambda v: 1e3 * circle.clearance(times, outputs(v)[:, :2])}]
    if rate is not None:
        C, limit = problem.rate_rows
        hard += [{"type": "ineq", "fun": lambda v: limit - C @ v}, {"type": "ineq", "fun": lambda v: limit + C @ v}]
    start = (plan.inputs / problem.input_scale).ravel()
    best = minimize(cost, start, bounds=list(zip(*problem.scaled_bounds(None))), constraints=hard, method="SLSQP",
                    options={"maxiter": 300, "ftol": 1e-10})
    assert plan.status in (Status.SOLVED, Status.NOT_DESCENDING) and plan.qp_status is Status.SOLVED
    assert circle.clearance(times, plan.outputs[:, :2]).min() >= -1e-6
    assert cost(start) <= best.fun * (1 + 1e-4)


def test_a_bound_that_the_start_violates_is_left_as_fast_as_the_inputs_allow(bench):
    bounds = np.array([[-np.inf] * 6, [-0.004] + [np.inf] * 5])
    plan = plan_of(bench, problem_of(bench, constraints_with(output_bounds=bounds)))
    free = plan_of(bench, problem_of(bench, None, reference=lambda time: np.tile([-0.1] + [0.0] * 5, (len(time), 1)),
                                     output_weight=1e8 * np.eye(6)[0]))
    assert plan.qp_status is Status.SOLVED
    assert plan.outputs[0, 0] == pytest.approx(free.outputs[0, 0], abs=2e-5) and plan.outputs[0, 0] > -0.004
    assert plan.outputs[1:, 0].max() <= -0.004 + 1e-6


@pytest.mark.parametrize("qp", ["proxqp", "daqp", "qpsolvers:quadprog"])
def test_the_robot_goes_around_obstacles_that_stand_and_that_move(bench, qp):
    if qp == "daqp":
        pytest.importorskip("daqp", reason="needs pip install 'ssmr_torch[daqp]'")
    if qp == "qpsolvers:quadprog":
        pytest.importorskip("quadprog", reason="needs pip install quadprog")
    moving = Circle(drifting((0.02, -0.02), (-0.01, 0.01)), 0.004)
    obstacles = (*random_circles(1), moving, HalfPlane((0.0, 1.0), 0.012))
    task = replace(figure_eight(laps=1.0), obstacles=obstacles)
    plant, weight = bench.ModelPlant(bench.oscillators()), 36.0
    controller = ModelPredictiveController(plant.model, task, bench.BOUNDS, horizon=5, input_weight=weight, qp=qp)
    record = simulate(plant, controller, task)
    clearance = np.stack([o.clearance(record.time, record.observation[:, :2]) for o in obstacles])
    blind = simulate(plant, ModelPredictiveController(plant.model, replace(task, obstacles=()), bench.BOUNDS,
                                                      input_weight=weight), task)
    without = np.stack([o.clearance(blind.time, blind.observation[:, :2]) for o in obstacles])
    assert without.min() < -3e-3 and clearance.min() > -3e-4
    assert not controller.fallbacks


def test_no_program_among_twenty_circles_inherits_the_penalty_of_a_hard_one(bench):
    """ProxQP's own warm start keeps it: single programs of this run then took 133 iterations."""
    task, iterations = replace(figure_eight(laps=2.0), obstacles=random_circles(0)), []

    def build(*arguments, **options):
        controller = ModelPredictiveController(*arguments, **options)
        solve = controller.solver.solve

        def counted(program):
            solution = solve(program)
            iterations.append(solution.iterations)
            return solution

        controller.solver.solve = counted
        return controller

    assert bench.measure(5, build=build, task=task)["failures"] == 0
    assert len(iterations) > 150 and max(iterations) < 80


def test_margins_keep_the_robot_that_much_further_away(bench):
    circle = Circle((0.0106, -0.0125), 0.004)
    task, found = replace(figure_eight(laps=1.0), obstacles=(circle,)), []
    for margin in (0.0, 0.001):
        plant = bench.ModelPlant(bench.oscillators())
        controller = ModelPredictiveController(plant.model, task, bench.BOUNDS, margins=np.full(5, margin))
        record = simulate(plant, controller, task)
        found.append(circle.clearance(record.time, record.observation[:, :2]).min())
    assert found[1] - found[0] == pytest.approx(0.001, abs=2e-4)


@pytest.mark.parametrize(("options", "message"), [
    ({"margins": [0.0]}, "expected 6 lengths"), ({"margins": np.full(N, -1.0)}, "none negative"),
    ({"output_bounds": np.zeros((2, 6))}, "lowest below highest"),
    ({"output_bounds": np.ones(6)}, "expected \\(2, 6\\)"),
    ({"linear": 0.0}, "positive weights")])
def test_constraints_without_meaning_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        constraints_with(**options)


def test_a_control_step_later_each_variable_and_row_continues_its_like_one_stage_on():
    """Two inputs, three stages, one wall and two circles: inputs 0-5, slacks 6-14; rate rows 0-3, soft rows 4-12."""
    constraints = OutputConstraints(2, 3, (0, 1), [HalfPlane((1.0, 0.0), 0.02), Circle((0.0, 0.03), 0.01),
                                                   Circle((0.0, -0.03), 0.01)], linear=1e7, quadratic=1e9)
    problem = TrackingProblem(lambda time: np.zeros((len(time), 2)), np.array([[0.0, 0.0], [1.0, 1.0]]),
                              1e8 * np.ones(2), 10.0, input_rate=1.0, horizon=3, constraints=constraints)
    variables, rows = problem.continuation
    np.testing.assert_array_equal(variables, [2, 3, 4, 5, 4, 5, 9, 10, 11, 12, 13, 14, 12, 13, 14])
    np.testing.assert_array_equal(rows, [2, 3, 2, 3, 7, 8, 9, 10, 11, 12, 10, 11, 12])
    assert (len(variables), len(rows)) == problem.size
