import numpy as np
import pytest

from ssmr_torch.data.sampling import SamplingRule, resample, to_grid
from ssmr_torch.recording_clocks.held_inputs import mean_of_held


def jittered(count, timestep, share, seed=0):
    rng = np.random.default_rng(seed)
    time = timestep * (np.arange(count) + share * rng.uniform(-1, 1, count))
    time[0] = 0.0
    return time


def test_the_resampled_motion_converges_with_fourth_order():
    errors = []
    for count in (101, 201, 401):
        h = 2.0 / (count - 1)
        time = jittered(count, h, 0.2)
        grid, motion, _ = resample(time, np.sin(5 * time)[:, None], np.zeros((count, 1)), h)
        inner = slice(10, -10)
        errors.append(np.abs(motion[inner, 0] - np.sin(5 * grid[inner])).max())
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (orders > 3.5).all(), orders


def test_the_held_input_keeps_its_impulse():
    rng = np.random.default_rng(1)
    time, inputs = jittered(200, 0.01, 0.3), rng.normal(size=(200, 3))
    grid, _, held = resample(time, np.zeros((200, 1)), inputs, 0.01)
    end = grid[-1] + 0.01
    widths = np.diff(np.r_[time[time < end], end])
    expected = (inputs[time < end] * widths[:, None]).sum(axis=0)
    np.testing.assert_allclose(0.01 * held.sum(axis=0), expected, atol=1e-13)


def test_an_integrator_driven_by_the_resampled_input_is_exact_on_the_grid():
    rng = np.random.default_rng(2)
    time, inputs = jittered(100, 0.01, 0.3), rng.normal(size=(100, 1))
    state = np.r_[0.0, np.cumsum(inputs[:-1, 0] * np.diff(time))]
    grid, _, held = resample(time, state[:, None], inputs, 0.01)
    exact = np.interp(grid, time, state)
    np.testing.assert_allclose(np.r_[0.0, 0.01 * np.cumsum(held[:-1, 0])], exact, atol=1e-14)


def test_an_input_that_comes_a_microsecond_late_is_not_delayed_by_a_step():
    time = np.arange(10) * 0.01 + np.r_[0.0, np.full(9, 1e-6)]
    inputs = np.arange(10.0)[:, None]
    held = mean_of_held(time, inputs, 0.01 * np.arange(11))
    np.testing.assert_allclose(held, inputs, atol=1e-3)


def test_a_uniform_run_is_returned_as_it_is():
    time = 0.01 * np.arange(50)
    observation, inputs = np.random.default_rng(0).normal(size=(50, 2)), np.ones((50, 1))
    result = to_grid(time, observation, inputs, SamplingRule("refuse"), 0.01, "run")
    assert result[0] is time and result[1] is observation and result[2] is inputs


def test_a_run_without_inputs_is_resampled():
    time = jittered(50, 0.01, 0.1)
    assert resample(time, time[:, None], np.empty((50, 0)), 0.01)[2].shape[1] == 0


def test_a_jittered_run_is_refused_when_the_rule_says_so():
    time = jittered(50, 0.01, 0.1)
    with pytest.raises(ValueError, match=r"run: sampling intervals from .* expected 0.01 s within 0.1 %"):
        to_grid(time, time[:, None], time[:, None], SamplingRule("refuse"), 0.01, "run")


def test_a_very_irregular_run_is_refused_with_its_numbers_unless_told():
    time = np.cumsum(np.random.default_rng(0).uniform(0.0075, 0.1, 300))
    with pytest.raises(ValueError, match=r"from 0\.007\d* to 0\.0\d+ s.*the limit is 30 %"):
        to_grid(time, time[:, None], time[:, None], SamplingRule(), 0.05, "run")
    grid, motion, _ = to_grid(time, time[:, None], time[:, None], SamplingRule(irregularity=2.0), 0.05, "run")
    np.testing.assert_allclose(motion[:, 0], grid)


@pytest.mark.parametrize("wrong", [{"sampling": "guess"}, {"missing": "ignore"}, {"timestep": 0.0},
                                   {"irregularity": -1.0}, {"minimum_length": 1}])
def test_a_wrong_rule_is_refused(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        SamplingRule(**wrong)
