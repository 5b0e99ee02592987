"""The robot's shapes are those of the run that was recorded."""

from types import SimpleNamespace

import numpy as np
import pytest

from ssmr_torch.closed_loop import deformation
from ssmr_torch.closed_loop.deformation import draw_robot, replayed_shapes
from ssmr_torch.closed_loop.simulation import simulate
from ssmr_torch.control.base import Command
from ssmr_torch.evaluation.robot_figures import add_circles
from ssmr_torch.plants.emulated_rig import Rig
from ssmr_torch.plants.slow_manifold import SlowManifold
from ssmr_torch.plants.trunk import Trunk
from ssmr_torch.tasks.obstacles import Circle, HalfPlane, drifting
from ssmr_torch.tasks.references import figure_eight

TASK = figure_eight(amplitude=0.005, laps=1, angular_speed=15.0, ramp=0.1, tracked=("tip_x", "tip_y"))


class Swinging:
    """Pulls two cables in turn, whatever is measured."""

    period = 0.01

    def reset(self):
        pass

    def __call__(self, time, observation):
        tensions = np.zeros(8)
        tensions[:2] = 0.1 * (1 + np.sin(15 * time + np.array([0.0, np.pi / 2])))
        return Command(tensions)


@pytest.fixture(scope="module")
def trunk():
    return Trunk("trunk_coarse")


def recorded(plant):
    return simulate(plant, Swinging(), TASK, seed=3)


@pytest.mark.parametrize("on_a_rig", [False, True])
def test_the_replay_passes_through_the_recorded_positions_of_the_markers(trunk, on_a_rig):
    plant = Rig(trunk, noise_std=1e-4, sensor_delay=0.02, actuator_lag=0.02) if on_a_rig else trunk
    record = recorded(plant)
    samples = np.array([0, 7, 20])
    shapes = replayed_shapes(plant, record, samples)
    tips = shapes[:, trunk.markers["tip"]] - trunk.rest[:3]
    np.testing.assert_allclose(tips, record.observation[samples, :3], atol=1e-15)


def test_another_plant_than_the_recorded_one_is_refused(trunk):
    record = recorded(trunk)
    with pytest.raises(ValueError, match="the replay ends .* mm away from the record"):
        replayed_shapes(Trunk("trunk_coarse", stiffness_scale=1.2), record, np.array([20]))


def test_a_finite_element_robot_is_drawn_and_animated(trunk, tmp_path):
    saved = draw_robot(trunk, recorded(trunk), tmp_path, animate=True)
    assert [path.name for path in saved] == ["robot.svg", "robot.gif"] and all(path.is_file() for path in saved)


def test_circles_are_drawn_where_they_are_at_each_instant(trunk, tmp_path, monkeypatch):
    moving, seen = Circle(drifting((0.01, 0.0), (0.0, 0.02)), 0.004), []
    monkeypatch.setattr(deformation, "add_circles", lambda stills, centers, radii: seen.append((
        add_circles(stills, centers, radii), stills, centers, radii)))
    record = recorded(trunk)
    draw_robot(trunk, record, tmp_path, obstacles=(moving, HalfPlane((1.0, 0.0), 0.02)))
    (_, stills, centers, radii), = seen
    for axes, at in zip(stills.axes[len(centers):], centers):
        (circle,) = axes.patches
        np.testing.assert_allclose(circle.center, 1e3 * at[0])
        assert circle.radius == pytest.approx(4.0)
    np.testing.assert_allclose(centers[-1, 0] - trunk.rest[:2], [0.01, 0.02 * record.time[-1]])


def test_a_plant_without_a_shape_has_no_picture(tmp_path):
    assert draw_robot(SlowManifold(), SimpleNamespace(), tmp_path) == []
