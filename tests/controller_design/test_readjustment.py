"""Claims about readjustment: what it finds in twelve seconds of operation, and what it rejects."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import DELAY, LAG, OF_SENSOR
from oscillators import H, Oscillators

import ssmr_torch as ssmr
from ssmr_torch.closed_loop.simulation import simulate
from ssmr_torch.controller_design.readjustment import readjustment

FAST = ssmr.tasks.figure_eight(0.006, 3.0, laps=5.5, tracked=("x", "y"))
NOISY = {"of_sensor": OF_SENSOR, "of_inputs": 0.002}


def operated(designed, seed=11, **changes):
    """Some twelve seconds of the designed controller on a robot that is not as it was."""
    robot = Oscillators(**{**NOISY, "delay": DELAY, "lag": LAG, **changes})
    return robot, simulate(robot, designed.controller.changed(FAST), FAST, seed=seed)


@pytest.fixture(scope="module")
def expected(designed):
    """What the design's model misses of a run of the robot as it was, of the reach."""
    return readjustment(designed.controller, operated(designed)[1]).before


def tracking_rms(record):
    return float(np.sqrt(np.square(record.error[record.time >= 1.0]).sum(1).mean()))


def improved(controller, robot, record):
    again = simulate(robot, controller.changed(FAST), FAST, seed=12)
    return tracking_rms(again) / tracking_rms(record)


def test_more_delay_and_lag_are_found(designed, expected):
    robot, record = operated(designed, delay=DELAY + 1, lag=0.06)
    controller, found = designed.controller.readjust(record, expected=expected)
    assert found.accepted and found.actuator.delay == DELAY + 1
    assert found.actuator.lag == pytest.approx(0.06, abs=H)
    assert found.after < 0.5 * found.before and improved(controller, robot, record) < 0.5


def test_an_input_of_less_gain_is_found(designed, expected):
    robot, record = operated(designed, gain=np.array([0.8, 1.0]))
    controller, found = designed.controller.readjust(record, expected=expected)
    assert found.accepted
    assert found.actuator.factor == pytest.approx([0.8, 1.0], abs=0.03)
    assert found.after < 0.5 * found.before and improved(controller, robot, record) < 0.7


def test_play_is_found(designed, expected):
    robot, record = operated(designed, play=0.05)
    controller, found = designed.controller.readjust(record, expected=expected)
    assert found.accepted and found.actuator.play == pytest.approx(0.05, abs=0.011)
    assert found.after < 0.5 * found.before and improved(controller, robot, record) < 0.6


def test_an_unchanged_robot_keeps_its_actuator(designed, expected):
    _, record = operated(designed)
    controller, found = designed.controller.readjust(record, expected=expected)
    assert not found.accepted and "no change explains the records better" in found.words
    assert controller is designed.controller


def test_a_change_that_is_not_in_the_actuators_is_not_accepted_and_both_errors_are_given(designed, expected):
    """A robot of twice the stiffness: no actuator makes it the old one."""
    _, record = operated(designed, pace=np.array([1.5, 0.7, 1.0]))
    controller, found = designed.controller.readjust(record, expected=expected)
    assert not found.accepted and "Something else has changed: record" in found.words
    assert f"{100 * expected:.3g} %" in found.words
    assert controller is designed.controller


def test_a_short_record_is_refused_with_both_lengths(designed):
    _, record = operated(designed)
    parts = {name: getattr(record, name)[:150] for name in
             ("time", "reference", "observation", "measurement", "input", "fallback", "solve_time", "iterations",
              "statuses", "violation")}
    with pytest.raises(ValueError, match=r"the records last 3 s; expected 5 s of operation or more"):
        readjustment(designed.controller, replace(record, **parts))


def test_a_record_that_stands_still_is_refused_with_both_shares(designed):
    _, record = operated(designed)
    slow = replace(record, input=np.full_like(record.input, 0.1) + 1e-4 * np.sin(record.time)[:, None])
    with pytest.raises(ValueError, match=r"change by at most 0.01 % of their range; expected 2 % or more"):
        readjustment(designed.controller, slow)


def test_a_record_of_another_robot_is_refused_with_both_sizes(designed):
    _, record = operated(designed)
    with pytest.raises(ValueError, match=r"6 outputs and 3 inputs; expected 6 and 2"):
        readjustment(designed.controller, replace(record, input=np.zeros((len(record.time), 3))))


def test_missing_samples_and_several_records_are_accepted(designed):
    _, record = operated(designed, delay=DELAY + 1)
    holed = record.measurement.copy()
    holed[::37] = np.nan
    found = readjustment(designed.controller, [replace(record, measurement=holed), record])
    assert found.accepted and found.actuator.delay == DELAY + 1


def test_the_expected_error_is_the_designs_error_on_its_own_runs(designed, expected):
    """A robot in which something else has changed is not mistaken for one with other actuators."""
    said = designed.controller.facts["operation_error"]
    assert 0.5 * expected < said < 2.0 * expected
    _, record = operated(designed, pace=np.array([1.5, 0.7, 1.0]))
    assert not readjustment(designed.controller, record).accepted
