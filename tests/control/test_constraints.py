"""Claims about output bounds and obstacles, and the plans that respect them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize

from ssmr_torch.closed_loop.record import ClosedLoopRecord
from ssmr_torch.closed_loop.simulation import simulate
from ssmr_torch.control.constraints import OutputConstraints, path_weights
from ssmr_torch.control.horizon import horizon_for
from ssmr_torch.control.mpc import ModelPredictiveController
from ssmr_torch.control.scp import solve_scp
from ssmr_torch.control.solvers import solver_named
from ssmr_torch.control.tracking_problem import TrackingProblem
from ssmr_torch.evaluation.metrics import closed_loop_metrics
from ssmr_torch.status import Status
from ssmr_torch.tasks.obstacles import Circle, HalfPlane, drifting, random_circles
from ssmr_torch.tasks.references import figure_eight

N = 6


def constraints_with(obstacles=(), **options):
    return OutputConstraints(6, N, (0, 1), obstacles, **({"linear": 1e7, "quadratic": 1e9} | options))


def problem_of(trial, constraints, **changes):
    settings = {"reference": lambda time: np.tile([0.012, 0.0, 0, 0, 0, 0], (len(time), 1)),
                "input_bounds": trial.BOUNDS, "output_weight": 1e8 * np.array([1, 1, 0, 0, 0, 0]),
                "input_weight": 3.6, "horizon": N, "constraints": constraints}
    return TrackingProblem(**settings | changes)


def plan_of(trial, problem, qp="proxqp", **options):
    horizon = horizon_for(trial.oscillators(), problem)
    solver = solver_named(qp, *problem.size, tolerance=1e-8)
    return solve_scp(problem, horizon, np.zeros(6), np.full((N, 4), 0.1), solver,
                     **({"max_iterations": 50, "tolerance": 1e-10} | options))


def ahead_of(constraints, start=(0.0, 0.0), velocity=(0.0, 0.0), time=0.0):
    """Seen from a place and with a velocity (m/s) in the first two outputs."""
    here = np.zeros((2, constraints.output_dim))
    here[0, :2], here[1, :2] = start, 0.02 * np.asarray(velocity)
    return constraints.ahead(time, 0.02, here)


def test_the_path_is_exact_for_constant_acceleration_and_passes_through_every_prediction():
    time = np.arange(N * 5 + 1) / 5

    def at(time):
        return 2.0 + 3.0 * time - 0.7 * time**2

    weights = path_weights(N, 5)
    path = weights @ np.concatenate([[at(0.0), 3.0], at(np.arange(1.0, N + 1))])
    np.testing.assert_allclose(path, at(time), atol=1e-12)
    np.testing.assert_array_equal(weights[5::5, 2:], np.eye(N))


def test_rows_touch_the_circle_and_hold_the_prediction_at_its_clearance_between_the_steps_too():
    rng, circles = np.random.default_rng(0), random_circles(3)
    constraints, outputs = constraints_with(circles), np.cumsum(0.003 * rng.standard_normal((N, 6)), axis=0)
    ahead = ahead_of(constraints)
    normals, weights, lacking = ahead.rows(outputs)
    path = ahead.path(outputs)[:, :2]
    assert normals.shape == (N, 2 * 3, 6) and weights.shape == (N, 2 * 3, N)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=-1), 1.0)
    length = np.linalg.norm(np.diff(path, axis=0), axis=1)
    for point in range(2 * N):
        longer = length[point:point + 2].max()
        distances = [np.linalg.norm(path[point + 1] - c.center) - np.hypot(c.radius, longer / 2) for c in circles]
        rows = -lacking[point // 2, 3 * (point % 2):][:3]
        assert np.isclose(rows[:, None], distances, atol=1e-12).any(axis=1).all()
        if point % 2:  # the end of a step
            np.testing.assert_array_equal(weights[point // 2, 3:], np.tile(np.eye(N)[point // 2], (3, 1)))


def test_outputs_that_satisfy_the_rows_keep_the_straight_pieces_out_of_the_circle():
    rng = np.random.default_rng(0)
    constraints = constraints_with((Circle((0.004, 0.0), 0.0015),))
    kept = 0
    for _ in range(2000):
        outputs = np.zeros((N, 6))
        outputs[:, :2] = np.cumsum(0.003 * rng.standard_normal((N, 2)), axis=0)
        ahead = ahead_of(constraints, start=(-0.004, 0.0))
        if (ahead.rows(outputs)[2] > 0).any():
            continue
        kept += 1
        path = ahead.path(outputs)[1:, :2]
        share = np.linspace(0.0, 1.0, 101)[:, None, None]
        pieces = (1 - share) * path[:-1] + share * path[1:]
        assert np.linalg.norm(pieces - [0.004, 0.0], axis=-1).min() >= 0.0015
    assert kept > 100


def test_a_circle_smaller_than_a_step_is_not_jumped_over():
    constraints = constraints_with((Circle((0.0, 0.0), 0.0005),))
    outputs = np.zeros((N, 6))
    outputs[:, 0] = [-0.006, -0.002, 0.002, 0.006, 0.01, 0.014]  # 4 mm a step, the circle in the middle of one
    outputs[:, 1] = 0.0003
    ahead = ahead_of(constraints, start=(-0.01, 0.0003), velocity=(0.2, 0.0))
    assert ahead.clearances(outputs)[4] < 0 and ahead.violation(outputs) > 0 and ahead.penalty(outputs) > 0
    outputs[:, 1] += 0.002
    ahead = ahead_of(constraints, start=(-0.01, 0.0023), velocity=(0.2, 0.0))
    assert ahead.penalty(outputs) == 0.0


def test_a_circle_that_moves_is_met_where_it_is_at_the_time_of_each_point():
    moving = Circle(drifting((0.0, 0.0), (0.1, 0.0)), 0.004)
    ahead = ahead_of(constraints_with((moving,)), start=(0.056, 0.0), time=0.5)
    outputs = np.tile([0.05 + 0.1 * 0.06, 0.0, 0, 0, 0, 0], (N, 1))  # where the center is after three steps
    clearance = ahead.clearances(outputs)[:, 0]
    assert clearance.argmin() == 5 and clearance[5] == pytest.approx(-0.004, abs=1e-4)


def test_a_prediction_at_the_very_center_of_a_circle_still_gets_a_direction():
    ahead = ahead_of(constraints_with((Circle((0.01, 0.0), 0.004),)), start=(0.01, 0.0))
    normals, _, lacking = ahead.rows(np.tile([0.01, 0.0, 0, 0, 0, 0], (N, 1)))
    assert np.isfinite(normals).all() and np.linalg.norm(normals[0, 0]) == pytest.approx(1.0)
    np.testing.assert_allclose(lacking, 0.004)


def test_the_penalty_counts_every_violation_linearly_and_squared():
    bounds = np.array([[-np.inf] * 6, [0.01] + [np.inf] * 5])
    constraints = constraints_with((Circle((0.0, 0.0), 0.02),), output_bounds=bounds, margins=np.full(N, 0.001))
    outputs = np.zeros((N, 6))
    outputs[:, 0] = 0.012
    s = np.array([0.003, 0.009])
    ahead = ahead_of(constraints, start=(0.012, 0.0))
    assert ahead.penalty(outputs) == pytest.approx(2 * N * (1e7 * s.sum() + 1e9 * (s**2).sum()))


@pytest.mark.parametrize("qp", ["proxqp", "daqp"])
@pytest.mark.parametrize("rate", [None, 8.0])
def test_a_converged_plan_around_a_circle_is_the_minimum_that_slsqp_finds(trial, qp, rate):
    if qp == "daqp":
        pytest.importorskip("daqp", reason="needs pip install 'ssmr_torch[daqp]'")
    circle = Circle((0.006, 0.001), 0.003)
    problem = problem_of(trial, constraints_with((circle,)), input_rate=rate)
    plan = plan_of(trial, problem, qp)
    horizon = horizon_for(trial.oscillators(), problem)
    ahead = problem.constraints.ahead(0.0, problem.period, np.zeros((2, 6)))  # from rest

    def outputs(v):
        return horizon.rollout(np.zeros(6), v.reshape(N, 4) * problem.input_scale)[1]

    def cost(v):
        tracking = replace(problem, constraints=None)
        return tracking.cost(outputs(v), v.reshape(N, 4) * problem.input_scale, plan.reference) / plan.cost

    hard = [{"type": "ineq", "fun": lambda v: 1e3 * ahead.clearances(outputs(v))[:, 0]}]
    if rate is not None:
        C, limit = problem.rate_rows
        hard += [{"type": "ineq", "fun": lambda v: limit - C @ v}, {"type": "ineq", "fun": lambda v: limit + C @ v}]
    start = (plan.inputs / problem.input_scale).ravel()
    best = minimize(cost, start, bounds=list(zip(*problem.scaled_bounds(None))), constraints=hard, method="SLSQP",
                    options={"maxiter": 300, "ftol": 1e-10})
    assert plan.status in (Status.SOLVED, Status.NOT_DESCENDING) and plan.qp_status is Status.SOLVED
    assert plan.violation <= 1e-6
    assert cost(start) <= best.fun * (1 + 1e-3)  # the lengths of the pieces are those of the last iterate but one


def test_a_bound_that_the_start_violates_is_left_as_fast_as_the_inputs_allow(trial):
    bounds = np.array([[-np.inf] * 6, [-0.004] + [np.inf] * 5])
    plan = plan_of(trial, problem_of(trial, constraints_with(output_bounds=bounds)))
    free = plan_of(trial, problem_of(trial, None, reference=lambda time: np.tile([-0.1] + [0.0] * 5, (len(time), 1)),
                                     output_weight=1e8 * np.eye(6)[0]))
    assert plan.qp_status is Status.SOLVED
    assert plan.outputs[0, 0] == pytest.approx(free.outputs[0, 0], abs=2e-5) and plan.outputs[0, 0] > -0.004
    assert plan.outputs[1:, 0].max() <= -0.004 + 1e-6


@pytest.mark.parametrize("qp", ["proxqp", "daqp", "qpsolvers:quadprog"])
def test_the_robot_goes_around_obstacles_that_stand_and_that_move(trial, qp):
    if qp == "daqp":
        pytest.importorskip("daqp", reason="needs pip install 'ssmr_torch[daqp]'")
    if qp == "qpsolvers:quadprog":
        pytest.importorskip("quadprog", reason="needs pip install quadprog")
    moving = Circle(drifting((0.02, -0.02), (-0.01, 0.01)), 0.004)
    obstacles = (*random_circles(1), moving, HalfPlane((0.0, 1.0), 0.012))
    task = replace(figure_eight(laps=1.0), obstacles=obstacles)
    plant, weight = trial.ModelPlant(trial.oscillators()), 36.0
    controller = ModelPredictiveController(plant.model, task, trial.BOUNDS, horizon=5, input_weight=weight, qp=qp)
    record = simulate(plant, controller, task)
    clearance = np.stack([o.clearance(record.time, record.observation[:, :2]) for o in obstacles])
    blind = simulate(plant, ModelPredictiveController(plant.model, replace(task, obstacles=()), trial.BOUNDS,
                                                      input_weight=weight), task)
    without = np.stack([o.clearance(blind.time, blind.observation[:, :2]) for o in obstacles])
    assert without.min() < -3e-3 and clearance.min() > -3e-4
    assert not controller.fallbacks


def test_no_program_among_twenty_circles_inherits_the_penalty_of_a_hard_one(trial):
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

    assert trial.measure(5, build=build, task=task)["failures"] == 0
    assert len(iterations) > 150 and max(iterations) < 80


def test_a_hard_constraint_is_kept_where_the_soft_one_is_traded_for_tracking(trial):
    circle = (Circle((0.012, 0.002), 0.004),)
    plans = [plan_of(trial, problem_of(trial, constraints_with(circle, linear=1e2, quadratic=1e2, hard=hard)))
             for hard in (False, True)]
    assert plans[0].violation > 1e-4 and plans[0].status is not Status.SOFTENED
    assert plans[1].violation < 1e-6 and plans[1].qp_status is Status.SOLVED and plans[1].status is not Status.SOFTENED


def test_a_hard_constraint_that_no_input_can_keep_is_softened_and_reported(trial):
    bounds = np.array([[-np.inf] * 6, [-0.004] + [np.inf] * 5])
    plans = [plan_of(trial, problem_of(trial, constraints_with(output_bounds=bounds, hard=hard)))
             for hard in (False, True)]
    assert plans[1].status is Status.SOFTENED and plans[1].qp_status is Status.SOLVED
    assert plans[1].violation == pytest.approx(plans[0].violation, rel=0.1) and plans[1].violation > 1e-3


def test_the_record_and_its_metrics_hold_the_violations_of_the_plans(trial, tmp_path):
    task = replace(figure_eight(laps=1.0), obstacles=(Circle((0.0, 0.0), 0.003),))  # the robot starts inside
    plant = trial.ModelPlant(trial.oscillators())
    controller = ModelPredictiveController(plant.model, task, trial.BOUNDS, hard_constraints=True)
    record = simulate(plant, controller, task)
    found = closed_loop_metrics(ClosedLoopRecord.load(record.save(tmp_path / "record.h5")), task.obstacles)
    assert np.isnan(record.violation[1::2]).all() and record.violation[0] > 1e-3
    assert found["planned_violation"] == np.nanmax(record.violation) and found["softened"] >= 1
    assert record.statuses[0] == "SOFTENED" and not record.fallback.any()


def test_margins_keep_the_robot_that_much_further_away(trial):
    circle = Circle((0.0106, -0.0125), 0.004)
    task, found = replace(figure_eight(laps=1.0), obstacles=(circle,)), []
    for margin in (0.0, 0.001):
        plant = trial.ModelPlant(trial.oscillators())
        controller = ModelPredictiveController(plant.model, task, trial.BOUNDS, margins=np.full(5, margin))
        record = simulate(plant, controller, task)
        found.append(circle.clearance(record.time, record.observation[:, :2]).min())
    assert found[1] - found[0] == pytest.approx(0.001, abs=2e-4)


@pytest.mark.parametrize(("options", "message"), [
    ({"margins": [0.0]}, "expected 6 lengths"), ({"margins": np.full(N, -1.0)}, "none negative"),
    ({"output_bounds": np.zeros((2, 6))}, "lowest below highest"),
    ({"output_bounds": np.ones(6)}, "expected \\(2, 6\\)"),
    ({"linear": 0.0}, "positive weights")])
def test_impossible_constraints_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        constraints_with(**options)


def test_one_control_step_later_each_variable_and_row_continues_that_of_the_next_stage():
    """Two inputs, three stages of two points, a circle: inputs 0-5, slacks 6-11; rate rows 0-3, soft rows 4-9."""
    constraints = OutputConstraints(2, 3, (0, 1), [Circle((0.0, 0.03), 0.01)], linear=1e7, quadratic=1e9)
    problem = TrackingProblem(lambda time: np.zeros((len(time), 2)), np.array([[0.0, 0.0], [1.0, 1.0]]),
                              1e8 * np.ones(2), 10.0, input_rate=1.0, horizon=3, constraints=constraints)
    variables, rows = problem.continuation
    np.testing.assert_array_equal(variables, [2, 3, 4, 5, 4, 5, 8, 9, 10, 11, 10, 11])
    np.testing.assert_array_equal(rows, [2, 3, 2, 3, 6, 7, 8, 9, 8, 9])
    assert (len(variables), len(rows)) == problem.size
