"""The guard: what it stops, what it lets pass, and how the input goes back to neutral."""

import numpy as np
import pytest

from ssmr_torch.commissioning.robot_card import fitted
from ssmr_torch.commissioning.safety_guard import GuardedPlant, SafetyStop


@pytest.fixture
def guard(robot, card):
    """A guarded robot; keywords of the card, plant=… and options of the guard in `more`."""
    def make(plant=None, more=(), **changes):
        plant = plant or robot(noise=0.0)
        return GuardedPlant(plant, fitted(card(**changes), plant), **dict(more))

    return make


def push(plant, u, steps):
    plant.reset(0)
    for _ in range(steps):
        plant.step(np.array(u))


def test_within_the_limits_a_guarded_robot_behaves_like_the_robot(guard, robot):
    watched, bare = guard(robot()), robot()
    inputs = np.random.default_rng(0).uniform(-0.3, 0.3, (200, 2))
    seen = [watched.reset(3), *map(watched.step, inputs)]
    np.testing.assert_array_equal(seen, [bare.reset(3), *map(bare.step, inputs)])
    run = watched.run("whole")
    np.testing.assert_array_equal(run.observation, seen)
    np.testing.assert_array_equal(run.input[:-1], inputs)


@pytest.mark.parametrize(("limits", "words"), [
    ({"displacement_limit": 0.01}, "10 mm"), ({"rate_limit": 0.05}, "rate_limit of 0.05 m/s")])
def test_beyond_a_limit_the_input_goes_back_by_a_ramp_and_the_robot_steps_no_more(guard, limits, words):
    watched = guard(**limits)
    with pytest.raises(SafetyStop, match=words):
        push(watched, [0.8, 0.8], 200)
    after = np.array(watched.plant.commands)
    start = int(np.argmax(after[:, 0] < 0.8))
    np.testing.assert_allclose(after[start:, 0], 0.8 * (1 - np.arange(1, 101) / 100), atol=1e-12)
    np.testing.assert_array_equal(after[-1], 0.0)
    commands = len(watched.plant.commands)
    with pytest.raises(SafetyStop, match="reset it"):
        watched.step(np.zeros(2))
    assert len(watched.plant.commands) == commands
    watched.reset(0)
    watched.step(np.zeros(2))


def test_a_single_wrong_sample_does_not_stop_and_lost_samples_do_not_look_like_speed(guard, robot):
    class Outlier(robot):
        def _seen(self):
            return np.full(3, 1.0) if self._k == 50 else super()._seen()

    push(guard(Outlier(), displacement_limit=0.2, rate_limit=0.5), [0.3, 0.3], 150)
    push(guard(robot(lost=range(20, 40)), rate_limit=0.2), [0.3, 0.0], 150)
    with pytest.raises(SafetyStop):
        push(guard(robot(wild=50)), [0.3, 0.3], 60)


def test_without_measurements_it_stops_after_the_blind_limit(guard, robot):
    watched = guard(robot(lost=range(30, 1000)), blind_limit=0.1)
    with pytest.raises(SafetyStop, match="no measurement came for 0.11 s"):
        push(watched, [0.2, 0.2], 100)
    run = watched.run("blind")
    np.testing.assert_array_equal(run.observation[30:], np.tile(run.observation[29], (run.length - 30, 1)))


def test_recordings_repeat_the_last_value_for_a_missing_sample_and_begin_with_a_measured_one(guard, robot):
    watched = guard(robot(lost=(0, 1, 20, 21), noise=1e-5), more={"bridged": True})
    first = watched.reset(0)
    seen = [watched.step(np.array([0.2, 0.2])) for _ in range(40)]
    assert np.isfinite(first).all() and np.isfinite(seen).all() and watched.run("held").length == 41
    np.testing.assert_array_equal(seen[16], seen[18])  # samples 20 and 21 are lost; seen[0] is sample 3
    assert (seen[16] != seen[19]).all()
    with pytest.raises(SafetyStop, match="no measurement came"):
        guard(robot(lost=range(1000)), more={"bridged": True}).reset(0)


def test_a_frozen_sensor_stops_a_moving_robot_that_is_known_to_be_noisy(guard, robot):
    class Frozen(robot):
        def _seen(self):
            return np.full(3, 1e-3)

    push(guard(Frozen()), [0.2, 0.2], 100)
    with pytest.raises(SafetyStop, match="exactly the same values"):
        push(guard(Frozen(), more={"noisy": True}), [0.2, 0.2], 100)
    push(guard(Frozen(), more={"noisy": True}), [0.0, 0.0], 100)  # at rest nothing has to change


def test_a_robot_that_is_already_too_far_is_not_moved_at_all(guard, robot):
    class Hanging(robot):
        def _seen(self):
            return np.array([0.0, 0.07, 0.0])

    watched = guard(Hanging())
    with pytest.raises(SafetyStop, match="y is 70 mm from rest"):
        watched.reset(0)
    assert watched.plant.commands == []


def test_inputs_stay_within_the_cards_bounds_and_the_share_about_the_neutral_input(guard, robot):
    watched = guard(robot(bounds=(0.0, 1.0)), bounds=[[0.1, 0.0], [0.9, 0.8]], neutral=[0.5, 0.0], settle=0.0)
    half = watched.narrowed(0.5)
    np.testing.assert_allclose(half.input_bounds, [[0.3, 0.0], [0.7, 0.4]])
    half.reset(0)
    half.step(np.array([9.0, -9.0]))
    np.testing.assert_allclose(half.plant.commands[-1], [0.7, 0.0])
    with pytest.raises(ValueError, match="share is 0"):
        watched.narrowed(0)


def test_a_neutral_input_that_the_robot_does_not_rest_under_is_reached_by_a_ramp_before_every_run(guard, robot):
    watched = guard(robot(bounds=(0.0, 1.0), noise=0.0), neutral=[0.4, 0.0], settle=2.0)
    first = watched.reset(0)
    commands = np.array(watched.plant.commands)
    assert len(commands) == 300 and np.abs(np.diff(commands[:, 0])).max() < 0.0041
    np.testing.assert_array_equal(commands[100:], np.tile([0.4, 0.0], (200, 1)))
    assert watched.run("none") is None and abs(first[0]) > 1e-3


def test_a_robot_that_is_gone_is_left_to_itself(guard, robot):
    watched = guard()
    push(watched, [0.2, 0.2], 10)

    def gone(input):
        raise ConnectionError("gone")

    watched.plant.step = gone
    given = len(watched.plant.commands)
    watched.relax()
    assert len(watched.plant.commands) == given


def test_a_state_is_refused(guard):
    with pytest.raises(ValueError, match="cannot be put into a state"):
        guard().reset(state=np.zeros(4))
