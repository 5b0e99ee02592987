"""The robots by soromox: their integrator's order, their rest, and what is known of beams and valves."""

from functools import cache

import numpy as np
import pytest

pytest.importorskip("soromox", reason="the extra robots is not installed")

from ssmr_torch.plants.isupport import LENGTHS, ISupport  # noqa: E402
from ssmr_torch.plants.planar_hsa import PlanarHSA  # noqa: E402

pytestmark = pytest.mark.slow  # each is compiled for some ten seconds
ROBOTS = {"I-SUPPORT": ISupport, "planar HSA": PlanarHSA}


@cache
def built(name, **settings):
    return ROBOTS[name](**settings)


def moved(robot, inputs):
    robot.reset()
    return np.array([robot.step(u) for u in inputs])


@pytest.mark.parametrize("name, substeps", [("I-SUPPORT", (5e-3, 2.5e-3, 1.25e-3)), ("planar HSA", (2e-3, 1e-3, 5e-4))])
def test_its_integration_converges_with_order_two(name, substeps):
    robots = [built(name, substep=substep) for substep in substeps]
    lowest, highest = robots[0].input_bounds
    inputs = np.random.default_rng(0).uniform(lowest, highest, (5, len(lowest))).repeat(6, axis=0)
    coarse, middle, fine = (moved(robot, inputs) for robot in robots)
    ratio = np.abs(coarse - middle).max() / np.abs(middle - fine).max()
    assert 3.0 < ratio < 6.0
    assert np.abs(middle - fine).max() < 0.01 * np.abs(fine).max()


@pytest.mark.parametrize("name", ROBOTS)
def test_it_stays_at_rest(name):
    robot = built(name)
    np.testing.assert_allclose(moved(robot, np.zeros((50, len(robot.input_names)))), 0.0, atol=1e-11)


def test_the_supports_pressure_follows_a_step_with_the_valves_time_constant():
    arm = built("I-SUPPORT")
    command = np.linspace(1e5, 2e5, 6)
    arm.reset()
    for k in range(1, 11):
        arm.step(command)
        np.testing.assert_allclose(arm.state[-6:], command * (1 - np.exp(-0.01 * k * 2 * np.pi * 2.8)), rtol=1e-10)


def test_the_support_hangs_straight_and_stretches_by_what_its_sections_carry():
    arm = built("I-SUPPORT")
    walls = 3 * np.pi * (7.79e-3 ** 2 - 6.39e-3 ** 2)       # m², that weigh; the springs are those of the full section
    section, plates = 6471.0 * walls, 1210.0 * np.pi * 0.030 ** 2  # kg/m
    below = {"upper": section * 0.18 + plates * 0.033, "lower": plates * 0.006}
    spring = 1.0766e6 * np.pi * 0.030 ** 2 / 0.18           # N/m, of a section
    stretched = sum((below[part] + section * 0.18 / 2) * 9.81 / spring for part in below)
    assert arm.rest[:2] == pytest.approx(0.0, abs=1e-9)
    assert arm.rest[2] - sum(LENGTHS) == pytest.approx(stretched, rel=0.02)


def test_a_third_of_a_turn_of_the_chambers_turns_the_supports_tip():
    arm = built("I-SUPPORT")
    first, second = (moved(arm, np.tile(np.eye(6)[chamber] * 1e5, (40, 1)))[-1][:2] for chamber in (0, 1))
    angle = 2 * np.pi / 3
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    assert min(np.abs(turn @ first - second).max(), np.abs(turn.T @ first - second).max()) < 1e-9
    assert np.linalg.norm(first) > 1e-3


def test_swapping_the_twists_mirrors_the_platform():
    robot = built("planar HSA")
    right = moved(robot, np.tile([1.0, 3.0], (40, 1)))
    left = moved(robot, np.tile([3.0, 1.0], (40, 1)))
    np.testing.assert_allclose(left, right[:, [2, 3, 0, 1]] * [-1, 1, -1, 1], atol=1e-9)


def test_equal_twists_lengthen_the_rods_by_their_handedness_and_the_platforms_weight():
    robot, twist = built("planar HSA"), 2.0
    displacement = moved(robot, np.tile([twist, twist], (400, 1)))[-1]
    assert displacement[1] == pytest.approx(displacement[3], abs=1e-9)
    # A rod's rest length grows by strain_coupling per radian; its springs, stiffer by the twist, carry the same weight.
    weightless, stiffened = 0.00984819 * twist, 0.01508165 / 0.059 * twist / 5.66472469
    sag = robot.rest[1] - (0.025 + 0.059 + 0.014 + 0.012)
    assert displacement[1] == pytest.approx(weightless - sag * stiffened / (1 + stiffened), rel=1e-3)
