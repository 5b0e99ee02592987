"""Excitations are seeded, bounded and shaped as they say."""

import numpy as np
import pytest

from ssmr_torch.collection.excitation import (
    Chirp,
    Dithered,
    Ramp,
    RandomOnOffRamp,
    RandomSteps,
    Release,
    SetPoints,
    SmoothRandom,
    latin_hypercube_ramps,
    latin_hypercube_set_points,
    mpc_like,
    resting_input,
)

BOUNDS = np.array([[0.0, 0.0, 0.5], [1.5, 1.0, 4.0]])
SIGNED = np.array([[-1.0, -2.0, -3.0, 0.0], [1.0, 6.0, -1.0, 2.0]])
TIMESTEP = 0.01
EXCITATIONS = [Ramp((0.2, 0.0, 1.0)), RandomOnOffRamp(), RandomOnOffRamp(share=0.4, probability=0.9),
               SmoothRandom(), SmoothRandom(0.25, share=0.6, lowest=0.0), RandomSteps(0.3),
               Chirp(), Chirp(0.5, 10.0, share=0.7),
               SetPoints(((0.0, 0.5, 1.0), (1.0, 0.0, 0.2)), hold=0.7), *latin_hypercube_ramps(2, 3, seed=0),
               latin_hypercube_set_points(5, 3, seed=0, hold=0.5), Dithered(SmoothRandom()),
              Dithered(RandomSteps(0.3), share=0.4, hold=0.03), mpc_like(Chirp())]


def draw(excitation, samples=400, seed=0, bounds=BOUNDS):
    return excitation(np.random.default_rng(seed), samples, TIMESTEP, bounds)


def fractions(excitation, **changes):
    return (draw(excitation, **changes) - BOUNDS[0]) / (BOUNDS[1] - BOUNDS[0])


@pytest.mark.parametrize("excitation", EXCITATIONS, ids=repr)
@pytest.mark.parametrize("samples", [1, 2, 400])
def test_every_sample_lies_inside_the_bounds(excitation, samples):
    inputs = draw(excitation, samples)
    assert inputs.shape == (samples, 3) and inputs.dtype == np.float64
    assert (inputs >= BOUNDS[0]).all() and (inputs <= BOUNDS[1]).all()


@pytest.mark.parametrize("excitation", EXCITATIONS, ids=repr)
def test_the_same_seed_gives_the_same_signal(excitation):
    np.testing.assert_array_equal(draw(excitation, seed=5), draw(excitation, seed=5))


@pytest.mark.parametrize("excitation", [RandomOnOffRamp(), SmoothRandom(), RandomSteps(), Chirp()], ids=repr)
def test_another_seed_gives_another_signal(excitation):
    assert not np.array_equal(draw(excitation, seed=5), draw(excitation, seed=6))


@pytest.mark.parametrize("excitation", [RandomOnOffRamp(share=0.5), SmoothRandom(share=0.5),
                                        RandomSteps(share=0.5), Chirp(share=0.5),
                                        *latin_hypercube_ramps(5, 3, seed=1, share=0.5),
                                        latin_hypercube_set_points(20, 3, seed=1, share=0.5)], ids=repr)
def test_a_share_of_the_range_is_not_exceeded(excitation):
    assert fractions(excitation, samples=2000).max() <= 0.5 + 1e-12


def test_a_ramp_rises_for_its_time_holds_and_lets_go_at_once():
    signal = fractions(Ramp((0.2, 0.0, 1.0), ramp=0.6, hold=1.0))
    np.testing.assert_allclose(signal[30], [0.1, 0.0, 0.5])
    np.testing.assert_allclose(signal[60:100], np.tile([0.2, 0.0, 1.0], (40, 1)))
    np.testing.assert_array_equal(draw(Ramp((0.2, 0.0, 1.0)))[100:], np.tile(BOUNDS[0], (300, 1)))


def test_only_ramps_let_go():
    assert isinstance(RandomOnOffRamp(), Release) and isinstance(Ramp((1.0,)), Release)
    assert not isinstance(SmoothRandom(), Release) and not isinstance(Chirp(), Release)


def test_each_cable_is_on_as_often_as_asked_and_uniform_when_it_is():
    levels = np.array([fractions(RandomOnOffRamp(), samples=100, seed=seed)[-1] for seed in range(3000)])
    assert (levels > 0).any(axis=1).all()
    # One of the 2³ combinations, all off, is drawn again.
    np.testing.assert_allclose((levels > 0).mean(axis=0), 0.5 / (1 - 0.5 ** 3), atol=0.03)
    for quantile in (0.25, 0.5, 0.75):
        np.testing.assert_allclose(np.quantile(levels[levels > 0], quantile), quantile, atol=0.03)


def test_a_latin_hypercube_puts_one_level_of_each_input_in_every_stratum():
    ramps = [ramp.levels for ramp in latin_hypercube_ramps(40, 4, seed=3)]
    points = latin_hypercube_set_points(40, 4, seed=3, share=0.5).levels
    for levels, share in ((ramps, 1.0), (points, 0.5)):
        for column in np.array(levels).T:
            np.testing.assert_array_equal(np.sort((40 * column / share).astype(int)), np.arange(40))


def test_a_smooth_signal_is_smooth_and_slack_part_of_the_time():
    signal = fractions(SmoothRandom(0.4), samples=20000)
    assert np.abs(np.diff(signal, axis=0)).max() < 0.1
    slack = (signal == 0).mean()
    assert 0.15 < slack < 0.4


def test_shorter_knot_intervals_give_faster_signals():
    speeds = [np.abs(np.diff(draw(SmoothRandom(interval), samples=5000), axis=0)).mean()
              for interval in (1.0, 0.4, 0.25)]
    assert speeds[0] < speeds[1] < speeds[2]


def test_random_steps_change_only_after_their_hold():
    changes = np.flatnonzero(np.abs(np.diff(draw(RandomSteps(0.3)), axis=0)).max(axis=1)) + 1
    np.testing.assert_array_equal(changes, np.arange(30, 400, 30))


def test_set_points_follow_each_other_and_the_last_stays():
    signal = fractions(SetPoints(((0.0, 0.5, 1.0), (1.0, 0.0, 0.2)), hold=0.7), samples=300)
    np.testing.assert_allclose(signal[:70], np.tile([0.0, 0.5, 1.0], (70, 1)))
    np.testing.assert_allclose(signal[70:], np.tile([1.0, 0.0, 0.2], (230, 1)))


def test_set_points_of_a_latin_hypercube_are_each_held_until_the_robot_rests():
    points = latin_hypercube_set_points(6, 3, seed=2, hold=0.5)
    assert points.duration == pytest.approx(3.0)
    signal = fractions(points, samples=300)
    np.testing.assert_allclose(signal, np.repeat(points.levels, 50, axis=0), atol=1e-12)
    assert not np.allclose(points.levels, latin_hypercube_set_points(6, 3, seed=4, hold=0.5).levels)


def test_a_chirp_sweeps_from_slow_to_fast():
    signal = draw(Chirp(0.2, 5.0), samples=2000)[:, 0]
    crossings = np.flatnonzero(np.diff(np.sign(signal - signal.mean())))
    gaps = TIMESTEP * np.diff(crossings)
    assert gaps[-1] == pytest.approx(0.5 / 5.0, rel=0.2)
    assert gaps[0] > 5 * gaps[-1]


@pytest.mark.parametrize("build", [
    lambda: Ramp((0.2, 1.2)), lambda: Ramp((-0.1,)), lambda: Ramp((np.nan,)),
    lambda: Ramp((1.0,), ramp=2.0, hold=1.0),
    lambda: RandomOnOffRamp(share=1.1), lambda: RandomOnOffRamp(probability=0.0), lambda: SmoothRandom(0.0),
    lambda: SmoothRandom(lowest=1.0), lambda: RandomSteps(hold=-1.0), lambda: Chirp(2.0, 1.0),
    lambda: SetPoints(((0.0, 2.0),)), lambda: latin_hypercube_set_points(4, 2, seed=0, share=1.5),
    lambda: latin_hypercube_set_points(0, 2, seed=0), lambda: Ramp((0.4,), share=0.3),
    lambda: Dithered(SmoothRandom(), share=0.0), lambda: Dithered(SmoothRandom(), hold=0.0), lambda: Dithered(0.5),
    lambda: latin_hypercube_ramps(-1, 2, seed=0), lambda: latin_hypercube_ramps(4, 2, seed=0, share=0.0)])
def test_impossible_settings_are_refused_when_built(build):
    with pytest.raises(ValueError, match="expected"):
        build()


@pytest.mark.parametrize("excitation", [Ramp((0.2, 1.0)), SetPoints(((0.2, 1.0),)), Chirp(1.0, 60.0)],
                         ids=repr)
def test_a_signal_that_does_not_fit_the_robot_is_refused(excitation):
    with pytest.raises(ValueError):
        draw(excitation)


def test_signed_inputs_rest_at_zero_and_are_released_to_it_exactly():
    np.testing.assert_array_equal(resting_input(SIGNED), [0.0, 0.0, -1.0, 0.0])
    for excitation in (RandomOnOffRamp(0.7), *latin_hypercube_ramps(3, 4, seed=0, share=0.3),
                       Ramp((0.0, 0.1, 1.0, 0.3))):
        signal = draw(excitation, bounds=SIGNED)
        np.testing.assert_array_equal(signal[100:], np.tile(resting_input(SIGNED), (300, 1)))
        np.testing.assert_allclose(signal[0], resting_input(SIGNED), atol=1e-12)


def test_an_input_that_is_off_stays_at_rest():
    ramps = np.array([draw(RandomOnOffRamp(0.7), seed=seed, bounds=SIGNED)[99] for seed in range(200)])
    off = (ramps == resting_input(SIGNED)).mean(axis=0)
    np.testing.assert_allclose(off, 1 - 0.5 / (1 - 0.5 ** 4), atol=0.1)


@pytest.mark.parametrize("excitation", [SmoothRandom(share=0.5), RandomSteps(0.1, share=0.5), Chirp(share=0.5),
                                        latin_hypercube_set_points(60, 4, seed=1, share=0.5, hold=0.1)], ids=repr)
def test_a_share_of_a_signed_range_lies_on_both_sides_of_its_rest(excitation):
    signal = draw(excitation, samples=4000, bounds=SIGNED)
    np.testing.assert_allclose(signal.min(axis=0), [-0.5, -1.0, -2.0, 0.0], atol=0.06)
    np.testing.assert_allclose(signal.max(axis=0), [0.5, 3.0, -1.0, 1.0], atol=0.06)


def test_ramps_pull_signed_inputs_in_both_directions_evenly():
    levels = [draw(ramp, bounds=SIGNED)[99] for ramp in latin_hypercube_ramps(40, 4, seed=0, share=0.5)]
    assert (np.array(levels)[:, 0] > 0).sum() == 20 and (np.array(levels)[:, 1] > 0).sum() == 30


def test_a_smooth_signed_signal_does_not_dwell_at_one_end():
    signal = draw(SmoothRandom(), samples=20000, bounds=SIGNED)[:, 0]
    assert abs(signal.mean()) < 0.05 and (signal == -1.0).mean() < 0.1


def test_dither_is_white_of_its_share_on_the_same_signal_and_changes_after_its_hold():
    bounds, smooth = np.array([[0.0, -2.0], [1e3, 6.0]]), Chirp(share=0.5)
    steps = (draw(Dithered(smooth), samples=40000, bounds=bounds) - draw(smooth, samples=40000, bounds=bounds))
    steps = (steps / (bounds[1] - bounds[0]))[5000:]
    clear = (draw(smooth, samples=40000, bounds=bounds) > 100)[5000:, 0]  # of the lower bound
    np.testing.assert_allclose(steps[::2][clear[::2]], steps[1::2][clear[::2]], atol=1e-12)
    drawn = steps[::2][clear[::2]]
    np.testing.assert_allclose(drawn.std(axis=0), 0.025, rtol=0.03)
    assert abs(np.corrcoef(drawn[1:, 1], drawn[:-1, 1])[0, 1]) < 0.03
    assert abs(np.corrcoef(drawn.T)[0, 1]) < 0.03


def test_inputs_like_a_controllers_are_twice_as_strongly_dithered():
    assert mpc_like(SmoothRandom()) == Dithered(SmoothRandom(), share=0.05, hold=0.02)


def test_a_dithered_run_ends_where_its_excitation_does():
    assert Dithered(SetPoints(((0.1,), (0.2,)), hold=2.0)).duration == 4.0
    assert not hasattr(Dithered(SmoothRandom()), "duration")
