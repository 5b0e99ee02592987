"""Pauses of either end in real time: what the robot gets meanwhile, and how soon the run goes on."""

import numpy as np
import pytest
from wire.one_clock import SAFE, SPAN, T, run

TIMEOUT = 0.2


def pauses(count, seed, apart=0.4):
    """(start, end) s: 5 ms to 3 s each, in order, with the end they stop."""
    rng = np.random.default_rng(seed)
    lengths = np.exp(rng.uniform(np.log(5e-3), np.log(3.0), count))
    starts = 1.0 + np.cumsum(lengths + rng.uniform(0.5 * apart, apart, count)) - lengths
    return list(zip(starts, starts + lengths, rng.integers(0, 2, count)))


def of_end(planned, which):
    return [(start, end) for start, end, whose in planned if whose == which]


def ages(steps):
    """s from the measurement to the step, for every step that is neither safe nor blind."""
    return np.array([when - u[1] * SPAN for when, u in steps if u != SAFE and u[0] == 0.6])


def recoveries(steps, ends):
    """Periods from the end of each pause to the next step with a command for the newest observation, which the plant
    gives one period before.
    """
    fresh = np.array([when for when, u in steps if u != SAFE and u[0] == 0.6 and when - u[1] * SPAN < 2 * T])
    return (fresh[np.minimum(np.searchsorted(fresh, ends), len(fresh) - 1)] - ends) / T


def assert_kept(planned, plant, robot, end, link):
    ends = np.array([end for _, end, _ in planned])
    recovered = recoveries(plant.steps, ends)
    assert recovered.min() >= 0 and recovered.max() <= 3.0, recovered.max()
    assert ages(plant.steps).max() <= TIMEOUT + 3 * T
    inputs = np.array([u for _, u in plant.steps])
    assert (inputs >= [0.1, 0.0]).all() and (inputs <= 1.0).all()
    assert end.finished == 1 and link.hellos == 1 and plant.resets == 1, "the same run goes on"
    long_ones = sum(stop - start > TIMEOUT + 2 * T for start, stop, _ in planned)
    assert robot.counts["lost_controllers"] >= long_ones
    assert robot.counts["overruns"] >= sum(stop - start > 2 * T for start, stop in of_end(planned, 0))
    assert end.counts["resumed"] == end.counts["lost_robots"] >= sum(
        stop - start > 0.5 + 2 * T for start, stop in of_end(planned, 0))


@pytest.mark.parametrize("count", [40, pytest.param(300, marks=pytest.mark.slow)])
def test_after_pauses_of_either_end_the_same_run_goes_on_within_three_periods(count):
    planned = pauses(count, seed=count)
    told = run(planned[-1][1] + 1.0, robot_pauses=of_end(planned, 0), controller_pauses=of_end(planned, 1),
               timeout=TIMEOUT)
    assert_kept(planned, *told)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_lost_repeated_and_reordered_messages_leave_the_run_the_same_and_no_input_old(seed):
    plant, robot, end, link = run(20.0, loss=0.1, twice=0.1, reordered=0.1, seed=seed, timeout=TIMEOUT)
    assert ages(plant.steps).max() <= TIMEOUT + 3 * T and end.finished == 1
    assert plant.resets == 1 and not end.counts["lost_robots"] and not end.counts["renumbered"]
    answered = np.mean([u != SAFE and u[0] == 0.6 and when - u[1] * SPAN < 2 * T for when, u in plant.steps])
    assert answered > 0.6  # both ways have to arrive in time: 0.9 × 0.9 × 0.9 × 0.9
    assert robot.counts["repeated"] > 50 and end.counts["repeated"] > 50 and end.counts["reordered"] > 50


def test_pauses_of_both_ends_at_once_and_a_bad_network_end_no_run():
    rng = np.random.default_rng(5)
    starts = np.cumsum(rng.uniform(0.3, 3.0, 60))
    both = [(start, start + length) for start, length in zip(starts, rng.uniform(0.005, 0.25, 60))]
    moved = [(start + shift, end + shift) for (start, end), shift in zip(both, rng.uniform(-0.1, 0.0, 60))]
    plant, robot, end, link = run(starts[-1] + 3.0, robot_pauses=both, controller_pauses=moved, loss=0.05, twice=0.05,
                                  reordered=0.02, timeout=TIMEOUT)
    assert end.finished == 1 and plant.resets == 1 and ages(plant.steps).max() <= TIMEOUT + 3 * T
