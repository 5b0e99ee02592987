"""Claims about references that are led around obstacles."""

from dataclasses import replace

import numpy as np
import pytest

from ssmr_torch.closed_loop.simulation import simulate
from ssmr_torch.control.mpc import ModelPredictiveController
from ssmr_torch.tasks.detour import detour
from ssmr_torch.tasks.obstacles import Circle, drifting, random_circles
from ssmr_torch.tasks.references import path
from ssmr_torch.tasks.symbols import symbol

# Two circles overlap in front of the robot: a pocket that is open towards the start of the reference.
POCKET = (Circle((0.008, 0.003), 0.0035), Circle((0.008, -0.003), 0.0035), Circle((0.006, 0.0075), 0.002))


def across(obstacles, duration=3.0):
    """From rest straight to (16, 0) mm."""
    return path([0.0, 0.3, 0.3 + 0.5 * duration, duration], [[0.0, 0.0], [0.0, 0.0], [0.016, 0.0], [0.016, 0.0]],
                outputs=(0, 1), obstacles=obstacles)


def test_the_detour_around_one_circle_is_the_shortest_that_keeps_the_clearance():
    task = across((Circle((0.008, 0.0005), 0.004),))
    led = detour(task, 0.001).reference(np.linspace(0.0, 3.0, 3001))
    distance = np.linalg.norm(led - [0.008, 0.0005], axis=1)
    assert distance.min() == pytest.approx(0.005, rel=1e-4)
    assert led[:, 1].min() < -0.004 and led[:, 1].max() <= 1e-9  # below, where the circle reaches less far
    # the arc between the ends of the chord, on the polygon
    length, chord = np.linalg.norm(np.diff(led, axis=0), axis=1).sum(), 2 * np.sqrt(0.005**2 - 0.0005**2)
    assert length == pytest.approx(0.016 - chord + 0.005 * (np.pi - 2 * np.arcsin(0.1)), rel=5e-3)


def test_a_detour_changes_only_the_parts_near_obstacles_and_is_clear_everywhere():
    for seed in range(3):
        task = symbol("ETH", tracked=(0, 1), obstacles=random_circles(seed))
        time = np.linspace(0.0, task.duration, 10001)
        given, led = task.reference(time), detour(task, 0.001).reference(time)
        clear = np.min([c.clearance(time, given) for c in task.obstacles], axis=0)
        after = np.min([c.clearance(time, led) for c in task.obstacles], axis=0)
        np.testing.assert_allclose(led[clear > 0.0012], given[clear > 0.0012], atol=2e-5)  # which rounds corners
        assert after.min() > 0.001 - 2e-5 and clear.min() < -0.003  # straight between the samples of the reference


def test_a_robot_caught_between_two_circles_arrives_when_it_follows_the_detour(trial):
    task, ends = across(POCKET), []
    for given in (task, detour(task, 0.0005)):
        plant = trial.ModelPlant(trial.oscillators(), np.array([[0.0] * 4, [1.2] * 4]))
        controller = ModelPredictiveController(plant.model, given, plant.input_bounds, input_weight=1440.0)
        record = simulate(plant, controller, task)
        ends.append(np.linalg.norm(record.error[-1]))
        assert min(c.clearance(record.time, record.observation[:, :2]).min() for c in POCKET) > -3e-4
    assert ends[0] > 0.008 and ends[1] < 0.002


def test_ends_inside_an_obstacle_are_moved_to_the_nearest_point_outside():
    circle = Circle((0.016, 0.0), 0.003)
    led = detour(across((circle,)), 0.0005).reference(np.array([3.0]))[0]
    assert np.linalg.norm(led - circle.center) == pytest.approx(0.0035, rel=0.01)
    start = detour(across((Circle((0.0, 0.0), 0.002),))).reference(np.array([0.0]))[0]
    assert np.linalg.norm(start) == pytest.approx(0.002, rel=0.01)


def test_a_detour_that_does_not_exist_is_refused_with_its_time():
    angles = np.linspace(0.0, 2 * np.pi, 13)[:-1]
    wall = [Circle(0.008 * np.array([np.cos(a), np.sin(a)]) + [0.016, 0.0], 0.003) for a in angles]
    with pytest.raises(ValueError, match=r"inside an obstacle from 0\.\d+ to .* s, and no way around it keeps a"):
        detour(across(wall))
    with pytest.raises(ValueError, match="clearance is -1.0 m"):
        detour(across(wall), -1.0)


def test_a_detour_ignores_moving_circles_and_keeps_the_reference_of_other_outputs():
    moving = Circle(drifting((0.008, 0.0), (0.0, 0.001)), 0.003)
    task = across((moving,))
    assert detour(task, 0.001) is task
    circle = Circle((0.008, 0.0), 0.003)
    raised = path([0.0, 1.0, 2.0], [[0.0, 0.0, 0.0], [0.008, 0.0, 0.001], [0.016, 0.0, 0.0]], outputs=(0, 1, 2),
                  obstacles=(circle,))
    time = np.linspace(0.0, 2.0, 1001)
    np.testing.assert_allclose(detour(raised).reference(time)[:, 2], raised.reference(time)[:, 2], atol=1e-12)
    assert replace(raised, obstacles=()).reference(time)[500, 1] == 0.0 != detour(raised).reference(time)[500, 1]
