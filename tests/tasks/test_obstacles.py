"""Obstacles: clearances, motion, seeded sets."""

import numpy as np
import pytest

from ssmr_torch.tasks.obstacles import Circle, HalfPlane, drifting, random_circles
from ssmr_torch.tasks.references import Task


def test_the_clearance_of_a_circle_is_negative_inside():
    circle = Circle((0.01, 0.0), 0.004)
    outputs = np.array([[0.01, 0.0, 9.0], [0.014, 0.0, 9.0], [0.01, 0.010, 9.0]])
    np.testing.assert_allclose(circle.clearance(np.zeros(3), outputs), [-0.004, 0.0, 0.006], atol=1e-15)


def test_a_moving_circle_is_where_its_function_says():
    circle = Circle(drifting((0.0, 0.01), (0.002, 0.0)), 0.001)
    np.testing.assert_allclose(circle.centers([0.0, 2.0]), [[0.0, 0.01], [0.004, 0.01]])
    np.testing.assert_allclose(circle.clearance([2.0], np.array([[0.004, 0.012]])), [0.001])


def test_the_normal_of_a_half_plane_is_scaled_to_one():
    wall = HalfPlane((0.0, 2.0), 0.02)
    np.testing.assert_allclose(wall.clearance(np.zeros(1), np.array([[5.0, 0.004]])), [0.006])


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(1, 20))])
def test_random_circles_leave_the_gaps_that_were_asked_for(seed):
    circles = random_circles(seed)
    centers, radii = np.stack([c.center for c in circles]), np.array([c.radius for c in circles])
    apart = np.linalg.norm(centers[:, None] - centers, axis=-1) - radii[:, None] - radii + 1e3 * np.eye(20)
    assert len(circles) == 20 and apart.min() >= 0.003 and (np.linalg.norm(centers, axis=1) - radii).min() >= 0.010
    assert np.abs(centers).max() <= 0.030 and 0.004 <= radii.min() and radii.max() <= 0.006
    np.testing.assert_array_equal(random_circles(seed)[7].center, circles[7].center)


@pytest.mark.parametrize("make", [lambda: Circle((0.0, 0.0), 0.0), lambda: Circle((0.0,), 0.1),
                                  lambda: Circle(lambda time: np.zeros(3), 0.1), lambda: HalfPlane((0.0, 0.0), 1.0),
                                  lambda: random_circles(0, count=500)])
def test_impossible_obstacles_are_refused(make):
    with pytest.raises(ValueError, match="expected|leaves room"):
        make()


def test_an_obstacle_over_more_outputs_than_are_tracked_is_refused():
    with pytest.raises(ValueError, match="needs 2 tracked outputs; the task tracks 1"):
        Task("line", 1.0, (0,), lambda time: np.zeros((len(time), 1)), (Circle((0.0, 0.01), 0.001),))
