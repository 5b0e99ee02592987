"""Card, noise, steps, channels and circles, each on a robot whose answers are known."""

import numpy as np
import pytest
from known_robot import A, B, C

from ssmr_torch.commissioning.channels import admissible_share, channel_faults, channels_said, expectations
from ssmr_torch.commissioning.circles import circle_about, reach, tracked_outputs
from ssmr_torch.commissioning.noise import measure_noise, noise_faults, noise_said
from ssmr_torch.commissioning.robot_card import fitted, read_robot_card
from ssmr_torch.commissioning.safety_guard import GuardedPlant
from ssmr_torch.commissioning.steps import measure_steps
from ssmr_torch.plants.slow_manifold import SlowManifold
from ssmr_torch.trajectory import Trajectory, TrajectoryDataset

EXPECTED = {"left": "+x", "right": "+y"}
OUTPUTS = ("x", "y", "z")
STD = np.full(3, 2e-5)


@pytest.fixture
def guarded(card):
    return lambda plant, **changes: GuardedPlant(plant, fitted(card(**changes), plant))


def test_a_card_takes_from_the_robot_what_it_leaves_open_and_reads_itself_again(tmp_path, card, robot):
    whole = fitted(card(tracked=[], expected={}), robot(bounds=(0.2, 1.0)))
    assert whole.neutral == [0.2, 0.2] and whole.settle == 0.0 and whole.outputs == list(OUTPUTS)
    (tmp_path / "card.yaml").write_text(whole.text())
    assert read_robot_card(tmp_path / "card.yaml") == whole
    assert fitted(card(neutral=[0.5, 0.0]), robot()).settle == 3.0


@pytest.mark.parametrize(("changes", "words"), [
    ({"outputs": ["y", "x", "z"]}, "outputs .* the robot"), ({"name": "another"}, "another"),
    ({"bounds": [[-2, -1], [1, 1]]}, "within those of the robot"), ({"bounds": [0, 1]}, "two rows of 2 numbers"),
    ({"neutral": [0.0, 3.0]}, "neutral input is"), ({"neutral": ["a", 0]}, "2 numbers, one for each input"),
    ({"tracked": ["x", "w"]}, "tracked names"), ({"expected": {"left": "x"}}, "needs a sign"),
    ({"expected": {"up": "+x"}}, "expected, its keys"), ({"expected": {"left": "+w"}}, "expected, its outputs")])
def test_a_card_that_does_not_fit_the_robot_is_refused(card, robot, changes, words):
    with pytest.raises(ValueError, match=words):
        fitted(card(**changes), robot())


@pytest.mark.parametrize("changes", [{"displacement_limit": 0}, {"rate_limit": float("nan")}, {"ramp": -1},
                                     {"settle": -1}, {"tracked": ["x"]}, {"blind_limit": float("inf")}])
def test_limits_that_make_no_sense_are_refused(card, changes):
    with pytest.raises(ValueError, match=next(iter(changes))):
        card(**changes)


def test_a_key_that_the_card_does_not_know_is_named_with_the_nearest_one(tmp_path):
    (tmp_path / "card.yaml").write_text("displacement_limit: 0.1\nrate_limits: 1.0\n")
    with pytest.raises(ValueError, match="did you mean 'rate_limit'"):
        read_robot_card(tmp_path / "card.yaml")
    with pytest.raises(FileNotFoundError, match="docs/commissioning.md"):
        read_robot_card(tmp_path / "nothing.yaml")


def test_noise_drift_and_missing_samples_at_rest_are_measured(guarded, robot):
    plant = guarded(robot(noise=3e-5, drift=1e-6, lost=range(100, 500, 10)))
    noise = measure_noise(plant, 10.0)
    np.testing.assert_allclose(noise["std_m"], 3e-5, rtol=0.15)
    np.testing.assert_allclose(noise["drift_m_s"], 1e-4, atol=5e-6)
    assert noise["missing"] == pytest.approx(0.037, abs=0.003) and noise["held"] == 0 and noise["jitter"] is None
    faults = noise_faults(noise, plant)
    assert len(faults) == 2 and "from its zero" in faults[0] and "drifts by" in faults[1]
    assert "no clock of its own" in noise_said(noise, plant)


def test_repeated_samples_uneven_sampling_and_noise_that_looks_like_speed_are_named(guarded, robot):
    class Camera(robot):
        def step(self, input):
            before, seen = self._held, super().step(input)
            self.stamp = self.timestep * (self._k + 0.4 * (self._k % 2))
            self._held = before if self._k % 5 == 0 else seen
            return self._held

        _held, stamp = np.zeros(3), 0.0

    plant = guarded(Camera(noise=1e-4), rate_limit=0.05)
    noise = measure_noise(plant, 4.0)
    assert noise["held"] == pytest.approx(0.2, abs=0.01) and noise["jitter"] == pytest.approx(0.4, abs=1e-6)
    np.testing.assert_allclose(noise["std_m"], 1e-4, rtol=0.2)
    faults = " ".join(noise_faults(noise, plant))
    assert "20 % of the samples" in faults and "40 % of a timestep" in faults and "looks like 0.0" in faults


def test_silent_sensors_are_refused(guarded, robot):
    with pytest.raises(ValueError, match="sensors are silent"):
        measure_noise(guarded(robot(lost=range(1, 10_000)), blind_limit=100.0), 1.0)


@pytest.mark.parametrize("delay", [0, 1, 5])
def test_gain_and_delay_of_a_known_robot_are_found(guarded, robot, delay):
    answers = measure_steps(guarded(robot(delay=delay, noise=1e-5)), 0.5 * STD)
    gain = -C @ np.linalg.solve(A, B)
    for column, answer in enumerate(answers):
        np.testing.assert_allclose(answer.gain, gain[:, column], atol=0.03 * np.abs(gain).max())
        assert 0.01 * delay <= answer.delay_s <= 0.01 * (delay + 1)
        assert 0.6 < answer.settling_s - 0.01 * delay < 1.4  # e^(−3 t) falls to 5 % in 1 s
    assert channel_faults(answers, EXPECTED, OUTPUTS) == []


def test_steps_grow_until_the_answer_is_loud_and_no_further_than_near_the_limit(guarded, robot):
    quiet = measure_steps(guarded(robot(noise=1e-6)), np.full(3, 1e-6))
    assert [answer.size for answer in quiet] == [1 / 32, 1 / 32]
    near = measure_steps(guarded(robot(noise=1e-3), displacement_limit=0.012), np.full(3, 1e-3))
    assert all(answer.size <= 1 / 4 for answer in near)


@pytest.mark.parametrize(("wiring", "words"), [
    (((0, 1), (1, 0)), ["left and right are swapped: left moves +y, right moves +x"]),
    (((-1, 0), (0, 1)), ["left is reversed: it moves -x, expected +x"]),
    (((1, 0), (0, 0)), ["right is dead"]),
    (((1, 1), (0, 0)), ["right moves +x, expected +y"])])
def test_wrong_channels_are_named(guarded, robot, wiring, words):
    answers = measure_steps(guarded(robot(wiring)), STD)
    faults = channel_faults(answers, EXPECTED, OUTPUTS)
    assert len(faults) == len(words) and all(word in fault for word, fault in zip(words, faults))
    table = channels_said(answers, EXPECTED, OUTPUTS, "N")
    assert table.count("\n") == 3 and ("nothing" in table) == ("dead" in words[0])


def test_names_with_signs_say_what_is_expected_and_a_robot_that_agrees_has_no_faults(card):
    plant = SlowManifold()
    expected = expectations({}, plant.input_names, plant.output_names)
    assert expected == {"cable_+x": "+tip_x", "cable_-x": "-tip_x", "cable_+y": "+tip_y", "cable_-y": "-tip_y"}
    assert expectations({}, ("cable1", "cable_+x"), plant.output_names) == {}
    watched = GuardedPlant(plant, fitted(card(tracked=[], expected={}), plant))
    answers = measure_steps(watched, np.full(6, 1e-5))
    assert channel_faults(answers, expected, plant.output_names) == []
    crossed = expected | {"cable_+x": "-tip_x", "cable_-x": "+tip_x"}
    assert "cable_+x and cable_-x are swapped" in channel_faults(answers, crossed, plant.output_names)[0]


def test_the_share_of_the_range_keeps_every_single_input_within_the_limit(guarded, robot):
    answers = measure_steps(guarded(robot()), STD)
    largest = max(np.abs(answer.gain).max() for answer in answers)
    assert admissible_share(answers, np.ones(2), 10.0) == 1.0
    assert admissible_share(answers, np.ones(2), 0.5 * largest) == pytest.approx(0.45)


def disc(radius, centre):
    turn = np.linspace(0, 2 * np.pi, 2001)
    circle = centre[:, None] + radius * np.stack([np.cos(turn), np.sin(turn)])
    both = np.column_stack([*circle, 1e-4 * np.sin(3 * turn)])
    run = Trajectory(0.01 * np.arange(len(both)), both, np.zeros((len(both), 2)))
    return TrajectoryDataset([run], np.zeros(3), OUTPUTS, ("left", "right"), "1")


def test_the_reach_is_what_the_recordings_show_to_every_side():
    data = disc(0.03, np.array([0.0, 0.01]))
    assert reach(data, ["x", "y"], np.array([0.0, 0.01])) == pytest.approx(0.03, rel=0.01)
    assert reach(data, ["x", "y"], np.zeros(2)) == pytest.approx(0.02, rel=0.01)
    assert reach(data, ["x", "y"], np.array([0.0, 0.05])) == 0.0
    assert tracked_outputs(data, np.zeros(3)) == ("x", "y")


def test_a_circle_begins_and_ends_at_its_centre_and_keeps_its_radius_in_between():
    centre = np.array([0.001, -0.002])
    task = circle_about(centre, 0.01, 2.5, 3, ["x", "y"], "circle")
    time = np.linspace(0, task.duration, 4001)
    path = task.reference(time) - centre
    np.testing.assert_allclose(path[[0, -1]], 0.0, atol=1e-12)
    turning = (time > 2.0) & (time < task.duration - 2.0)
    np.testing.assert_allclose(np.linalg.norm(path[turning], axis=1), 0.01, rtol=1e-9)
    speed = np.linalg.norm(np.diff(path, axis=0), axis=1).max() / time[1]
    assert speed == pytest.approx(2 * np.pi * 0.01 / 2.5, rel=0.01)
    with pytest.raises(ValueError, match="name two other outputs"):
        circle_about(centre, 0.0, 2.5, 3, ["x", "y"], "circle")
