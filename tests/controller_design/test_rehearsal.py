"""Claims about a rehearsal: the static floor, what is out of reach, which bounds hold, and how fast it can go."""

import numpy as np
import pytest
from oscillators import PULL, Oscillators
from scipy.optimize import lsq_linear

import ssmr_torch as ssmr
from ssmr_torch.controller_design.rehearsal import POINTS, rehearse

LARGE = ssmr.tasks.circle(0.03, 1.5, laps=1, tracked=("x", "y"))
SMALL = ssmr.tasks.circle(0.004, 1.5, laps=1, tracked=("x", "y"))


@pytest.fixture(scope="module")
def pulled(exact):
    """Four cables that only pull."""
    robot = Oscillators(PULL)
    return robot, exact(robot)


@pytest.fixture(scope="module")
def far(pulled):
    return rehearse(pulled[1].controller(LARGE))


def test_the_static_floor_of_a_linear_robot_follows_from_its_bounds(pulled, far):
    """The least of |G u − point| over 0 ≤ u ≤ 1.5, at each point by itself."""
    G, (lower, upper) = pulled[0].static[:2], PULL
    points = LARGE.reference(np.linspace(0.0, LARGE.duration, POINTS))
    floor = [np.linalg.norm(G @ lsq_linear(G, point, (lower, upper), tol=1e-12).x - point) for point in points]
    assert max(floor) > 0.01 and min(floor) < 1e-9
    np.testing.assert_allclose(far.floor, floor, rtol=0, atol=2e-5)
    samples = LARGE.duration / pulled[0].timestep
    assert far.static_ise == pytest.approx(np.square(floor).mean() * samples, rel=0.01)


def test_the_share_out_of_reach_and_the_inputs_at_their_bounds_are_reported(far):
    assert 0.2 < far.out_of_reach < 0.9
    assert far.held and all(0.0 < share <= 1.0 for share in far.held.values())
    assert any("lowest" in name for name in far.held)
    said = repr(far)
    assert f"{100 * far.out_of_reach:.3g} % of the path" in said and "static floor: ISE" in said


def test_within_reach_the_floor_is_zero_and_no_input_is_held_at_its_highest(pulled):
    near = rehearse(pulled[1].controller(SMALL))
    assert near.floor.max() < 1e-5 and near.out_of_reach == 0.0
    assert not any("highest" in name for name in near.held)
    assert "all within reach" in repr(near) and near.rmse < 1e-3


def test_another_task_than_the_controllers_own_can_be_rehearsed(pulled):
    assert rehearse(pulled[1].controller(LARGE), SMALL).floor.max() < 1e-5


def test_a_slower_robot_is_rehearsed_as_one_that_cannot_go_as_fast(exact):
    task = ssmr.tasks.circle(0.012, 2.0, laps=2, tracked=("x", "y"))
    quick, slow = (rehearse(exact(Oscillators(pace=pace)).controller(task)) for pace in (1.0, 0.4))
    assert slow.fastest < quick.fastest
    assert slow.floor.max() < 1e-5 and quick.floor.max() < 1e-5
