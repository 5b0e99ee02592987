"""A mean's interval holds the true mean as often as it says."""

import math

import numpy as np
import pytest

from ssmr_torch.evaluation import bootstrap
from ssmr_torch.evaluation.bootstrap import difference_intervals, mean_interval, rank


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


def test_a_paired_difference_ignores_what_is_hard_for_both_and_counts_blocks_not_starts():
    """Errors of 100 with a spread of 30 that both share, apart by N(0.1, 0.05) per block of 20 equal starts: the
    interval has the width of 40 values, 2 · 1.96 · 0.05 / √40, not that of 800.
    """
    rng = np.random.default_rng(3)
    blocks = np.repeat(np.arange(40), 20)
    hard = rng.normal(100.0, 30.0, 800)
    apart = rng.normal(0.1, 0.05, 40)[blocks]
    own, other = difference_intervals(np.stack([hard, hard + apart]), blocks, 0)
    assert own == (0.0, 0.0, 0.0) and other.mean == pytest.approx(apart.mean())
    assert other.high - other.low == pytest.approx(2 * 1.96 * 0.05 / np.sqrt(40), rel=0.25)
    assert rank(np.stack([hard, hard + apart]), blocks).tied.tolist() == [False, False]


def test_the_interval_of_a_difference_that_is_none_holds_zero_nineteen_times_in_twenty():
    rng, held = np.random.default_rng(4), 0
    for _ in range(200):
        errors = np.stack([rng.normal(size=30), rng.normal(size=30)])
        interval = difference_intervals(errors, np.arange(30), 0, resamples=500)[1]
        held += interval.low <= 0 <= interval.high
    assert 0.88 <= held / 200 <= 0.99


@pytest.mark.parametrize("errors, blocks", [
    (np.ones((1, 40)), np.arange(40)), (np.ones((2, 40)), np.arange(40) // 8), (np.full((2, 9), np.inf), np.arange(9))])
def test_there_is_no_best_of_one_model_of_five_blocks_or_of_models_that_all_diverged(errors, blocks):
    assert rank(errors, blocks).best is None and not rank(errors, blocks).tied.any()


def test_differences_of_arrays_that_do_not_fit_or_from_a_diverged_reference_are_refused():
    with pytest.raises(ValueError, match=r"errors of shape \(2, 9\), 0 of them NaN, with blocks of shape \(8,\)"):
        difference_intervals(np.ones((2, 9)), np.arange(8), 0)
    with pytest.raises(ValueError, match="the reference, model 1, diverged from 9 starts"):
        difference_intervals(np.stack([np.ones(9), np.full(9, np.inf)]), np.arange(9), 1)
