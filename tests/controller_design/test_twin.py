"""Claims about loops against a twin: what they count, and what is lost."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import H
from oscillators import Oscillators

import ssmr_torch as ssmr
from ssmr_torch.controller_design.noises import Noises
from ssmr_torch.controller_design.twin import BEGIN, CASES, PATIENCE, Case, Twin, recorded_motion, tracking_error

SILENT, SENSOR = Noises(0.0, 0.0, 0.0, 0.0), Noises(0.0, 0.0, 0.0, 1e-3)
AS_IT_IS, TRACKED = CASES[0], (0, 1)


@pytest.fixture(scope="module")
def case(exact):
    return exact(Oscillators(), delay=2, lag=0.04)


@pytest.fixture(scope="module")
def motion(case):
    return recorded_motion(case.recordings, ("x", "y"))


def error(case, motion, noises, how=AS_IT_IS, controller=None):
    twin = Twin(case.model, case.actuator, case.recordings, noises, how)
    return tracking_error(twin, controller or case.controller(motion), motion, TRACKED)


def test_with_a_perfect_model_and_no_noise_the_error_is_nearly_zero(case, motion):
    assert error(case, motion, SILENT) < 2e-3


def test_with_a_perfect_model_the_remaining_error_comes_from_the_noise(case, motion):
    """A filter passes less than a sample has, √2 σ in two outputs; ten times the noise costs ten times as much."""
    alone, ten = error(case, motion, SILENT), replace(SENSOR, sensor=10 * SENSOR.sensor)
    of_noise, of_more = (np.sqrt(error(case, motion, noises)**2 - alone**2) for noises in (SENSOR, ten))
    assert 0.05 * SENSOR.sensor < of_noise < np.sqrt(2) * SENSOR.sensor
    assert of_more == pytest.approx(10 * of_noise, rel=0.35)


def test_noise_of_the_sensors_shows_in_the_error(case, motion):
    assert error(case, motion, replace(SILENT, sensor=0.02)) > 2 * error(case, motion, SILENT)


@pytest.mark.parametrize("how", CASES[1:], ids=lambda how: how.name)
def test_every_disturbance_of_the_twin_costs_accuracy_but_loses_no_good_loop(case, motion, how):
    assert error(case, motion, SILENT) < error(case, motion, SILENT, how) < 0.1


class Given:
    """A controller of inputs (m,) over time, s, whatever is measured."""

    def __init__(self, of_time):
        self.of_time = of_time

    def reset(self):
        pass

    def __call__(self, time, measured):
        return SimpleNamespace(input=np.asarray(self.of_time(time), dtype=float))


def test_a_diverging_loop_counts_as_lost(case, motion):
    assert error(case, motion, SILENT, controller=Given(lambda time: [1.0, 1.0])) == np.inf


def test_a_loop_that_is_far_off_for_a_moment_is_not_lost(case):
    still = ssmr.tasks.path([0.0, 4.0], [[0.0, 0.0], [0.0, 0.0]], ["x", "y"])
    def pushed(seconds):
        push = Given(lambda time: [float(2.0 <= time < 2.0 + seconds), 0.0])
        return error(case, still, SILENT, controller=push)

    short, long = pushed(0.02), pushed(2 * PATIENCE)
    assert 0.0 < short < 0.2 and long == np.inf


def test_outputs_that_are_not_finite_are_lost_at_once(case, motion):
    assert error(case, motion, SILENT, controller=Given(lambda time: [np.nan, 0.0])) == np.inf


def test_errors_in_the_first_second_do_not_count(case):
    still = ssmr.tasks.path([0.0, 4.0], [[0.0, 0.0], [0.0, 0.0]], ["x", "y"])
    early = error(case, still, SILENT, controller=Given(lambda time: [float(time < 0.1 * BEGIN), 0.0]))
    assert early < 0.02


def test_the_same_twin_gives_the_same_error_to_the_last_bit(case, motion):
    assert error(case, motion, SENSOR) == error(case, motion, SENSOR)


def test_the_twin_delays_by_what_a_case_says_in_whole_samples(case):
    def first_moved(how):
        twin = Twin(case.model, case.actuator, case.recordings, SILENT, how)
        rest = twin.reset()
        return next(k for k in range(20) if np.abs(twin.step(np.array([1.0, 0.0])) - rest).max() > 1e-6)

    own = first_moved(AS_IT_IS)
    assert own == case.actuator.delay
    assert first_moved(Case("late", delay=0.06)) == own + 3
    assert first_moved(Case("half a sample", delay=0.2 * H)) == own + 1


def test_a_recorded_motion_is_smaller_and_slower_than_what_was_recorded_and_starts_at_rest(case):
    motion = recorded_motion(case.recordings, ("x", "y"))
    wide = recorded_motion(case.recordings, ("x", "y"), scale=2.2)
    times = np.linspace(0.0, motion.duration, 400)
    path, far = motion.reference(times), wide.reference(times)
    assert np.linalg.norm(path, axis=1).max() < 0.75 * case.recordings.reach
    np.testing.assert_allclose(far, 2.2 * path, atol=1e-12)
    assert np.linalg.norm(path[0]) < 0.05 * case.recordings.reach
