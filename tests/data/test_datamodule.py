"""The data module: held-out runs, the data for each fit, and their distribution over processes."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from ssmr_torch.data.data_settings import DataSettings
from ssmr_torch.data.datamodule import TrajectoryDataModule
from ssmr_torch.data.windows import RolloutBatch, Segment
from ssmr_torch.trajectory import Trajectory, TrajectoryDataset

TIMESTEP = 0.01


def run(samples, offset=0.0, kind="controlled", split="train"):
    """Observation offset + k at sample k, input minus that."""
    count = offset + np.arange(samples)[:, None]
    return Trajectory(TIMESTEP * np.arange(samples), count + np.arange(3) / 10, np.tile(-count, 2), kind, split)


def dataset(*more):
    runs = [run(100, kind="decay"), run(200, 1000.0), run(155, 2000.0), run(120, 3000.0, split="test"), *more]
    return TrajectoryDataset(runs, np.zeros(3), ("x", "y", "z"), ("u", "v"))


def module(data=None, **options):
    settings = DataSettings(validation_share=0.1, transient=0.0, validation_horizon=0.1, rollout_horizon=0.08)
    return TrajectoryDataModule(data or dataset(), settings, **options)


CLOSED_FORM = SimpleNamespace(model=SimpleNamespace(delays=2, timestep=TIMESTEP),
                              procedure=SimpleNamespace(before=5, after=3))
GRADIENT = SimpleNamespace(model=SimpleNamespace(delays=2, timestep=TIMESTEP))


@pytest.mark.parametrize("share", [0.1, 0.25])
def test_the_tail_of_every_controlled_run_is_held_out_and_nothing_else(share):
    data = module(validation_share=share)
    lengths = [round(200 * (1 - share)), round(155 * (1 - share))]
    assert [t.length for t in data.training] == [100, *lengths]
    assert [t.length for t in data.validation] == [200 - lengths[0], 155 - lengths[1]]
    assert [t.observation[0, 0] for t in data.validation] == [1000 + lengths[0], 2000 + lengths[1]]
    assert [t.split for t in data.test] == ["test"]


def test_runs_marked_for_validation_replace_the_held_out_tails():
    data = module(dataset(run(60, 5000.0, split="validation")))
    assert [t.length for t in data.training] == [100, 200, 155] and [t.length for t in data.validation] == [60]


def test_no_validation_and_no_test_runs_give_no_batches():
    data = module(TrajectoryDataset([run(100)], np.zeros(3), "xyz", "uv"), validation_share=0).prepare(CLOSED_FORM)
    assert data.val_dataloader() == [] and data.test_dataloader() == []


def test_a_closed_form_fit_is_served_segments_of_the_training_runs_in_their_order():
    batches = list(module(rows=64, transient=0.2).prepare(CLOSED_FORM).train_dataloader())
    assert all(isinstance(batch, Segment) for batch in batches)
    assert [(batch.trajectory, batch.index) for batch in batches] == [
        (0, 0), (0, 1), (1, 0), (1, 1), (1, 2), (2, 0), (2, 1), (2, 2)]
    core = torch.cat([batch.core_rows(batch.observation[:, 0], 0) for batch in batches])
    expected = np.concatenate([np.arange(20, 100), 1000 + np.arange(180), 2000 + np.arange(140)])
    np.testing.assert_array_equal(core, expected)


def test_a_gradient_fit_is_served_batches_of_rollouts_with_their_windows():
    batches = list(module(batch_size=16, stride=5).prepare(GRADIENT).train_dataloader())
    assert all(isinstance(batch, RolloutBatch) for batch in batches)
    for batch in batches:
        assert batch.window.shape == (16, 3, 3) and batch.window_inputs.shape == (16, 2, 2)
        assert batch.inputs.shape == (16, 8, 2) and batch.outputs.shape == (16, 8, 3)
        first = batch.window[:, 0, 0]
        torch.testing.assert_close(batch.outputs[:, :, 0], first[:, None] + torch.arange(3.0, 11.0).double())
        torch.testing.assert_close(batch.inputs[:, :, 1], -first[:, None] - torch.arange(2.0, 10.0).double())


def test_less_than_one_batch_of_rollouts_is_served_whole():
    data = module(TrajectoryDataset([run(40)], np.zeros(3), "xyz", "uv"), validation_share=0, batch_size=64, stride=1)
    (batch,) = data.prepare(GRADIENT).train_dataloader()
    assert len(batch.window) == 40 - 2 - 8


def scored(options, fit=GRADIENT, part="val"):
    (found,) = getattr(module(**options).prepare(fit), f"{part}_dataloader")()
    return found


def test_scores_come_from_the_same_runs_horizon_starts_and_seed_whatever_is_fitted():
    first, again, other = (scored({"starts": 7, "seed": seed}, fit)
                           for seed, fit in ((1, CLOSED_FORM), (1, GRADIENT), (2, GRADIENT)))
    assert (first.horizon, first.starts) == (again.horizon, again.starts) == (0.1, 7)
    assert first.seed == again.seed != other.seed
    for one, two in zip(first.runs, again.runs, strict=True):
        np.testing.assert_array_equal(one.observation, two.observation)
    assert all(run.observation[0, 0] >= 1180 for run in first.runs)
    (test,) = scored({}, part="test").runs
    assert test.length == 120 and test.split == "test"


def shares(data, processes):
    for rank in range(processes):
        data.trainer = SimpleNamespace(world_size=processes, global_rank=rank)
        yield list(data.train_dataloader())


@pytest.mark.parametrize("processes", [1, 2, 3, 7])
def test_each_segment_is_in_exactly_one_process_and_all_take_equally_many_steps(processes):
    data = module(rows=64).prepare(CLOSED_FORM)
    parts = list(shares(data, processes))
    assert len({len(part) for part in parts}) == 1
    core = torch.cat([segment.core_rows(segment.observation[:, 0], 0) for part in parts for segment in part])
    expected = np.concatenate([np.arange(100), 1000 + np.arange(180), 2000 + np.arange(140)])
    np.testing.assert_array_equal(np.sort(core), expected)


@pytest.mark.parametrize(("batch_size", "stride"), [(16, 3), (32, 1), (1000, 2), (5, 7)])
def test_no_rollout_is_in_two_processes_and_all_take_equally_many_steps(batch_size, stride):
    check_rollout_shares(module(batch_size=batch_size, stride=stride))


def test_one_rollout_too_many_for_equal_shares_is_left_out():
    """94 rollouts for three processes: with 32, 31 and 31, batches of 16 would be 2, 1 and 1."""
    runs = TrajectoryDataset([run(94 + 2 + 8)], np.zeros(3), "xyz", "uv")
    check_rollout_shares(module(runs, validation_share=0, batch_size=16, stride=1))


def check_rollout_shares(data):
    parts = list(shares(data.prepare(GRADIENT), 3))
    assert len({len(part) for part in parts}) == 1 and len(parts[0]) > 0
    starts = torch.cat([batch.window[:, 0, 0] for part in parts for batch in part])
    assert len(torch.unique(starts)) == len(starts)


def test_more_processes_than_segments_are_refused_with_the_numbers():
    with pytest.raises(ValueError, match="3 batches of data for 4 processes; use fewer processes, or a smaller `rows`"):
        next(shares(module(rows=10**6).prepare(CLOSED_FORM), 4))


@pytest.mark.parametrize(("options", "message"), [
    ({"validation_share": 1.0}, r"validation_share is 1\.0; expected"),
    ({"validation_share": -0.1}, "validation_share is -0.1"),
    ({"overdrive": 0.9}, r"overdrive is 0\.9; expected"),
    ({"overspeed": 1.5}, r"overspeed is 1\.5; expected"),
    ({"transient": -1.0}, "transient is -1.0 s"),
    ({"rollout_horizon": 0.0}, "rollout_horizon is 0.0 s"),
    ({"validation_horizon": -2.0}, "validation_horizon is -2.0 s")])
def test_options_without_meaning_are_refused_with_the_numbers(options, message):
    with pytest.raises(ValueError, match=message):
        module(**options)


def test_a_held_out_tail_too_short_to_score_is_refused_before_the_fit():
    data = module(TrajectoryDataset([run(100)], np.zeros(3), "xyz", "uv"), validation_horizon=0.5)
    with pytest.raises(ValueError, match="the longest of 1 trajectories has 10 samples; a start needs 2 before and 50 "
                                         "after it, 53 in all; take shorter horizons"):
        data.prepare(CLOSED_FORM)


def test_the_training_can_be_limited_to_some_decays_and_some_seconds_of_controlled_runs():
    data = module(validation_share=0.0, decays=0, controlled_duration=2.5)
    assert [(run.kind, run.length) for run in data.training] == [("controlled", 200), ("controlled", 50)]
    assert [run.kind for run in module(validation_share=0.0, decays=1).training] == ["decay", *["controlled"] * 2]
    with pytest.raises(ValueError, match="decays is -1; expected"):
        module(decays=-1)


def test_noise_is_on_training_runs_and_on_the_windows_of_validation_but_not_on_what_they_are_compared_with():
    clean, noisy = (module(noise_std=level).prepare(GRADIENT) for level in (0.0, 0.1))
    spread = noisy.training[1].observation - clean.training[1].observation
    assert 0.09 < spread.std() < 0.11
    (before,), (after,) = (data.val_dataloader() for data in (clean, noisy))
    for one, other in zip(before.runs, after.runs, strict=True):
        np.testing.assert_array_equal(one.observation, other.observation)
        np.testing.assert_array_equal(one.input, other.input)
    noise = np.concatenate([seen.observation - run.observation for seen, run in zip(after.seen, after.runs)])
    assert 0.08 < noise.std() < 0.12
    assert all(seen is run for seen, run in zip(before.seen, before.runs))
    (again,) = noisy.val_dataloader()
    np.testing.assert_array_equal(again.seen[0].observation, after.seen[0].observation)
    with pytest.raises(ValueError, match="noise_std is -1"):
        module(noise_std=-1)


def test_without_a_test_score_the_test_runs_are_not_read():
    assert module(score_test=False).test == () and module().test


def test_a_fit_with_its_own_horizon_and_starts_is_served_these_drawn_anew_each_epoch():
    fit = SimpleNamespace(model=GRADIENT.model, horizon=0.2, starts=7)
    data = module().prepare(fit)
    (first,), (second,) = data.train_dataloader(), data.train_dataloader()
    assert first.inputs.shape[:2] == (7, 20) and not torch.equal(first.window, second.window)


def test_static_runs_are_served_to_the_procedure_that_asks_for_them_and_to_no_other():
    still = run(30, kind="static")
    for asks in (True, False):
        procedure = SimpleNamespace(before=1, after=1, takes_static=asks)
        data = module(dataset(still)).prepare(SimpleNamespace(model=GRADIENT.model, procedure=procedure))
        kinds = {segment.kind for segment in data.train_dataloader()}
        assert ("static" in kinds) == asks
