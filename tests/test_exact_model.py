"""What is lost in closed loop by learning: the same controller with the learned model and with the exact one."""

from pathlib import Path

import numpy as np
import pytest
from hydra import compose, initialize_config_dir
from hydra.utils import instantiate

from ssmr_torch.closed_loop.simulation import simulate
from ssmr_torch.control.mpc import ModelPredictiveController
from ssmr_torch.fitting.ssmr_least_squares import SSMRLeastSquares
from ssmr_torch.models.ssmr import SSMR
from ssmr_torch.plants.slow_manifold import SlowManifold
from ssmr_torch.tasks.references import figure_eight

STATES = 10
OUTPUT_WEIGHT = 1e8


class ExactModel:
    """The plant's own flow, fast modes included, from its own state; linearized by central differences."""

    delays, state_dim, input_dim = 0, STATES, 4
    affine, compiled = False, None

    def __init__(self, plant: SlowManifold, timestep: float = 0.02):
        self.plant, self.timestep, self.window_timestep = plant, timestep, plant.timestep
        self.output_dim, self.state_scale = len(plant.output_names), np.full(STATES, 1e3)
        self.flow = SlowManifold(plant.observe, timestep, input_bounds=(-100.0, 100.0), substeps=16)

    @property
    def reduced(self):
        return self

    def numpy(self):
        return self

    def at_timestep(self, timestep):
        return ExactModel(self.plant, timestep)

    def encode(self, window, inputs):
        return self.plant.state

    def decode(self, z):
        return z @ self.plant.output_matrix.T

    def step(self, z, u):
        following = []
        for state, command in zip(z.reshape(-1, STATES), u.reshape(-1, 4)):
            self.flow.reset(state=state)
            self.flow.step(command)
            following.append(self.flow.state)
        return np.array(following).reshape(z.shape)

    def states(self, z, inputs):
        states = [z]
        for k in range(inputs.shape[-2]):
            states.append(self.step(states[-1], inputs[..., k, :]))
        return np.stack(states, axis=-2)

    def linearize(self, z, u, h=1e-6):
        A = np.stack([self.step(z + h * e, u) - self.step(z - h * e, u) for e in np.eye(STATES)], axis=-1) / (2 * h)
        B = np.stack([self.step(z, u + h * e) - self.step(z, u - h * e) for e in np.eye(4)], axis=-1) / (2 * h)
        return A, B, self.step(z, u) - (A @ z[..., None] + B @ u[..., None])[..., 0]

    def linearize_output(self, z):
        C = self.plant.output_matrix
        return np.broadcast_to(C, z.shape[:-1] + C.shape), np.zeros(z.shape[:-1] + (self.output_dim,))


@pytest.fixture(scope="module")
def data():
    with initialize_config_dir(str(Path(__file__).resolve().parents[1] / "conf"), version_base="1.3"):
        config = compose("collect", ["excitation.progress=false"])
    return instantiate(config.excitation)(instantiate(config.plant))


@pytest.fixture
def learned(data, solve_stages):
    def learn(degree):
        model = SSMR(6, 4, 6, 1, parametrization_degree=degree, dynamics_degree=degree, substeps=2)
        solve_stages(SSMRLeastSquares(model), data.select("train"), transient=0.1)
        model.state_scale.fill_(0.05)
        return model.reduced.numpy()

    return learn


def tracking_cost(model, plant, angular_speed, input_weight):
    """Σ ‖y - ŷ‖²_Q + ‖u / range‖²_R, the controller's own cost, over three laps of the figure eight on the plant."""
    task = figure_eight(0.015, angular_speed, 3, 1.0, ("tip_x", "tip_y"))
    controller = ModelPredictiveController(model, task, plant.input_bounds, timestep=plant.timestep,
                                           output_names=plant.output_names, input_weight=input_weight)
    record = simulate(plant, controller, task)
    assert not record.fallback.any()
    effort = np.square(record.input / np.ptp(plant.input_bounds, axis=0)).sum()
    return OUTPUT_WEIGHT * (record.error**2).sum() + input_weight * effort


@pytest.mark.slow
@pytest.mark.parametrize(("angular_speed", "input_weight"), [(4.0, 22.5), (2.0, 22.5), (4.0, 225.0)])
def test_the_learned_model_costs_at_most_five_percent_more_than_the_exact_one_and_the_linear_one_more(
        learned, angular_speed, input_weight):
    plant = SlowManifold()
    exact = tracking_cost(ExactModel(plant), plant, angular_speed, input_weight)
    assert tracking_cost(learned(3), plant, angular_speed, input_weight) < 1.05 * exact
    assert tracking_cost(learned(1), plant, angular_speed, input_weight) > 1.05 * exact
