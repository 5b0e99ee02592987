"""Settings that a rig refuses, with what was given and what was expected."""

import numpy as np
import pytest

from ssmr_torch.plants.emulated_rig import Rig, rig
from ssmr_torch.plants.slow_manifold import SlowManifold


@pytest.mark.parametrize(("settings", "message"), [
    ({"noise_std": -1e-3}, r"noise_std is -0\.001 m; expected"),
    ({"noise_std": np.nan}, r"noise_std is nan m; expected"),
    ({"sensor_delay": 0.015}, r"sensor_delay is 0.015 s, which is 1.5 times the plant's timestep, 0.01 s; expected"),
    ({"sensor_delay": -0.01}, r"sensor_delay is -0.01 s; expected"),
    ({"drop_probability": 1.0}, r"drop_probability is 1\.0; expected"),
    ({"dropped": "late"}, r"dropped is 'late'; expected one of"),
    ({"actuator_lag": np.inf}, r"actuator_lag is inf s; expected"),
    ({"rate_limit": 0.0}, r"rate_limit is 0\.0; expected"),
    ({"rate_limit": [1.0, 2.0]}, r"rate_limit is \[1.0, 2.0\] N/s; expected"),
    ({"saturation": 1.6}, r"saturation is \[1.6, 1.6, 1.6, 1.6\] N; expected forces within the input bounds"),
    ({"saturation": -1.0}, r"saturation is -1\.0; expected"),
    ({"cable_friction": -0.1}, r"cable_friction is -0\.1; expected"),
])
def test_impossible_settings_are_refused_with_what_was_given_and_expected(settings, message):
    with pytest.raises(ValueError, match=message):
        rig(SlowManifold(), **settings)


def test_friction_of_inputs_that_push_and_a_rig_on_a_rig_are_refused():
    with pytest.raises(ValueError, match="cables only pull"):
        Rig(SlowManifold(input_bounds=(-1.0, 1.0)), cable_friction=0.1)
    with pytest.raises(ValueError, match="already 'slow manifold on a rig'"):
        Rig(Rig(SlowManifold(), noise_std=1e-4), noise_std=1e-4)
    with pytest.raises(ValueError, match="within the input bounds"):
        Rig(SlowManifold(input_bounds=(0.5, 1.0)), saturation=0.4)


@pytest.mark.parametrize("outputs", [[], ["elsewhere"], "repeated"])
def test_outputs_that_the_plant_does_not_have_are_refused_with_those_that_it_has(outputs):
    plant = SlowManifold()
    outputs = [plant.output_names[0]] * 2 if outputs == "repeated" else outputs
    with pytest.raises(ValueError, match=f"expected some of .*{plant.output_names[0]}.*each only once"):
        Rig(plant, outputs=outputs)
