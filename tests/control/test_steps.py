"""Claims about what holds in every step: time, bounds, budget, outliers, copies. Each is one of every controller."""

import copy
import logging
import pickle
from dataclasses import replace
from functools import partial
from time import thread_time

import numpy as np
import pytest

from ssmr_torch.benchmarks import hostile
from ssmr_torch.control.chart_estimator import ChartEstimator
from ssmr_torch.control.kalman_observers import KalmanObserver
from ssmr_torch.control.quadratic_program import QuadraticProgram
from ssmr_torch.control.solvers import solver_named
from ssmr_torch.status import Status
from ssmr_torch.tasks.obstacles import Circle, drifting
from ssmr_torch.tasks.references import Task, circle, figure_eight, path, rose
from ssmr_torch.tasks.symbols import symbol

EIGHT = figure_eight(laps=3.0, amplitude=0.010)
OBSERVERS = {f"{disturbance}, {'extended' if extended else 'stationary'}":
             partial(KalmanObserver, disturbance=disturbance, extended=extended)
             for disturbance in ("none", "output", "input") for extended in (False, True)}


def steered(trial, controller, samples=300, observe=lambda k, y: y, called=lambda k: True):
    """Outputs (samples, 6) of the plant, and the commands; observe changes measurements, called skips calls."""
    plant, rng = trial.ModelPlant(trial.perturbed(trial.oscillators(), 0.03)), np.random.default_rng(0)
    y, outputs, commands = plant.reset(), [], []
    for k in range(samples):
        noise = 3e-5 * rng.standard_normal(6)
        if called(k):
            commands.append(controller(0.01 * k, observe(k, y + noise)))
        outputs.append(y)
        y = plant.step(commands[-1].input)
    return np.array(outputs), commands


def rms(outputs):
    return np.sqrt(np.mean(np.sum((outputs[:, :2] - EIGHT.reference(0.01 * np.arange(len(outputs))))**2, axis=1)))


@pytest.mark.parametrize("kind", [
    "SSMR on the chart", "SSMR, horizon 10, rate", "SSMR, late measurements", "SSMR, Kalman", "SSMR, extended Kalman",
    "SSMR, rate, daqp", "SSMR, 20 circles, rate", "SSMR, 20 circles, daqp", "SSMR, actuator",
    "SSMR, rubbing actuator, rate", "DMD", "DMD, Kalman", "EDMD",
    "static pregain"])
def test_bad_measurements_raise_no_error_and_inputs_stay_in_bounds_and_in_time(kind):
    found = hostile.endure(hostile.KINDS[kind], 2000, seed=1)
    assert not found.exceptions and not found.outside and found.fresh
    assert found.late <= 2  # of the CPU time; a collection of garbage may fall into a step
    for what in ("skipped", "irregular", "repeated", "restarted", "without time", "missing", "unreadable"):
        assert found.counts[what] > 0, what
    assert found.fallbacks[Status.WRONG_TIME] == found.counts["repeated"]


@pytest.mark.parametrize("observer", [None, *OBSERVERS.values()], ids=["chart", *OBSERVERS])
def test_one_call_in_ten_skipped_costs_little_and_is_counted(trial, observer):
    def controller():
        return trial.predictive(trial.oscillators(), EIGHT, trial.BOUNDS, observer=observer)

    whole, one = rms(steered(trial, controller())[0]), controller()
    skipped = rms(steered(trial, one, called=lambda k: k % 10 != 7)[0])
    assert skipped < 1.6e-4 and skipped < whole + 1e-4
    assert one.counts == {"skipped": 30} and not one.fallbacks


def test_intervals_of_twice_the_timestep_are_bridged_and_counted(trial):
    controller = trial.predictive(trial.oscillators(), EIGHT, trial.BOUNDS)
    assert rms(steered(trial, controller, called=lambda k: k % 2 == 0)[0]) < 1.6e-4
    assert controller.counts == {"skipped": 149}


def test_a_repeated_call_changes_nothing_and_falls_back_to_the_input_that_is_held(trial):
    one, other = (trial.predictive(trial.oscillators(), EIGHT, trial.BOUNDS) for _ in range(2))
    for k in range(60):
        y = 1e-3 * np.sin(0.1 * k + np.arange(6))
        ours, theirs = one(0.01 * k, y), other(0.01 * k, y)
        np.testing.assert_array_equal(ours.input, theirs.input)
        again = one(0.01 * k, y + 0.01)
        np.testing.assert_array_equal(again.input, ours.input)
        assert again.fallback is Status.WRONG_TIME
    assert one.fallbacks == {Status.WRONG_TIME: 60} and one.counts == {"repeated": 60}


@pytest.mark.parametrize("approach", [0.0, 0.4])
@pytest.mark.parametrize("jump", [-0.5, 20.0])
def test_after_a_jump_in_time_the_controller_restarts_at_the_robots_position(trial, jump, approach):
    """As one that has not moved yet but for the input that is held: it approaches the reference from there again."""
    controller, late = (trial.predictive(trial.oscillators(), EIGHT, trial.BOUNDS, approach=approach,
                                         observer=OBSERVERS["output, stationary"]) for _ in range(2))
    _, before = steered(trial, controller, 60)
    y = np.full(6, 2e-3)
    late._last_input = before[-1].input
    late.actuator.rest_at(before[-1].input)
    late._start_anew()
    for k in range(10):
        ours, theirs = (one(0.6 + jump + 0.01 * k, y + 1e-5 * k) for one in (controller, late))
        np.testing.assert_allclose(ours.input, theirs.input, atol=1e-12)
    assert controller.counts == {"restarted": 1}


@pytest.mark.parametrize("size", [0.1, 1.0])
@pytest.mark.parametrize("at", [5, 200, 201])
@pytest.mark.parametrize("observer", [None, *OBSERVERS.values()], ids=["chart", *OBSERVERS])
def test_a_single_outlier_is_over_after_three_samples(trial, observer, at, size):
    def controller():
        return trial.predictive(trial.oscillators(), EIGHT, trial.BOUNDS, observer=observer)

    clean, one = steered(trial, controller(), 260)[0], controller()
    spoilt = steered(trial, one, 260, lambda k, y: y + size * (k == at))[0]
    off = np.flatnonzero((np.abs(spoilt - clean)[:, :2] > 1e-4).any(axis=1))
    assert not len(off) or off[-1] <= at + 3
    if observer is not None:
        assert one.counts["gated"] == 1


@pytest.mark.parametrize("observer", OBSERVERS.values(), ids=OBSERVERS)
def test_clean_runs_of_wrong_models_are_not_gated(trial, observer):
    for wrong in (0.0, 0.2):
        model = trial.perturbed(trial.oscillators(), wrong, seed=5)
        controller = trial.predictive(model, EIGHT, trial.BOUNDS, observer=observer)
        steered(trial, controller)
        assert not controller.counts


def test_a_robot_that_has_really_moved_is_accepted_after_three_samples(trial):
    observer = KalmanObserver(trial.oscillators(), np.full(4, 0.6))
    for k in range(700):
        observer.measure(np.full(6, 0.0 if k < 600 else 0.02), np.zeros(4))
    z, _, offset = observer.state()
    assert observer.gated == 3 and np.abs(z + offset - 0.02).max() < 1e-3


def test_absolute_positions_are_logged_once_with_both_numbers_and_counted(trial, caplog):
    controller = trial.predictive(trial.oscillators(), EIGHT, trial.BOUNDS)
    with caplog.at_level(logging.WARNING):
        for k in range(5):
            controller(0.01 * k, np.array([0.0, 0.0, -0.2, 0.0, 0.0, 0.0]))
    [record] = caplog.records
    assert "output 2 is -200 mm" in record.getMessage() and "within 40 mm" in record.getMessage()
    assert controller.counts == {"beyond the recorded range": 5}


@pytest.mark.parametrize("settings", [{}, {"input_rate": 5.0}, {"qp": "daqp"}, {"qp": "daqp", "input_rate": 5.0},
                                      {"observer": OBSERVERS["input, extended"]}], ids=str)
def test_an_input_is_fixed_and_released_again_without_a_restart(trial, settings):
    controller = trial.predictive(trial.oscillators(), EIGHT, trial.BOUNDS, **settings)
    plant = trial.ModelPlant(trial.perturbed(trial.oscillators(), 0.03))
    y, shut, inputs = plant.reset(), trial.BOUNDS.copy(), []
    shut[:, 2] = 0.05
    for k in range(300):
        if k in (101, 180):
            controller.input_bounds = shut if k == 101 else trial.BOUNDS
        command = controller(0.01 * k, y)
        assert command.fallback is None and (command.plan is None or k < 2 or command.plan.iterations == 1)
        inputs.append(command.input)
        y = plant.step(command.input)
    inputs = np.array(inputs)
    np.testing.assert_allclose(inputs[101:180, 2], 0.05, atol=1e-9)
    assert inputs[:, 2].max() > 0.1 and inputs[180:, 2].max() > 0.1
    assert np.abs(y[:2] - EIGHT.reference(3.0)[0]).max() < 1e-3


@pytest.mark.parametrize(("bounds", "said"), [
    ([[0.0] * 4, [0.6, 0.6, -0.1, 0.6]], "input 2 is bounded by 0.0 and -0.1"),
    ([[0.0, -np.inf, 0.0, 0.0], [0.6] * 4], "input 1 is bounded by -inf and 0.6"),
    ([[0.0] * 3, [0.6] * 3], r"shape \(2, 3\); expected \(2, 4\)")])
def test_crossed_or_infinite_bounds_are_refused_with_both_numbers(trial, bounds, said):
    controller = trial.predictive(trial.oscillators(), EIGHT, trial.BOUNDS)
    with pytest.raises(ValueError, match=said):
        controller.input_bounds = bounds
    np.testing.assert_array_equal(controller.input_bounds, trial.BOUNDS)


class Slow:
    """A solver that spends so many s of CPU time before it answers."""

    def __init__(self, solver, spent):
        self.solver, self.spent = solver, spent

    def solve(self, program):
        until = thread_time() + self.spent
        while thread_time() < until:
            pass
        return self.solver.solve(program)

    def reset(self):
        self.solver.reset()


def test_no_program_begins_that_would_not_end_within_the_budget(trial):
    slow = Slow(solver_named("proxqp", 20, 0), 0.004)
    controller = trial.predictive(trial.oscillators(), EIGHT, trial.BOUNDS, first_iterations=10, tolerance=1e-30,
                                  solver=slow)
    command = controller(0.0, np.full(6, 3e-3))
    assert command.fallback is None and command.plan.iterations == 2
    assert controller.counts == {"cut short": 1}
    slow.spent = 0.02
    for k in range(1, 3):
        controller(0.01 * k, np.full(6, 3e-3))
    assert controller.counts["late"] == 1
    unlimited = replace(controller.settings, step_budget=None)
    assert unlimited.step_budget is None


@pytest.mark.parametrize("name", ["proxqp", "daqp"])
def test_a_cost_beyond_what_arithmetic_can_solve_is_refused_at_once(name):
    solver, H = solver_named(name, 4, 0), np.diag([1.0, 1e3, 1e18, 1e24])
    solution = solver.solve(QuadraticProgram(H, H @ np.ones(4), np.zeros(4), np.ones(4)))
    assert solution.status is Status.OUT_OF_RANGE and solution.iterations == 0


def test_a_program_that_daqp_refuses_has_a_status_and_the_next_one_is_solved():
    solver = solver_named("daqp", 2, 0)
    good = QuadraticProgram(np.eye(2), np.array([-0.5, 2.0]), np.zeros(2), np.ones(2))
    for _ in range(2):
        bad = QuadraticProgram(-np.eye(2), np.ones(2), np.zeros(2), np.ones(2), convex=True)
        assert not solver.solve(bad).status.success
        np.testing.assert_allclose(solver.solve(good).x, [0.5, 0.0], atol=1e-9)


def test_a_gap_in_a_window_is_filled_by_the_parabola_through_its_neighbours(trial):
    model = replace(trial.oscillators(), delays=3)
    estimator = ChartEstimator(model, 1)
    y = 1e-2 * (1.0 + 0.1 * np.arange(12) + 0.02 * np.arange(12)**2)
    for k in range(12):
        estimator.measure(np.full(6, np.nan if k in (7, 8, 10) else y[k]), np.zeros(4))
        assert np.isfinite(estimator.window()[0][-1]).all() == (k not in (7, 8, 10))
    np.testing.assert_allclose(estimator.window()[0], np.tile(y[8:, None], 6), rtol=1e-3)


COPIED = {"copy": copy.deepcopy, "pickle": lambda one: pickle.loads(pickle.dumps(one))}


class Half:
    """A path of one's own that a pickle can hold."""

    def __call__(self, time):
        return 0.005 * np.stack([np.sin(time), np.cos(time) - 1.0], axis=-1)


TASKS = [figure_eight(laps=1.0), circle(tracked=(0, 1)), rose(), symbol("S", tracked=(0, 1)),
         path([0.0, 1.0], [[0.0, 0.0], [0.01, 0.0]], outputs=(0, 1)), Task("mine", 2.0, (0, 1), Half()),
         figure_eight(obstacles=[Circle(drifting([0.0, 0.03], [0.001, 0.0]), 0.004)])]


@pytest.mark.parametrize("copied", COPIED.values(), ids=COPIED)
@pytest.mark.parametrize("task", TASKS, ids=lambda task: task.name)
def test_every_task_can_be_copied_and_pickled(task, copied):
    time = np.linspace(-0.1, task.duration + 0.1, 200)
    again = copied(task)
    np.testing.assert_array_equal(again.reference(time), task.reference(time))
    for one, other in zip(again.obstacles, task.obstacles):
        np.testing.assert_array_equal(one.centers(time), other.centers(time))


def test_a_task_with_a_lambda_can_be_copied_but_not_pickled():
    task = Task("hold", 1.0, (0,), lambda time: np.zeros((len(time), 1)))
    assert copy.deepcopy(task).reference(0.5).shape == (1, 1)
    with pytest.raises(TypeError, match="the path of task 'hold' cannot be pickled.*<lambda>"):
        pickle.dumps(task)
    with pytest.raises(TypeError, match="center of a moving obstacle cannot be pickled"):
        pickle.dumps(Circle(lambda time: np.zeros((len(time), 2)), 0.01))


@pytest.mark.parametrize("copied", COPIED.values(), ids=COPIED)
@pytest.mark.parametrize("kind", [
    "SSMR on the chart", "SSMR, horizon 10, rate", "SSMR, extended Kalman", "SSMR, Kalman", "SSMR, 20 circles, rate",
    "SSMR, 20 circles, daqp", "SSMR, actuator", "SSMR, rubbing actuator, rate", "EDMD", "static pregain"])
def test_the_copy_of_a_controller_gives_the_same_commands_to_the_last_bit(trial, kind, copied):
    controller = hostile.KINDS[kind]()
    steered(trial, controller, 101)
    again, rng = copied(controller), np.random.default_rng(3)
    for k in range(101, 160):
        y = 0.005 * np.sin(0.05 * k + np.arange(6)) + 3e-5 * rng.standard_normal(6)
        np.testing.assert_array_equal(controller(0.01 * k, y).input, again(0.01 * k, y).input)
