"""Claims about weights without unit: a robot whose inputs are counted in another unit is commanded alike."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from ssmr_torch.control.actuator import Actuator
from ssmr_torch.control.disturbance_observer import DisturbanceObserver
from ssmr_torch.control.kalman_observers import KalmanObserver
from ssmr_torch.control.mpc_settings import PredictiveControlSettings
from ssmr_torch.control.static_pregain import StaticPregainController
from ssmr_torch.models.named_structures import koopman
from ssmr_torch.tasks.references import figure_eight

SMALL = 0.02
EIGHT = figure_eight(laps=2.0, amplitude=0.010)
ACTUATED = {"period": 0.01, "horizon": 10, "move_weight": 300.0, "huber": 2e-3, "approach": 0.5, "input_weight": 20.0}
WATCH = partial(DisturbanceObserver, gain=np.vstack([0.2 * np.eye(6), 0.02 * np.eye(6)]), limit=0.05, lost=0.01,
                covariance=1e-8 * np.eye(6))


def in_other_units(model, factor):
    """The model of a robot whose inputs are `factor` times the numbers; it is affine in them."""
    free = sum(factors[-1] < model.state_dim for factors in model.structure.dynamics.factors)
    dynamics = model.dynamics.copy()
    dynamics[:, free:] /= factor
    return replace(model, dynamics=dynamics)


def commands_of(trial, factor, samples=160, **settings):
    """(samples, 4) of a loop in which plant, model, bounds and what is said in the input's unit are in its unit."""
    model, wrong = (in_other_units(one, factor) for one in (trial.oscillators(),
                                                            trial.perturbed(trial.oscillators(), 0.03)))
    for name in ("input_rate", "safe_input", "input_target"):
        if name in settings:
            settings[name] = factor * np.asarray(settings[name])
    if "actuator" in settings:
        settings["actuator"] = Actuator(0.01, tuple(factor * np.full(4, 0.6)), **settings["actuator"])
    bounds = factor * trial.BOUNDS
    controller = trial.ModelPredictiveController(model, EIGHT, bounds, **settings)
    plant, rng, found = trial.ModelPlant(wrong, bounds), np.random.default_rng(0), []
    y = plant.reset()
    for k in range(samples):
        found.append(controller(0.01 * k, y + 3e-5 * rng.standard_normal(6)).input)
        y = plant.step(found[-1])
    assert not controller.fallbacks
    return np.array(found)


@pytest.mark.parametrize("settings", [
    {}, {"qp": "daqp"}, {"observer": partial(KalmanObserver, disturbance="input")}, {"input_rate": 5.0},
    {"input_target": [0.1] * 4, "safe_input": [0.05] * 4, "move_weight": 100.0},
    ACTUATED | {"actuator": {"delay": 1, "lag": 0.01, "gain": [1.0, 0.9, 1.1, 1.0]}, "observer": WATCH},
], ids=["default", "daqp", "input disturbance", "rate", "target and moves", "actuator"])
def test_all_inputs_times_a_fiftieth_give_the_commands_times_a_fiftieth(trial, settings):
    if settings.get("qp") == "daqp":
        pytest.importorskip("daqp", reason="needs pip install 'ssmr_torch[daqp]'")
    large, small = (commands_of(trial, factor, **settings) for factor in (1.0, SMALL))
    np.testing.assert_allclose(small / SMALL, large, rtol=0, atol=1e-9)
    assert np.ptp(large, axis=0).min() > 0.1


def test_with_play_and_friction_a_sixtyfourth_gives_a_sixtyfourth_to_the_last_bit(trial):
    """A hysteresis amplifies rounding, of which a power of two adds none."""
    rubs = ACTUATED | {"actuator": {"delay": 1, "lag": 0.01, "friction": 0.05, "play": 0.02}, "observer": WATCH}
    large, small = (commands_of(trial, factor, **rubs) for factor in (1.0, 1 / 64))
    np.testing.assert_array_equal(64 * small, large)


def test_the_default_weight_neither_jumps_from_bound_to_bound_nor_stands_still_whatever_the_range(trial):
    for factor in (0.05, 1.0, 1e5):  # ±30 mN, 0.6 N, 60 kPa
        commands = commands_of(trial, factor) / (0.6 * factor)
        at_a_bound = np.isclose(commands, 0.0, atol=1e-6) | np.isclose(commands, 1.0, atol=1e-6)
        jumps = np.abs(np.diff(commands[::2], axis=0)) > 0.9
        assert jumps.mean() < 0.01 and at_a_bound.mean() < 0.7 and commands.max() > 0.3


def pregain_model(trial, factor):
    """The linear part of the oscillators with the pregain of its own equilibria."""
    model = trial.oscillators()
    A, B, _ = model.linearize(np.zeros(6), np.zeros(4))
    pregain = np.zeros((4, 7))
    pregain[:, 0], pregain[:, 1:3] = 0.3, np.linalg.pinv(np.linalg.solve(np.eye(6) - A, B)[:2])
    return koopman(scale=np.ones(6), A=A, B=B / factor, N=np.zeros((0, 6, 6)), pregain=factor * pregain,
                   set_points=np.eye(7), degree=1, input_delays=0, constant=False, state_scale=model.state_scale,
                   input_dim=4, output_dim=6, delays=0, timestep=0.01, window_timestep=0.01, base_timestep=0.01)


@pytest.mark.parametrize("weight", [PredictiveControlSettings.input_weight, [100.0, 200.0, 300.0, 400.0]])
def test_the_regulator_beside_a_pregain_has_the_same_weight_for_inputs_of_any_size(trial, weight):
    large, small = (StaticPregainController(pregain_model(trial, factor), EIGHT, factor * trial.BOUNDS,
                                            input_weight=weight) for factor in (1.0, SMALL))
    np.testing.assert_allclose(small.gain / SMALL, large.gain, rtol=0, atol=1e-9 * np.abs(large.gain).max())
    for k, y in enumerate(0.003 * np.random.default_rng(0).uniform(-1, 1, (50, 6))):
        np.testing.assert_allclose(small(0.01 * k, y).input / SMALL, large(0.01 * k, y).input, rtol=0, atol=1e-9)


@pytest.mark.parametrize(("bounds", "weight", "said"), [
    ([[0.0] * 4, [0.6, 0.6, 0.6, 0.0]], 225.0, "lowest below highest"),
    ([[0.0] * 4, [0.6] * 4], 0.0, r"input_weight is 0\.0; expected")])
def test_a_regulator_without_a_range_or_a_weight_is_refused(trial, bounds, weight, said):
    with pytest.raises(ValueError, match=said):
        StaticPregainController(pregain_model(trial, 1.0), EIGHT, bounds, input_weight=weight)
