"""Claims about the settings of predictive control: one set of them, checked once, wherever they come from."""

import json
from dataclasses import fields

import numpy as np
import pytest

from ssmr_torch import configuration
from ssmr_torch.control.actuator import Actuator
from ssmr_torch.control.mpc import ModelPredictiveController
from ssmr_torch.control.mpc_settings import PredictiveControlSettings
from ssmr_torch.tasks.references import figure_eight
from ssmr_torch.wire import runner

NAMES = [field.name for field in fields(PredictiveControlSettings)]
TASK = figure_eight(laps=1.0)


@pytest.mark.parametrize(("changes", "said"), [
    ({"horizon": 2.5}, r"horizon is 2\.5; expected"), ({"horizon": 0}, "horizon is 0"),
    ({"horizon": True}, "horizon is True"), ({"horizon": "5"}, "horizon is '5'"),
    ({"first_iterations": 1.5}, "first_iterations is 1.5"), ({"iterations": 0}, "iterations is 0"),
    ({"frozen_after": -1}, "frozen_after is -1; expected"),
    ({"range_factor": np.nan}, "range_factor is nan; expected"),
    ({"range_factor": 0}, "range_factor is 0"), ({"range_factor": -1.0}, "range_factor is -1.0"),
    ({"period": np.nan}, "period is nan s"), ({"period": 0.0}, "period is 0.0 s"),
    ({"tolerance": 0.0}, "tolerance is 0.0"), ({"output_weight": np.inf}, "output_weight is inf 1/m²"),
    ({"terminal_weight": -1.0}, r"terminal_weight is -1\.0 1/m²; expected"),
    ({"measurement_delay": np.nan}, "measurement_delay is nan s"),
    ({"input_weight": [1.0, 0.0]}, r"input_weight\[1\] is 0.0; expected"),
    ({"input_weight": None}, "input_weight is None"),
    ({"input_rate": [np.nan]}, r"input_rate\[0\] is nan; expected"), ({"margins": [np.nan]}, r"margins\[0\] is nan m"),
    ({"safe_input": 0.0}, r"safe_input is 0\.0; expected"),
    ({"safe_input": "none"}, "safe_input is 'none'; expected"),
    ({"output_bounds": [[0.0], [1.0, 2.0]]}, "output_bounds is .*; expected a list of numbers"),
    ({"margin_quantile": 1.0}, r"margin_quantile is 1\.0; expected"),
    ({"margin_quantile": "most"}, "margin_quantile is 'most'"), ({"hard_constraints": 1}, "hard_constraints is 1"),
    ({"violation_weight": [1.0]}, "of 1 values; expected a list of 2"),
    ({"observer": "kalman"}, "observer is 'kalman'"),
    ({"move_weight": -1.0}, r"move_weight is -1\.0; expected"),
    ({"move_weight": [0.0, np.inf]}, r"move_weight\[1\] is inf"), ({"huber": 0.0}, "huber is 0.0 m"),
    ({"input_target": 0.1}, r"input_target is 0\.1; expected"),
    ({"approach": -1.0}, "approach is -1.0 s"), ({"actuator": 3.0}, "actuator is 3.0; expected an Actuator, a mapping"),
    ({"actuator": {"lag": 0.02}}, "the actuator has only lag; expected timestep and input_range as well"),
    ({"actuator": {"timestep": 0.01, "input_range": [1.0], "delay": -1}}, "delay is -1; expected a whole number, 0"),
])
def test_impossible_settings_are_refused_with_what_was_given_and_what_was_expected(changes, said):
    with pytest.raises(ValueError, match=said):
        PredictiveControlSettings(**changes)


def test_an_unknown_name_is_refused_with_the_nearest_right_one(trial):
    with pytest.raises(TypeError, match="no horizn; did you mean horizon"):
        PredictiveControlSettings().changed(horizn=3)
    with pytest.raises(TypeError, match="no input_weigth; did you mean input_weight"):
        ModelPredictiveController(trial.oscillators(), TASK, trial.BOUNDS, input_weigth=3.0)


def test_settings_and_changes_by_name_are_the_same(trial):
    settings = PredictiveControlSettings(horizon=3, input_weight=[1.0, 2.0, 3.0, 4.0], output_bounds=[[-1.0] * 6,
                                                                                                      [1.0] * 6])
    whole = ModelPredictiveController(trial.oscillators(), TASK, trial.BOUNDS, settings)
    part = ModelPredictiveController(trial.oscillators(), TASK, trial.BOUNDS, settings.changed(horizon=4), horizon=3)
    by_name = ModelPredictiveController(trial.oscillators(), TASK, trial.BOUNDS, horizon=3,
                                        input_weight=np.arange(1.0, 5.0), output_bounds=np.array([[-1.0], [1.0]])
                                        * np.ones(6))
    assert whole.settings == part.settings == by_name.settings and hash(settings) == hash(by_name.settings)


def test_constructor_configuration_and_runner_have_the_same_settings(trial):
    made = ModelPredictiveController(trial.oscillators(), TASK, trial.BOUNDS)
    composed = configuration.built(configuration.composed("control").controller)(trial.oscillators(), TASK,
                                                                                 trial.BOUNDS)
    served = runner.build(json.loads(json.dumps(runner.DEFAULT["controller"])), trial.oscillators(), TASK, trial.BOUNDS)
    assert made.settings == composed.settings == served.settings == PredictiveControlSettings()


def test_every_setting_can_be_changed_on_the_command_line_but_the_observer_which_is_a_group():
    config = configuration.composed("control").controller
    assert set(NAMES) - {"observer"} <= set(config)


ACTUATOR = {"timestep": 0.01, "input_range": [0.6] * 4, "delay": 2, "lag": 0.02, "play": 0.05, "gain": [1.0] * 4}


def test_an_actuator_a_huber_cost_and_what_inputs_tend_to_are_set_on_the_command_line_and_by_the_runner(trial):
    given = {"period": 0.01, "actuator": ACTUATOR, "move_weight": 300.0, "input_weight": [30.0] * 4, "huber": 5e-4,
             "input_target": [0.1] * 4, "approach": 1.0}
    made = ModelPredictiveController(trial.oscillators(), TASK, trial.BOUNDS, **given)
    words = [f"controller.{name}=" + json.dumps(value).replace('"', "") for name, value in given.items()]
    composed = configuration.built(configuration.composed("control", words).controller)(trial.oscillators(), TASK,
                                                                                        trial.BOUNDS)
    served = runner.build(json.loads(json.dumps(runner.DEFAULT["controller"] | given)), trial.oscillators(), TASK,
                          trial.BOUNDS)
    assert made.settings == composed.settings == served.settings and hash(made.settings) == hash(composed.settings)
    assert made.settings.actuator == Actuator(0.01, (0.6,) * 4, 2, 0.02, 0.05, gain=(1.0,) * 4)
    assert made.settings == made.settings.changed(actuator=made.settings.actuator.plain())


def test_an_unknown_setting_of_an_actuator_is_refused_with_the_nearest_one():
    with pytest.raises(TypeError, match="Actuator has no delays; did you mean delay"):
        PredictiveControlSettings(actuator=ACTUATOR | {"delays": 1})


def test_every_setting_is_explained():
    described = PredictiveControlSettings.__doc__.replace("\n", " ")
    assert all(f"{name}:" in described for name in NAMES)
