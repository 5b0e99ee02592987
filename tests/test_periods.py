"""Periods that must be whole multiples of each other."""

import pytest

from ssmr_torch.periods import TOLERANCE, whole_multiple


def test_a_whole_multiple_is_found_within_the_tolerance_of_recordings():
    assert whole_multiple("period", 0.02, "the timestep", 0.01) == 2
    assert whole_multiple("period", 0.03, "the timestep", 0.01 * (1 + 0.9 * TOLERANCE)) == 3
    assert whole_multiple("period", 0.1 + 0.2, "the timestep", 0.3) == 1  # which floats do not divide exactly


def test_a_long_period_is_refused_if_the_next_multiple_is_equally_near():
    assert whole_multiple("period", 1.00005, "the timestep", 0.001) == 1000
    with pytest.raises(ValueError, match="1000.4 times .*; expected a whole multiple"):
        whole_multiple("period", 1.0004, "the timestep", 0.001)


@pytest.mark.parametrize(("period", "base"), [(0.015, 0.01), (0.005, 0.01), (0.0, 0.01), (-0.01, 0.01), (0.01, 0.0),
                                              (float("nan"), 0.01), (float("inf"), 0.01)])
def test_a_period_that_is_not_a_whole_multiple_is_refused_with_both_numbers_and_the_remedy(period, base):
    with pytest.raises(ValueError, match=f"period is {period:g} s, .* the timestep, {base:g} s.*fit at another"):
        whole_multiple("period", period, "the timestep", base, "fit at another")
