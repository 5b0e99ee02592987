"""Each estimate recovers the known value in simulated recordings."""

import numpy as np
import pytest

from ssmr_torch.collection.excitation import Dithered, SmoothRandom
from ssmr_torch.recording_checks.noise import measurement_noise
from ssmr_torch.recording_checks.statics import turned
from ssmr_torch.recording_clocks.onset import onset_of
from ssmr_torch.recording_estimates.modes import slow_modes

BOUNDS = np.array([[-2.0, -2.0], [2.0, 2.0]])


def dithered(rng, seconds, step):
    return Dithered(SmoothRandom())(rng, round(seconds / step), step, BOUNDS)


def smooth(rng, seconds, step):
    return SmoothRandom(knot_interval=2.0)(rng, round(seconds / step), step, BOUNDS)


def training(data, kind=None):
    return [run.read() for run in data.select("train", kind)]


def signals(data, kind=None):
    return [(run.observation, run.input) for run in training(data, kind)]


@pytest.mark.parametrize("std", [0.005, 0.02, 0.1])
@pytest.mark.parametrize("rate", [50, 100, 500])
def test_white_noise_is_found_within_a_tenth(robot, std, rate):
    found = measurement_noise(training(robot(noise=std, step=1 / rate, decays=8, duration=5.0, controlled=2)))
    np.testing.assert_allclose(1e3 * found.std, std, rtol=0.1)
    assert not found.bound and (found.step == 0).all()


def test_the_estimate_of_white_noise_is_not_biased(robot):
    ratios = [measurement_noise(training(robot(noise=0.05, seed=seed))).std / 5e-5 for seed in range(6)]
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.02)


def test_without_noise_the_estimate_is_called_a_bound(robot):
    found = measurement_noise(training(robot(noise=0.0, decays=2, controlled=1)))
    assert found.bound and found.std.max() < 1e-6


def test_rounding_is_seen_with_its_step(robot):
    data = robot(noise=0.02, decays=2, controlled=1)
    rounded = [type(run)(run.time, np.round(run.observation / 1e-5) * 1e-5, run.input) for run in training(data)]
    np.testing.assert_allclose(measurement_noise(rounded).step, 1e-5, rtol=1e-6)


@pytest.mark.parametrize("late", [0, 1, 5, 30, -1, -30])
@pytest.mark.parametrize("noise", [0.0, 0.02])
@pytest.mark.parametrize("inputs", ["held", "dithered"])
def test_a_delay_is_recovered_within_a_sample(robot, late, noise, inputs):
    options = {"inputs": dithered} if inputs == "dithered" else {}
    found = onset_of(signals(robot(noise=noise, late=late, **options), "controlled"))
    assert abs(found.samples - late) <= 1


def test_a_delay_is_the_same_at_another_rate(robot):
    assert onset_of(signals(robot(step=0.02, late=5, seconds=30.0), "controlled")).samples == 5


def test_inputs_that_hardly_change_give_no_delay(robot):
    still = robot(inputs=lambda rng, seconds, step: np.ones((round(seconds / step), 2)) * np.linspace(
        0, 1e-6, round(seconds / step))[:, None])
    assert onset_of(signals(still, "controlled")).samples is None


@pytest.mark.parametrize("step", [0.005, 0.01, 0.02])
def test_the_slow_modes_are_those_of_the_robot(robot, step):
    found = slow_modes(training(robot(step=step)))
    carrying = found.rates[found.share > 0.1]
    np.testing.assert_allclose(np.sort_complex(carrying), np.sort_complex([-1.8 + 15.0j, -1.5 + 12.5j]), rtol=0.03)
    assert found.free and found.fastest.imag == pytest.approx(15.0, rel=0.02)


def test_without_decays_the_fastest_slow_mode_is_found_roughly(robot):
    found = slow_modes(training(robot(noise=0.0, decays=0)))
    assert not found.free and any(abs(rate - (-1.8 + 15.0j)) < 0.5 for rate in found.rates)


def test_an_input_has_turned_when_it_went_back_by_a_twentieth_of_its_range():
    u = np.concatenate([np.linspace(0, 1, 100), np.linspace(1, 0.97, 10), np.linspace(0.97, 1, 10),
                        np.linspace(1, 0, 100)])
    directions, clear = (each[:, 0] for each in turned(u[:, None]))
    assert (directions[10:120] == 1).all() and (directions[130:] == -1).all()
    assert clear[60:110].all() and not clear[121:125].any() and clear[140:].all()
