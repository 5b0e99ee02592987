"""What every controller promises. A new controller adds one entry to CONTROLLERS."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from ssmr_torch.closed_loop.simulation import simulate
from ssmr_torch.control.base import Command, Controller
from ssmr_torch.control.kalman_observers import KalmanObserver
from ssmr_torch.control.mpc import ModelPredictiveController
from ssmr_torch.control.static_pregain import StaticPregainController
from ssmr_torch.models.named_structures import koopman
from ssmr_torch.models.output_coordinates import ConstantCurvature
from ssmr_torch.tasks.obstacles import Circle
from ssmr_torch.tasks.references import figure_eight

TASK = figure_eight(laps=1.0)
SLOW = figure_eight(angular_speed=0.2, laps=0.3)


def lifted(model):
    """The linear part of an oscillator model as a Koopman model with the pregain of its own equilibria."""
    A, B, _ = model.linearize(np.zeros(6), np.zeros(4))
    static, common = np.linalg.solve(np.eye(6) - A, B)[:2], np.full(4, 0.3)
    pregain = np.zeros((4, 7))
    pregain[:, 1:3] = np.linalg.pinv(static)
    pregain[:, 0] = common - np.linalg.pinv(static) @ static @ common
    return koopman(scale=np.ones(6), A=A, B=B, N=np.zeros((0, 6, 6)), pregain=pregain, set_points=np.eye(7),
                   degree=1, input_delays=0, constant=False, state_scale=model.state_scale, input_dim=4, output_dim=6,
                   delays=0, timestep=model.timestep, window_timestep=model.window_timestep,
                   base_timestep=model.timestep)


def arcs(model):
    """An oscillator model whose states are angles and lengths of two arcs of 0.1 m, saturated from twice its range."""
    return replace(model, coordinates=ConstantCurvature(((0.0, 0.0, 0.1), (0.06, 0.0, 0.08))), reach=2.0,
                   structure=model.structure._replace(saturated=True))


CONTROLLERS = {
    "predictive": lambda trial: ModelPredictiveController(trial.oscillators(), TASK, trial.BOUNDS),
    "predictive, rate limited": lambda trial: ModelPredictiveController(
        trial.oscillators(), TASK, trial.BOUNDS, input_rate=5.0, horizon=3),
    "predictive, converged": lambda trial: ModelPredictiveController(
        trial.oscillators(), TASK, trial.BOUNDS, iterations=10, period=0.03),
    "predictive, observed": lambda trial: ModelPredictiveController(
        trial.oscillators(), TASK, trial.BOUNDS, observer=partial(KalmanObserver, disturbance="input", extended=True)),
    "predictive, beside an obstacle": lambda trial: ModelPredictiveController(
        trial.oscillators(), replace(TASK, obstacles=(Circle((0.0, 0.013), 0.002),)), trial.BOUNDS, input_rate=10.0),
    "predictive, by DAQP": lambda trial: ModelPredictiveController(trial.oscillators(), TASK, trial.BOUNDS, qp="daqp"),
    "predictive, arcs as outputs": lambda trial: ModelPredictiveController(arcs(trial.oscillators()), TASK,
                                                                           trial.BOUNDS),
    "predictive, arcs, observed": lambda trial: ModelPredictiveController(
        arcs(trial.oscillators()), TASK, trial.BOUNDS, observer=partial(KalmanObserver, extended=True)),
    "static pregain": lambda trial: StaticPregainController(lifted(trial.oscillators()), SLOW, trial.BOUNDS,
                                                            input_weight=3.6e4),
}


@pytest.fixture(params=CONTROLLERS)
def controller(request, trial):
    return CONTROLLERS[request.param](trial)


def measurements(count=60):
    rng = np.random.default_rng(0)
    waves = 0.01 * np.sin(0.1 * np.arange(count)[:, None] + np.arange(6))
    return waves + 1e-4 * rng.standard_normal((count, 6))


def inputs_of(controller, observations):
    return np.stack([controller(0.01 * k, observation).input for k, observation in enumerate(observations)])


def test_it_is_a_controller(controller):
    assert isinstance(controller, Controller)
    assert isinstance(controller(0.0, np.zeros(6)), Command)


def test_the_same_measurements_give_the_same_inputs_to_the_last_bit_after_a_reset(controller):
    first = inputs_of(controller, measurements())
    for _ in range(5):
        controller.reset()
        np.testing.assert_array_equal(inputs_of(controller, measurements()), first)


def test_a_reset_controller_and_fresh_ones_agree_to_the_last_bit_wherever_their_memory_lies(trial, request, controller):
    inputs_of(controller, measurements())
    controller.reset()
    inputs, kept = inputs_of(controller, measurements()), []
    for size in (1, 333, 70):
        kept.append((np.empty(size), CONTROLLERS[request.node.callspec.params["controller"]](trial)))
        np.testing.assert_array_equal(inputs_of(kept[-1][1], measurements()), inputs)


@pytest.mark.parametrize("spoilt", [np.nan, np.inf, -np.inf, 1e30, 1e300, 10.0])
def test_inputs_are_finite_and_inside_the_bounds_whatever_is_measured(controller, trial, spoilt):
    observations = measurements()
    observations[20:30, 1] = spoilt
    observations[40:] = spoilt
    inputs = inputs_of(controller, observations)
    assert inputs.shape == (60, 4) and np.isfinite(inputs).all()
    assert (trial.BOUNDS[0] <= inputs).all() and (inputs <= trial.BOUNDS[1]).all()


def test_arrays_of_the_caller_are_not_changed_and_returned_arrays_are_copies(controller):
    clean = inputs_of(controller, measurements())
    controller.reset()
    spoilt = []
    for k, observation in enumerate(measurements()):
        given = observation.copy()
        command = controller(0.01 * k, given)
        np.testing.assert_array_equal(given, observation)
        spoilt.append(command.input.copy())
        given[:] = np.nan
        command.input[:] = np.nan
    np.testing.assert_allclose(spoilt, clean, rtol=0, atol=1e-9)


def test_read_only_and_single_precision_measurements_are_accepted(controller):
    observation = np.zeros(6, dtype=np.float32)
    observation.setflags(write=False)
    assert np.isfinite(controller(0.0, observation).input).all()


def test_the_plant_follows_the_task(controller, trial):
    record = simulate(trial.ModelPlant(trial.oscillators()), controller, controller.task)
    assert np.abs(record.error).max() < 0.25 * np.abs(record.reference).max()
    assert not record.fallback.any()
