"""A fit never uses the samples that its fold holds out, and its rows are spread evenly over the runs."""

import numpy as np
import pytest

from ssmr_torch.selection.folds_and_starts import FOLDS, HORIZONS, STRONGER, Samples


def numbered(lengths=(700, 450, 120), decays=(160, 90), timestep=0.02, **more):
    """Runs whose first output is the number of the sample among all of them."""
    runs, first = [], 0
    for k, length in enumerate((*decays, *lengths)):
        number = first + np.arange(length, dtype=float)
        u = np.random.default_rng(k).normal(size=(length, 2)) if k >= len(decays) else np.zeros((length, 2))
        runs.append((np.stack([number, np.sin(number)], axis=1), u))
        first += length
    return Samples(runs[:len(decays)], runs[len(decays):], timestep, coordinates={"identity": None}, targets=[0, 1],
                   **more)


@pytest.mark.parametrize("timestep", [0.002, 0.02, 0.05, 0.2])
@pytest.mark.parametrize("ahead", [0, 1, 12])
def test_no_row_of_a_regression_uses_samples_that_its_fold_holds_out(timestep, ahead):
    samples = numbered((4000, 2000, 300), timestep=timestep)
    rows = samples.rows(ahead, decays=True)
    touching = samples.touching(rows, ahead)
    for fold in range(FOLDS):
        future = np.unique(samples.held_out(fold).follows[..., 0]).astype(int)
        seen = (rows[~touching[fold]][:, None] + np.arange(-samples.past, ahead + 1)).ravel()
        assert not np.isin(future, seen).any() and (samples.fold[future] == fold).all()


def test_a_rollout_to_fit_does_not_touch_the_fold():
    samples = numbered()
    for fold in range(FOLDS):
        starts = samples.training(fold)
        seen = np.concatenate([starts.window[..., 0].ravel(), starts.follows[..., 0].ravel()]).astype(int)
        assert len(starts) and not (samples.fold[seen] == fold).any()


def test_a_window_and_the_samples_after_it_belong_to_one_run():
    samples = numbered()
    for starts in (*(samples.held_out(fold) for fold in range(FOLDS)), samples.training(FOLDS), samples.hurried()):
        first = starts.window[:, 0, 0].astype(int)
        expected = first[:, None] + np.arange(starts.window.shape[1])
        np.testing.assert_array_equal(starts.window[..., 0], expected)
        assert (samples.owner[first] == samples.owner[starts.follows[:, -1, 0].astype(int)]).all()
        assert not samples.is_decay[first].any()
        np.testing.assert_array_equal(starts.past, samples.u[expected[:, :-1]])


def test_stressed_inputs_are_twice_as_fast_and_1_25_times_larger():
    samples = numbered()
    starts, horizon = samples.hurried(), samples.horizons[-1]
    begin = starts.window[:, -1, 0].astype(int)
    np.testing.assert_allclose(starts.inputs, STRONGER * samples.u[begin[:, None] + 2 * np.arange(horizon)], rtol=1e-15)


def test_horizons_are_shorter_where_no_run_is_long_enough_for_a_second():
    assert numbered().horizons == [round(seconds / 0.02) for seconds in HORIZONS]
    short = numbered((60, 50, 50), decays=(60,))
    assert short.horizons[-1] == 20 and short.horizons == sorted(set(short.horizons))
    assert all(len(short.held_out(fold)) for fold in range(3))


def test_at_most_the_given_number_of_rows_is_taken_evenly():
    samples = numbered((4000, 2000, 300), most=500)
    rows = samples.rows(1, decays=False)
    assert len(rows) == 500 and np.ptp(np.diff(rows[rows < 3900])) <= 1
    assert len(samples.whole().rows(1, decays=False)) == 6300 - 3 * (samples.past + 1)
