"""Claims about margins from held-out runs."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from ssmr_torch.closed_loop.simulation import simulate
from ssmr_torch.control.actuator import Actuator
from ssmr_torch.control.kalman_observers import KalmanObserver
from ssmr_torch.control.mpc import ModelPredictiveController
from ssmr_torch.control.tightening import prediction_margins, tightened
from ssmr_torch.tasks.obstacles import Circle
from ssmr_torch.tasks.references import figure_eight
from ssmr_torch.trajectory import Trajectory


def driven(model, trial, inputs):
    """(observation, input) of the plant under these inputs."""
    plant = trial.ModelPlant(model)
    return np.stack([plant.reset(), *(plant.step(u) for u in inputs[:-1])]), inputs


def run_of(model, trial, samples=600, seed=0):
    """The plant under inputs that change every tenth sample."""
    inputs = np.repeat(np.random.default_rng(seed).uniform(0, 0.3, (samples // 10, 4)), 10, axis=0)
    return Trajectory(0.01 * np.arange(samples), *driven(model, trial, inputs))


def test_a_model_that_is_right_needs_no_margin_and_one_that_is_wrong_more_of_it_further_ahead(trial):
    model = trial.oscillators()
    run = run_of(model, trial)
    exact = prediction_margins(replace(model, substeps=4), [run], (0, 1), horizon=5, period=0.02)
    wrong = prediction_margins(trial.perturbed(model, 0.03), [run], (0, 1), horizon=5, period=0.02)
    assert exact.shape == (5,) and exact.max() < 1e-12
    assert (np.diff(wrong) >= 0).all() and wrong[0] > 1e-6 and wrong[-1] > 2 * wrong[0]


def test_the_margin_is_the_quantile_of_the_errors_of_prediction(trial):
    model, off = trial.oscillators(), trial.perturbed(trial.oscillators(), 0.03)
    run, errors = run_of(model, trial), []
    for start in range(0, 600 - 6, 5):
        state = off.encode(run.observation[start:start + 1], run.input[:0])
        states = off.states(state, run.input[start:start + 6])
        errors.append(np.linalg.norm(states[6, :2] - run.observation[start + 6, :2]))
    found = prediction_margins(off, [run], (0, 1), horizon=3, period=0.02, quantile=0.9)
    assert found[2] == pytest.approx(np.quantile(errors, 0.9), rel=1e-12)


def controller_of(model, trial, task=None, **settings):
    return ModelPredictiveController(model, figure_eight(laps=1.0) if task is None else task, trial.BOUNDS, **settings)


def test_the_margins_of_a_controller_without_an_observer_are_those_of_its_model(trial):
    off = trial.perturbed(trial.oscillators(), 0.03)
    run = run_of(trial.oscillators(), trial)
    found = prediction_margins(controller_of(off, trial), [run], (0, 1), quantile=0.9)
    later = Trajectory(run.time[:500], run.observation[100:], run.input[100:])  # without the second of settling
    np.testing.assert_allclose(found, prediction_margins(off, [later], (0, 1), horizon=5, period=0.02, quantile=0.9),
                               rtol=1e-9)


def test_an_observer_that_finds_the_disturbance_makes_the_margins_small(trial):
    """The robot hangs 2 mm beside the model: the chart takes that for a state, the observer for an offset."""
    model = trial.oscillators()
    run = run_of(model, trial, samples=1500)
    aside = Trajectory(run.time, run.observation + [2e-3, 0, 0, 0, 0, 0], run.input)
    chart, observed = (prediction_margins(controller_of(model, trial, observer=observer), [aside], (0, 1))
                       for observer in (None, partial(KalmanObserver, disturbance="output")))
    assert observed[-1] < 0.2 * chart[-1]


def test_measurements_that_are_late_are_bridged_before_the_prediction(trial):
    model = replace(trial.oscillators(), substeps=4)
    run = run_of(model, trial)
    late = Trajectory(run.time, np.vstack([run.observation[:1], run.observation[:-1]]), run.input)
    told = prediction_margins(controller_of(model, trial, measurement_delay=0.01), [late], (0, 1))
    assert told[0] < 1e-3 * prediction_margins(controller_of(model, trial), [late], (0, 1))[0]


def test_an_actuator_is_in_the_prediction_and_its_delay_before_the_first_stage(trial):
    """The robot feels the commands two samples late and lagged: told so, the prediction of six samples is exact."""
    model = replace(trial.oscillators(), substeps=4)
    actuator = Actuator(0.01, (0.6,) * 4, delay=2, lag=0.015)
    commands = run_of(model, trial).input
    acting = Trajectory(0.01 * np.arange(600), *driven(model, trial, actuator.acting(commands)))
    run = Trajectory(acting.time, acting.observation, commands)
    settings = {"period": 0.01, "horizon": 4}
    told = prediction_margins(controller_of(model, trial, actuator=actuator, **settings), [run], (0, 1))
    assert told.max() < 1e-12 < 1e-4 < prediction_margins(controller_of(model, trial, **settings), [run], (0, 1))[0]


def test_a_tightened_controller_shows_its_margins_keeps_them_and_starts_from_the_beginning(trial):
    circle = Circle((0.0106, -0.0125), 0.004)
    run = run_of(trial.oscillators(), trial)
    controller = controller_of(trial.perturbed(trial.oscillators(), 0.03), trial,
                               replace(figure_eight(laps=1.0), obstacles=(circle,)), margin_quantile=0.9)
    first = controller(0.0, np.zeros(6)).input
    assert tightened(controller, [run]) is controller
    expected = prediction_margins(controller, [run], (0, 1), quantile=0.9)
    np.testing.assert_array_equal(controller.settings.margins, expected)
    np.testing.assert_array_equal(controller.problem.constraints.margins, expected)
    np.testing.assert_allclose(controller(0.0, np.zeros(6)).input, first, atol=1e-12)
    wider = tightened(controller, [run], 0.99).settings
    assert wider.margin_quantile == 0.99 and wider.margins[-1] > expected[-1]


def test_a_run_of_another_timestep_than_the_controllers_is_refused(trial):
    run = run_of(trial.oscillators(), trial)
    faster = Trajectory(run.time / 2, run.observation, run.input)
    with pytest.raises(ValueError, match="timestep of 0.005 s; expected 0.01 s, as the controller"):
        prediction_margins(controller_of(trial.oscillators(), trial), [faster], (0, 1))
    with pytest.raises(ValueError, match="a model needs both"):
        prediction_margins(trial.oscillators(), [run], (0, 1), horizon=5)


def test_a_model_whose_predictions_leave_the_reach_of_the_runs_gives_no_margin(trial):
    model = trial.oscillators()
    wild = replace(model, dynamics=40.0 * model.dynamics)
    with pytest.raises(ValueError, match="prediction errors is .* m after 5 steps .* the runs reach"):
        tightened(controller_of(wild, trial), [run_of(model, trial)])


def test_with_margins_a_wrong_model_stays_out_of_the_obstacle_that_it_enters_without(trial):
    model, wrong = trial.oscillators(), trial.perturbed(trial.oscillators(), 0.05)
    circle = Circle((0.0106, -0.0125), 0.004)
    task, depth = replace(figure_eight(laps=1.0), obstacles=(circle,)), []
    margins = prediction_margins(wrong, [run_of(model, trial)], (0, 1), horizon=5, period=0.02, quantile=0.99)
    for given in (None, margins):
        controller = ModelPredictiveController(wrong, task, trial.BOUNDS, margins=given)
        record = simulate(trial.ModelPlant(model), controller, task)
        depth.append(-circle.clearance(record.time, record.observation[:, :2]).min())
    assert depth[0] > 1e-5 and depth[1] < 0.5 * depth[0]


def test_short_runs_and_impossible_quantiles_are_refused(trial):
    model = trial.oscillators()
    with pytest.raises(ValueError, match="no run is long enough"):
        prediction_margins(model, [run_of(model, trial, 10)], (0, 1), horizon=5, period=0.02)
    with pytest.raises(ValueError, match="between 0 and 1"):
        prediction_margins(model, [run_of(model, trial)], (0, 1), horizon=5, period=0.02, quantile=1.0)
