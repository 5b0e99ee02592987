"""The excitation of five minutes on a plant that counts its steps, whatever its inputs."""

from pathlib import Path

import numpy as np
import pytest
from hydra import compose, initialize_config_dir
from hydra.utils import instantiate

from ssmr_torch.plants.flat_state import FlatStatePlant

CONF = Path(__file__).resolve().parents[2] / "conf"


class Counting(FlatStatePlant):
    """y⁺ = mean of the inputs; counts all steps that it takes."""

    name, input_unit, output_names, timestep, substeps = "counting", "N", ("mean",), 0.02, 1

    def __init__(self, bounds):
        self.input_bounds, self.parameters, self.steps = np.array(bounds), {}, 0
        self.input_names = tuple(f"input_{index}" for index in range(self.input_bounds.shape[1]))
        self._settle(np.zeros(1))

    def _flow(self, state, u, substeps):
        self.steps += 1
        return np.array([u.mean()])

    def _observe(self, state):
        return state


@pytest.mark.parametrize("bounds", [([-2.0, -1.0], [2.0, 1.0]), ([0.0] * 6, [3.0] * 6), ([0.1], [1.0])],
                         ids=["two signed", "six that push", "one with a least pull"])
def test_any_robot_is_recorded_within_five_minutes_and_decays_where_it_rests(bounds):
    plant = Counting(bounds)
    with initialize_config_dir(str(CONF), version_base="1.3"):
        dataset = instantiate(compose("collect", ["excitation=five_minutes"]).excitation)(plant, progress=False)
    assert plant.steps * plant.timestep <= 300
    runs = {trajectory.name: np.asarray(trajectory.input) for trajectory in dataset}
    resting = np.clip(0.0, *plant.input_bounds)
    assert all((inputs == resting).all() for name, inputs in runs.items() if name.startswith("decay"))
    controlled = np.concatenate([inputs for name, inputs in runs.items() if not name.startswith("decay")])
    assert ((controlled >= plant.input_bounds[0]) & (controlled <= plant.input_bounds[1])).all()
    if (plant.input_bounds[0] < 0).all():
        span = plant.input_bounds[1] - plant.input_bounds[0]
        np.testing.assert_allclose(controlled.mean(axis=0) / span, 0.0, atol=0.02)
    speed = {name: np.abs(np.diff(runs[f"{name}-test-0"], axis=0)).mean() for name in ("smooth", "double-speed")}
    assert speed["double-speed"] > 1.5 * speed["smooth"]
