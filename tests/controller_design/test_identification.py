"""Claims about the identified actuators: delay, lag, play, cable friction, and none where there is none."""

import pytest
from oscillators import MIXED, PULL, SIGNED, H, Oscillators, recordings

from ssmr_torch.controller_design.identification import LAGS, identify, in_words
from ssmr_torch.controller_design.recordings import recordings_of

NOISY = {"of_sensor": 3e-5, "of_inputs": 0.005}


def found(bounds, **settings):
    robot = Oscillators(bounds, **NOISY, **settings)
    return identify(recordings_of(recordings(robot, runs=4, seconds=14.0, test=0), (0, 1), robot.input_bounds))


@pytest.mark.parametrize("bounds, delay, lag, cubic", [(SIGNED, 2, 0.04, 0.0), (PULL, 3, 0.06, 50.0),
                                                       (MIXED, 1, 0.0, 0.0)], ids=["signed", "pull", "mixed"])
def test_a_delay_is_found_to_the_sample_and_a_lag_to_the_nearest_of_the_grid(bounds, delay, lag, cubic):
    told = found(bounds, delay=delay, lag=lag, cubic=cubic)
    assert told.actuator.delay == delay
    assert told.actuator.lag == pytest.approx(min((each * H for each in LAGS), key=lambda each: abs(each - lag)))
    assert told.actuator.play == told.actuator.friction == 0.0 and told.actuator.rate is None
    assert told.error < 0.5 * told.plain


def test_play_is_found_beside_delay_and_lag():
    told = found(SIGNED, delay=1, lag=0.04, play=0.05)
    assert (told.actuator.delay, told.actuator.lag, told.actuator.play) == (1, pytest.approx(0.04), 0.05)
    assert told.actuator.friction == 0.0


def test_the_friction_of_cables_is_found_beside_delay_and_lag():
    told = found(PULL, delay=1, lag=0.02, friction=0.1)
    assert (told.actuator.delay, told.actuator.friction, told.actuator.play) == (1, 0.1, 0.0)
    assert told.actuator.lag == pytest.approx(0.02, abs=0.5 * H)


def test_commands_that_act_directly_have_no_actuator():
    said = []
    robot = Oscillators(**NOISY)
    recorded = recordings_of(recordings(robot, runs=4, seconds=14.0, test=0), (0, 1), robot.input_bounds)
    told = identify(recorded, say=said.append)
    assert told.actuator.trivial and told.error == told.plain
    assert "none, commands act directly" in in_words(told.actuator) and "none" in said[0]


def test_inputs_that_push_and_pull_are_never_given_the_friction_of_cables():
    """Capstan friction is about zero force: where forces cross it, its play is that of gears."""
    told = found(SIGNED, delay=1, lag=0.02, friction=0.15)
    assert told.actuator.friction == 0.0
    assert not any(name == "friction" for name, _ in told.by_friction)


def test_the_profiles_are_least_at_what_was_found():
    told = found(SIGNED, delay=2, lag=0.04)
    assert min(told.by_delay, key=told.by_delay.get) == told.actuator.delay
    assert min(told.by_lag, key=told.by_lag.get) == pytest.approx(told.actuator.lag)
    assert told.by_delay[told.actuator.delay] == told.error
