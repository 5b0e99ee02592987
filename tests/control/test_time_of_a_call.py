"""Claims about the time of calls: which sample each is, and how many were skipped before it."""

import numpy as np
import pytest

from ssmr_torch.control.sampling import Interval, SampleClock, seconds


def placed(*times, longest=5):
    """The intervals of calls at these times, in timesteps, and what was counted."""
    clock = SampleClock(0.01, longest)
    return [clock.advance(0.01 * time) for time in times], clock.counts


def test_calls_on_the_grid_skip_nothing_and_count_nothing():
    intervals, counts = placed(*range(1000))
    assert set(intervals) == {Interval()} and not counts


def test_jitter_of_a_tenth_belongs_to_its_sample():
    jitter = 0.05 * np.random.default_rng(0).uniform(-1, 1, 300)
    intervals, counts = placed(*(np.arange(300) + jitter))
    assert set(intervals) == {Interval()} and not counts


@pytest.mark.parametrize("skipped", [1, 2, 5])
def test_skipped_samples_are_counted_one_by_one(skipped):
    intervals, counts = placed(0, 1, 2 + skipped, 3 + skipped)
    assert [interval.missed for interval in intervals] == [0, 0, skipped, 0] and counts == {"skipped": skipped}


def test_intervals_of_one_and_a_half_timesteps_are_one_and_two_in_turn():
    intervals, counts = placed(*(1.5 * np.arange(21)))
    assert sum(1 + interval.missed for interval in intervals[1:]) == 30
    assert counts == {"skipped": 10, "irregular": 10}


@pytest.mark.parametrize("again", [1.0, 1.3, 0.7])
def test_a_second_call_at_about_the_same_time_brings_nothing_new(again):
    intervals, counts = placed(0, 1, again, 2)
    assert [interval.new for interval in intervals] == [True, True, False, True]
    assert counts == {"repeated": 1} and not intervals[-1].missed


@pytest.mark.parametrize("there", [-3, 8, 1e9])
def test_a_jump_backwards_or_too_far_begins_anew_and_goes_on_from_there(there):
    intervals, counts = placed(0, 1, there, there + 1)
    assert [interval.anew for interval in intervals] == [False, False, True, False] and counts == {"restarted": 1}


@pytest.mark.parametrize("time", [np.nan, np.inf, -np.inf])
def test_a_time_that_is_not_finite_is_taken_for_the_next_sample(time):
    intervals, counts = placed(0, 1, time, 3, time, time, 7)
    assert [interval.missed for interval in intervals] == [0, 0, 0, 0, 0, 0, 1]
    assert counts == {"without time": 3, "skipped": 1}


def test_what_is_no_number_is_no_time():
    assert [seconds(2), seconds("0.5"), seconds(np.float32(1.0))] == [2.0, 0.5, 1.0]
    assert np.isnan([seconds(given) for given in (None, "noon", [1, 2], 10**400)]).all()
