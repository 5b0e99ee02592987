"""Metrics against values worked out by hand."""

import numpy as np
import pytest

from ssmr_torch.evaluation import metrics
from ssmr_torch.tasks.obstacles import Circle

TIME = 0.02 * np.arange(151)


def still(position):
    return np.tile(np.asarray(position, dtype=float), (len(TIME), 1))


def test_the_rollout_error_is_the_root_of_the_mean_squared_norm():
    predicted = np.array([[[3.0, 4.0], [0.0, 0.0]], [[1.0, 0.0], [0.0, 1.0]]])
    errors = metrics.rollout_rmse(predicted, np.zeros_like(predicted))
    np.testing.assert_allclose(errors, [np.sqrt(12.5), 1.0])


def test_padding_after_the_steps_of_a_rollout_does_not_count_even_when_infinite():
    predicted = np.array([[[2.0], [np.inf]], [[2.0], [4.0]]])
    errors = metrics.rollout_rmse(predicted, np.zeros_like(predicted), steps=np.array([1, 2]))
    np.testing.assert_allclose(errors, [2.0, np.sqrt(10.0)])


def test_steps_outside_the_rollout_are_refused():
    with pytest.raises(ValueError, match="values 1 to 2"):
        metrics.rollout_rmse(np.zeros((1, 2, 1)), np.zeros((1, 2, 1)), steps=np.array([3]))


def test_rollouts_of_different_shape_are_refused_instead_of_broadcast():
    with pytest.raises(ValueError, match=r"\(5, 2\) and \(1, 2\)"):
        metrics.rollout_rmse(np.zeros((5, 2)), np.zeros((1, 2)))


def test_the_ise_is_a_sum_of_squares_without_the_timestep_and_ignores_the_first_second():
    position = still([3e-3, 4e-3])
    expected = (len(TIME) - 50) * 25e-6
    assert metrics.integral_squared_error(TIME, position, still([0, 0])) == pytest.approx(expected, rel=1e-12)
    position[:50] = 1e3
    assert metrics.integral_squared_error(TIME, position, still([0, 0])) == pytest.approx(expected, rel=1e-12)


def test_the_first_second_is_counted_from_the_first_sample_whatever_its_time():
    position, reference = still([1e-3]), still([0])
    ise = metrics.integral_squared_error(TIME + 123.4, position, reference)
    assert ise == pytest.approx(101e-6, rel=1e-9)


def test_only_the_axes_of_the_task_count():
    position, reference = still([1e-3, 2e-3, 9.0]), still([0, 0, 0])
    assert metrics.tracking_rmse(TIME, position, reference, axes=(0, 1)) == pytest.approx(np.sqrt(5) * 1e-3)


def test_the_ise_is_the_squared_rmse_times_the_number_of_samples_and_the_maximum_bounds_both():
    rng = np.random.default_rng(0)
    position, reference = rng.normal(size=(2, len(TIME), 3))
    rmse = metrics.tracking_rmse(TIME, position, reference)
    assert metrics.integral_squared_error(TIME, position, reference) == pytest.approx(rmse ** 2 * 101)
    assert metrics.max_tracking_error(TIME, position, reference) == np.linalg.norm(
        position[50:] - reference[50:], axis=1).max()


def test_a_run_that_ends_before_the_first_second_or_broke_off_has_no_tracking_error():
    with pytest.raises(ValueError, match="0.98 s"):
        metrics.tracking_rmse(TIME[:50], still([0])[:50], still([0])[:50])
    broken = still([0.0])
    broken[70] = np.nan
    with pytest.raises(ValueError, match="sample 70"):
        metrics.tracking_rmse(TIME, broken, still([0.0]))


def test_the_relative_ise_of_the_reference_itself_is_zero_and_of_twice_its_mean_is_100_percent():
    assert metrics.relative_ise(2.0, [1.0, 3.0]) == 0.0
    assert metrics.relative_ise(4.0, [1.0, 3.0]) == pytest.approx(100.0)
    with pytest.raises(ValueError, match="positive mean"):
        metrics.relative_ise(1.0, [])


def test_a_sample_inside_two_obstacles_counts_once_and_touching_is_no_violation():
    depth = np.array([[-1.0, -2.0], [0.0, -1.0], [1e-3, 2e-3], [-1.0, 5e-4]])
    assert metrics.violations(depth) == (0.5, 2e-3)
    assert metrics.violations(depth[:, 0]) == (0.25, 1e-3)


def test_without_penetration_or_without_obstacles_nothing_is_violated():
    assert metrics.violations(-np.ones(4)) == (0.0, 0.0)
    assert metrics.violations(np.empty((4, 0))) == (0.0, 0.0)


def test_a_path_is_resampled_at_a_millisecond_through_its_samples_and_exactly_for_a_cubic():
    time = np.array([0.0, 0.01, 0.02, 0.045])
    times, path = metrics.resampled(time, (1.0 + time**3)[:, None])
    assert len(times) == 46 and np.diff(times).max() < 1.001e-3 and np.isin(time, times).all()
    np.testing.assert_allclose(path[:, 0], 1.0 + times**3, rtol=1e-12)


def test_an_obstacle_entered_between_two_samples_is_seen():
    time = 0.01 * np.arange(11)
    position = np.stack([0.5 * (time - 0.055), np.full(11, 2e-3)], axis=1)  # 5 mm a sample, 5.5 samples to the middle
    inside = metrics.obstacle_violations(time, position, [Circle((0.0, 0.0), 2.4e-3)])
    assert inside.maximum == pytest.approx(0.4e-3, rel=0.05)
    assert inside.ratio == pytest.approx(2 * np.sqrt(2.4**2 - 2.0**2) / 50, abs=0.02)
    at_samples = -Circle((0.0, 0.0), 2.4e-3).clearance(time, position)
    assert at_samples.max() < 0


def test_solve_times_are_summarized_by_their_order_statistics():
    seconds = 1e-3 * np.arange(101)[::-1]
    summary = metrics.solve_times(seconds, period=0.05)
    assert summary == pytest.approx((0.050, 0.099, 0.100, 50 / 101))


def test_a_missing_solve_time_is_refused():
    with pytest.raises(ValueError, match="finite"):
        metrics.solve_times(np.array([1e-3, np.nan]), period=0.02)
