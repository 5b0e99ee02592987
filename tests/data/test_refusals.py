"""Recordings from which nothing can be learned are refused with a remedy."""

import numpy as np
import pytest

from ssmr_torch.data.refusals import check_learnable
from ssmr_torch.recording_faults.copies import shared_rows
from ssmr_torch.trajectory import Trajectory, TrajectoryDataset


def runs(samples=60, count=3, seed=0):
    rng = np.random.default_rng(seed)
    return [{"y": np.cumsum(rng.normal(size=(samples, 3)), axis=0), "u": rng.normal(size=(samples, 2)),
             "split": "test" if k == count - 1 else "train"} for k in range(count)]


def dataset(given):
    made = [Trajectory(0.01 * np.arange(len(run["y"])), run["y"], run["u"], "controlled", run["split"], f"r{k}")
            for k, run in enumerate(given)]
    return TrajectoryDataset(made, np.zeros(3), "xyz", ("a", "b"))


def changed(change, **options):
    given = runs(**options)
    for run in given:
        change(run)
    return dataset(given)


def test_good_recordings_are_not_refused():
    check_learnable(dataset(runs()), delays=58)


def still(run):
    run["u"] = np.full_like(run["u"], 0.5)


def lost(run):
    run["y"][:, 1] = 0.12


def copied(run):
    run["y"][:, 2] = run["y"][:, 0] + 3.0


def dependent(run):
    run["y"][:, 2] = 2.0 * run["y"][:, 0] - run["y"][:, 1]


@pytest.mark.parametrize(("change", "said"), [
    (still, "inputs that never change in the training data: a .0.5., b"), (lost, "outputs that never move.*: y; "
                                                                                 ".*leave"),
    (copied, "output z is a copy of x.*leave it out"), (dependent, "output z is a linear combination of x, y.*leave")])
def test_columns_without_information_are_named(change, said):
    with pytest.raises(ValueError, match=said):
        check_learnable(changed(change))


def test_a_window_longer_than_the_runs_is_refused_with_both_numbers():
    with pytest.raises(ValueError, match=r"63 samples of delay .* 65 samples, 5 more than .* \(60\); .* at most 58"):
        check_learnable(dataset(runs()), delays=63)


def test_two_samples_per_run_are_refused():
    with pytest.raises(ValueError, match="has 2 samples; at least 8"):
        check_learnable(dataset(runs(samples=2)))


def test_one_run_only_is_refused():
    with pytest.raises(ValueError, match="r0 is the only run.*record a second"):
        check_learnable(dataset([runs()[0]]))


def test_no_training_is_refused():
    with pytest.raises(ValueError, match="no run is for training"):
        check_learnable(dataset(runs()[2:]))


def test_runs_that_are_all_alike_are_refused():
    given = runs()
    with pytest.raises(ValueError, match="all 3 runs have the same contents"):
        check_learnable(dataset([given[0] | {"split": run["split"]} for run in given]))


def test_a_test_run_that_is_part_of_the_training_is_refused():
    given = runs()
    given[2] |= {"y": given[0]["y"][20:].copy(), "u": given[0]["u"][20:].copy()}
    with pytest.raises(ValueError, match="40 of the 40 samples of the test run 'r2' are those of the training run "
                                         "'r0'"):
        check_learnable(dataset(given))


def test_numbers_that_are_not_finite_never_become_a_run():
    given = runs()
    given[0]["y"][7, 1] = np.nan
    with pytest.raises(ValueError, match="not finite, the first one is sample 7"):
        dataset(given)


def test_stretches_at_rest_do_not_count_as_shared():
    rest = [Trajectory(0.01 * np.arange(200), np.vstack([np.zeros((100, 1)), np.cumsum(np.full((100, 1), step),
    axis=0)]),
                       np.zeros((200, 1))) for step in (0.1, 0.2)]
    assert shared_rows(rest[0], rest[1:])[0] == 0
    assert shared_rows(rest[0], [rest[0]])[0] >= 100
