"""Claims about the controller that plans through an actuator."""

import copy
import pickle
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from ssmr_torch.control.actuator import Actuator
from ssmr_torch.control.disturbance_observer import DisturbanceObserver
from ssmr_torch.control.mpc import ModelPredictiveController
from ssmr_torch.control.solvers.proxqp import ProxQP
from ssmr_torch.models.named_structures import koopman
from ssmr_torch.tasks.references import Task, figure_eight

H, RANGE = 0.01, (0.6,) * 4
EIGHT = figure_eight(laps=2.0, amplitude=0.012)
WATCH = partial(DisturbanceObserver, gain=np.vstack([0.3 * np.eye(6), 0.02 * np.eye(6)]), limit=0.05, lost=0.01,
                covariance=1e-8 * np.eye(6))


def linear_model(A, B):
    """z⁺ = A z + B u, all of z measured."""
    n = len(A)
    return koopman(scale=np.ones(n), A=A, B=B, N=np.zeros((0, n, n)), pregain=np.zeros((0, n + 1)),
                   set_points=np.zeros((0, n + 1)), degree=1, input_delays=0, constant=False, state_scale=np.ones(n),
                   input_dim=4, output_dim=n, delays=0, timestep=H, window_timestep=H, base_timestep=H)


def augmented(A, B, share, delay):
    """The same with the states x and u_{k−d} … u_{k−1} of a lag and a delay."""
    n, m = len(A), 4
    size = n + m + delay * m
    whole, feeds = np.zeros((size, size)), np.zeros((size, m))
    whole[:n, :n], whole[:n, n:n + m], whole[n:n + m, n:n + m] = A, share * B, share * np.eye(m)
    if delay:
        oldest = slice(n + m, n + 2 * m)
        whole[:n, oldest], whole[n:n + m, oldest] = (1 - share) * B, (1 - share) * np.eye(m)
        whole[n + m:-m, n + 2 * m:] = np.eye((delay - 1) * m)
        feeds[-m:] = np.eye(m)
    else:
        feeds[:n], feeds[n:] = (1 - share) * B, (1 - share) * np.eye(m)
    return whole, feeds


@pytest.mark.parametrize(("delay", "lag"), [(0, 0.02), (1, 0.0), (3, 0.02)])
def test_the_controller_equals_one_for_the_model_extended_by_the_actuators_states(trial, delay, lag):
    """On a linear plant with exactly that actuator; it looks as far beyond the delay as the other one in all."""
    A, B, _ = trial.oscillators(0, 1, 0).linearize(np.zeros(6), np.zeros(4))
    actuator = Actuator(H, RANGE, delay=delay, lag=lag)
    plant, feeds = augmented(A, B, actuator.share, delay)
    shared = {"period": H, "input_weight": 30.0, "step_budget": None}

    def solver(horizon):
        return ProxQP(4 * horizon, 0, tolerance=1e-12)

    ours = ModelPredictiveController(linear_model(A, B), EIGHT, trial.BOUNDS, horizon=8, actuator=actuator,
                                     solver=solver(8), **shared)
    theirs = ModelPredictiveController(linear_model(plant, feeds), Task(EIGHT.name, EIGHT.duration, (0, 1),
                                                                        EIGHT.reference),
                                       trial.BOUNDS, horizon=8 + delay, solver=solver(8 + delay), **shared)
    z, inputs = np.zeros(len(plant)), []
    for k in range(200):
        one, other = ours(H * k, z[:6]), theirs(H * k, z)
        assert one.fallback is None and other.fallback is None
        np.testing.assert_allclose(one.input, other.input, rtol=0, atol=1e-8)
        z = plant @ z + feeds @ one.input
        inputs.append(one.input)
    at_a_bound = np.isclose(inputs, 0.0, atol=1e-6) | np.isclose(inputs, 0.6, atol=1e-6)
    assert 0.1 < at_a_bound.mean() < 0.9


def tracked(trial, controller, actuator, samples=320, hung=0.0, observe=lambda k, y: y):
    """(commands (T, 4), rms error of the last 2.2 s, m) on the perturbed oscillators behind an actuator."""
    plant, acting = trial.ModelPlant(trial.perturbed(trial.oscillators(), 0.03)), _Behind(actuator)
    rng, y, found, errors = np.random.default_rng(0), plant.reset(), [], []
    for k in range(samples):
        found.append(controller(H * k, observe(k, y + hung + 3e-5 * rng.standard_normal(6))))
        errors.append(y[:2] + hung - EIGHT.reference(H * k)[0])
        y = plant.step(acting(found[-1].input))
    return found, np.sqrt(np.mean(np.sum(np.square(errors[-220:]), axis=1)))


class _Behind:
    """What acts, sample by sample, with states of its own."""

    def __init__(self, actuator):
        self.actuator, self.given = actuator, [np.zeros(4)]

    def __call__(self, command):
        self.given.append(np.clip(command, 0.0, 0.6))
        return self.actuator.acting(np.array(self.given))[-1]


SLOW = Actuator(H, RANGE, delay=2, lag=0.02)
RUBBING = Actuator(H, RANGE, delay=1, lag=0.01, friction=0.05, play=0.02)
SETTINGS = {"period": H, "horizon": 10, "move_weight": 300.0, "input_weight": 20.0, "observer": WATCH, "approach": 0.5,
            "huber": 5e-3}


@pytest.mark.parametrize(("actuator", "most"), [(SLOW, 4e-4), (RUBBING, 3e-4)], ids=["delay and lag", "and rubbing"])
def test_a_controller_that_knows_the_actuator_tracks_and_one_that_does_not_hardly_does(trial, actuator, most):
    knows, does_not = (trial.predictive(trial.oscillators(), EIGHT, trial.BOUNDS, **SETTINGS | {"actuator": which})
                       for which in (actuator, None))
    commands, error = tracked(trial, knows, actuator)
    assert error < most
    assert tracked(trial, does_not, actuator)[1] > 5 * error
    assert not knows.fallbacks and all((c.input >= 0).all() and (c.input <= 0.6).all() for c in commands)


def test_the_reference_is_reached_from_where_the_robot_hangs_within_the_time_of_the_approach(trial):
    """A load moves every output by 2 mm: the first commands do not answer it at once."""
    at_once, softly = (trial.predictive(trial.oscillators(), EIGHT, trial.BOUNDS,
                                        **SETTINGS | {"actuator": SLOW, "approach": approach})
                       for approach in (0.0, 0.8))
    jumps = [np.abs(np.diff([c.input for c in tracked(trial, one, SLOW, 60, hung=0.002)[0]], axis=0)).max()
             for one in (at_once, softly)]
    assert jumps[1] < 0.5 * jumps[0]
    assert tracked(trial, softly, SLOW, hung=0.002)[1] < 5e-4  # time goes back, and the load is known already


@pytest.mark.parametrize("settings", [{}, {"input_rate": 5.0}, {"actuator": RUBBING},
                                      {"actuator": RUBBING, "input_rate": 5.0}, {"input_rate": 5.0, "qp": "daqp"}],
                         ids=["delay and lag", "rate", "rubbing", "rubbing, rate", "rate, daqp"])
def test_bounds_that_are_narrowed_between_steps_hold_at_once_and_can_be_widened_again(trial, settings):
    if settings.get("qp") == "daqp":
        pytest.importorskip("daqp", reason="needs pip install 'ssmr_torch[daqp]'")
    settings = SETTINGS | {"actuator": SLOW, "observer": WATCH} | settings
    controller, rng = trial.predictive(trial.oscillators(), EIGHT, trial.BOUNDS, **settings), np.random.default_rng(4)
    plant, acting = trial.ModelPlant(trial.oscillators()), _Behind(settings["actuator"])
    y = plant.reset()
    for k in range(240):
        if k % 40 == 20:
            shut = trial.BOUNDS.copy()
            shut[0, rng.integers(4)] = 0.3
            shut[:, rng.integers(4)] = rng.uniform(0, 0.6)
            controller.input_bounds = shut if k % 80 == 20 else trial.BOUNDS
        command, (lower, upper) = controller(H * k, y), controller.input_bounds
        assert (lower <= command.input).all() and (command.input <= upper).all()
        y = plant.step(acting(command.input))
    assert not controller.fallbacks


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda one: pickle.loads(pickle.dumps(one))], ids=["copy", "pickle"])
def test_a_copy_gives_the_same_commands_to_the_last_bit(trial, copied):
    controller = trial.predictive(trial.oscillators(), EIGHT, trial.BOUNDS, **SETTINGS | {"actuator": RUBBING})
    tracked(trial, controller, RUBBING, 80)
    again, rng = copied(controller), np.random.default_rng(3)
    for k in range(80, 140):
        y = 0.005 * np.sin(0.05 * k + np.arange(6)) + 3e-5 * rng.standard_normal(6)
        np.testing.assert_array_equal(controller(H * k, y).input, again(H * k, y).input)


def test_after_a_reset_the_same_measurements_give_the_same_commands_to_the_last_bit(trial):
    controller = trial.predictive(trial.oscillators(), EIGHT, trial.BOUNDS, **SETTINGS | {"actuator": RUBBING})
    found = []
    for _ in range(2):
        controller.reset()
        found.append([c.input for c in tracked(trial, controller, RUBBING, 80, observe=lambda k, y: y + (k == 40))[0]])
        assert controller.counts["gated"] == 1
    np.testing.assert_array_equal(*found)


@pytest.mark.parametrize(("actuator", "period"), [(replace(SLOW, input_range=(0.6,) * 3), H),
                                                  (replace(SLOW, timestep=0.02), H), (SLOW, 0.02)])
def test_an_actuator_with_other_inputs_or_timestep_is_refused_with_both_numbers(trial, actuator, period):
    with pytest.raises(ValueError, match=f"the actuator has {len(actuator.input_range)} inputs and steps of "
                                         f"{actuator.timestep:g} s; expected 4 inputs and the timestep 0.01 s"):
        trial.predictive(trial.oscillators(), EIGHT, trial.BOUNDS, period=period, actuator=actuator)
