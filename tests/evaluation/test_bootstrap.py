"""A mean's interval holds the true mean as often as it says."""

import math

import numpy as np
import pytest

from ssmr_torch.evaluation import bootstrap
from ssmr_torch.evaluation.bootstrap import mean_interval


def test_constant_samples_have_an_interval_of_no_width():
    assert mean_interval(np.full(7, 2.5)) == (2.5, 2.5, 2.5)


def test_of_normal_samples_95_percent_of_the_intervals_hold_the_mean():
    """40 normal values: the percentile interval covers 94 %; over 400 samples the count scatters by 1.2 %."""
    rng = np.random.default_rng(1)
    held = [low <= 3.0 <= high for _, low, high in
            (mean_interval(rng.normal(3.0, 2.0, 40), resamples=1000) for _ in range(400))]
    assert 0.91 <= np.mean(held) <= 0.975


def test_the_interval_of_many_normal_samples_is_that_of_the_central_limit():
    values = np.random.default_rng(2).normal(0.0, 1.0, 2000)
    mean, low, high = mean_interval(values)
    half = 1.96 * values.std() / math.sqrt(len(values))
    np.testing.assert_allclose([mean - low, high - mean], half, rtol=0.05)


def test_a_single_run_has_no_interval_and_a_failed_one_no_finite_mean():
    mean, low, high = mean_interval([4.0])
    assert mean == 4.0 and math.isnan(low) and math.isnan(high)
    mean, low, high = mean_interval([1.0, math.inf, 2.0])
    assert math.isinf(mean) and math.isnan(low) and math.isnan(high)


def test_the_seed_fixes_the_interval_and_blocks_do_not_change_the_number_of_means(monkeypatch):
    values = np.random.default_rng(3).exponential(size=9)
    assert mean_interval(values, seed=5) == mean_interval(values, seed=5) != mean_interval(values, seed=6)
    whole = mean_interval(values)
    monkeypatch.setattr(bootstrap, "VALUES_PER_BLOCK", 9 * 700)
    np.testing.assert_allclose(mean_interval(values), whole, rtol=0.03)


@pytest.mark.parametrize(("values", "confidence"), [([], 0.95), ([1.0, math.nan], 0.95), ([1.0, 2.0], 95.0),
                                                    ([[1.0, 2.0]], 0.95)])
def test_what_has_no_mean_or_no_confidence_is_refused(values, confidence):
    with pytest.raises(ValueError, match="expected"):
        mean_interval(values, confidence)
