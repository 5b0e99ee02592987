"""Rules for the number of reduced coordinates, on data whose dimension is known."""

import numpy as np
import pytest

from ssmr_torch.data.windows import delay_windows
from ssmr_torch.fitting.dimension import (
    captured_variance,
    choose_dimension,
    dimension_by_gap,
    dimension_by_variance,
    window_singular_values,
)
from ssmr_torch.trajectory import Trajectory, TrajectoryDataset

FREQUENCIES = (2.0, 5.0, 9.0, 14.0)


def modes(count, noise=1e-6, runs=6, samples=250, p=5):
    """Decays with `count` damped oscillations of amplitudes 1, 1/2, 1/4, … and a little noise: rank 2 count."""
    rng = np.random.default_rng(count)
    time = 0.01 * np.arange(samples)
    shapes = np.linalg.qr(rng.normal(size=(p, p))).Q[:count] / 2.0 ** np.arange(count)[:, None]
    for _ in range(runs):
        phases = rng.uniform(0, 2 * np.pi, count)
        waves = [np.exp(-0.5 * time) * np.cos(2 * np.pi * f * time + phase) for f, phase in zip(FREQUENCIES, phases)]
        yield Trajectory(time, np.stack(waves, axis=1) @ shapes + noise * rng.normal(size=(samples, p)),
                         np.zeros((samples, 1)), "decay")


@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_both_rules_find_two_coordinates_per_mode(count):
    runs = list(modes(count))
    values = window_singular_values(runs, delays=4)
    assert dimension_by_gap(values) == 2 * count
    assert dimension_by_variance(values, 1 - 1e-9) == 2 * count
    assert choose_dimension("gap", runs, 4) == choose_dimension("variance:0.999999999", runs, 4) == 2 * count


@pytest.mark.parametrize(("delays", "rows", "transient"), [(0, 1024, 0.0), (4, 1024, 0.0), (4, 3, 0.0), (9, 50, 0.13)])
def test_streamed_singular_values_are_those_of_all_windows_together(delays, rows, transient, tmp_path):
    runs = list(modes(3, noise=1e-3))
    first = round(transient / 0.01)
    windows = np.concatenate([delay_windows(run.observation[first:], delays).reshape(-1, 5 * (delays + 1))
                              for run in runs])
    expected = np.linalg.svd(windows, compute_uv=False)
    found = window_singular_values(runs, delays, transient=transient, rows=rows)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12 * expected[0])
    path = TrajectoryDataset(runs, np.zeros(5), "abcde", "u").save(tmp_path / "runs.h5")
    stored = window_singular_values(TrajectoryDataset.load(path), delays, transient=transient, rows=rows)
    np.testing.assert_array_equal(stored, found)


def test_the_captured_variance_is_the_share_of_the_squared_singular_values():
    np.testing.assert_allclose(captured_variance(np.array([3.0, 2.0, 1.0])), [9 / 14, 13 / 14, 1.0], rtol=1e-14)


@pytest.mark.parametrize(("share", "dimension"), [(0.5, 2), (0.9, 2), (0.93, 4), (0.999, 4), (0.9999999, 5)])
def test_the_variance_rule_gives_the_least_even_dimension_that_suffices_or_all_there_is(share, dimension):
    assert dimension_by_variance(np.array([3.0, 2.0, 1.0, 0.1, 0.01]), share) == dimension


def test_the_gap_is_searched_at_even_dimensions_up_to_the_given_largest():
    values = np.array([1.0, 1e-3, 1e-4, 1e-4, 1e-7, 1e-7])
    assert dimension_by_gap(values) == 4
    assert dimension_by_gap(values, largest=2) == 2


def test_rounding_noise_beyond_the_rank_does_not_count_as_a_gap():
    assert dimension_by_gap(np.array([1.0, 0.9, 0.1, 0.09, 1e-17, 1e-18, 1e-30, 0.0, 0.0])) == 4


def test_an_integer_dimension_is_used_without_reading_data():
    assert choose_dimension(7, (), 3) == 7


@pytest.mark.parametrize("rule", ["energy", "gap:3", "", 6.5, None])
def test_a_rule_that_does_not_exist_is_refused(rule):
    with pytest.raises(ValueError, match='expected an integer, "variance", "variance:0.99" or "gap"'):
        choose_dimension(rule, list(modes(1)), 1)


def test_too_few_data_and_invalid_shares_are_refused_with_the_numbers():
    with pytest.raises(ValueError, match="share is 1.5; expected a number between 0 and 1"):
        choose_dimension("variance:1.5", list(modes(1)), 1)
    with pytest.raises(ValueError, match="2 singular values; the rule 'gap' needs at least 3"):
        dimension_by_gap(np.array([1.0, 0.5]))
    with pytest.raises(ValueError, match="no trajectories were given"):
        window_singular_values([], 3)
