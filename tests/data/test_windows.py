"""Delay windows, the segments in which runs are streamed, and the starts of rollouts."""

import numpy as np
import pytest
import torch

from ssmr_torch.data.derivatives import central_difference, savitzky_golay
from ssmr_torch.data.windows import RolloutDataset, SegmentDataset, SegmentShare, delay_windows, stack_rollouts
from ssmr_torch.trajectory import Trajectory, TrajectoryDataset

TIMESTEP = 0.01
KINDS = ("decay", "controlled", "decay")


def run(samples, offset=0.0, kind="controlled", p=2, **labels):
    """Observation offset + k + column / 10 at sample k, input minus that: every value tells where it came from."""
    count = offset + np.arange(samples)[:, None]
    return Trajectory(TIMESTEP * np.arange(samples), count + np.arange(p) / 10, -count, kind, **labels)


@pytest.mark.parametrize("delays", [0, 1, 4])
@pytest.mark.parametrize("convert", [np.asarray, torch.from_numpy])
def test_a_window_holds_its_sample_and_the_ones_before_oldest_first(delays, convert):
    samples = np.random.default_rng(0).normal(size=(12, 3))
    windows = delay_windows(convert(samples), delays)
    assert windows.shape == (12 - delays, delays + 1, 3)
    for row, window in enumerate(windows):
        np.testing.assert_array_equal(window, samples[row:row + delays + 1])
        np.testing.assert_array_equal(window[-1], samples[row + delays])


def test_too_few_samples_for_a_window_are_refused_with_the_numbers():
    assert len(delay_windows(np.zeros((5, 1)), 4)) == 1
    for samples in (np.zeros((4, 1)), torch.zeros(4, 1)):
        with pytest.raises(ValueError, match="4 samples; a window of 4 delays needs at least 5"):
            delay_windows(samples, 4)


def cuts(trials):
    """Random delays, stencil widths, transients, lengths and rows per segment, the smallest among them."""
    rng = np.random.default_rng(4)
    for _ in range(trials):
        delays, half_width = rng.integers(0, 7), rng.integers(0, 5)
        transient = int(rng.choice([0, 0, 1, 9]))
        needed = transient + delays + 2 * half_width + 1
        lengths = [max(needed + int(extra), 2) for extra in rng.choice([0, 1, 3, 40], 3)]
        yield int(delays), int(half_width), transient, lengths, int(rng.choice([1, 2, 3, 7, 16, 1000]))


def test_every_sample_is_core_once_and_no_segment_crosses_a_run_or_enters_the_transient():
    for cut in cuts(150):
        check_cores(*cut)


def check_cores(delays, half_width, transient, lengths, rows):
    runs = [run(length, 1000.0 * i, KINDS[i]) for i, length in enumerate(lengths)]
    data = SegmentDataset(runs, before=delays + half_width, after=half_width, rows=rows, transient=TIMESTEP * transient)
    core = []
    for segment in data:
        values = segment.observation[:, 0].numpy()
        np.testing.assert_array_equal(np.diff(values), 1.0)
        np.testing.assert_array_equal(segment.input[:, 0], -values)
        assert (values // 1000 == segment.trajectory).all()
        assert segment.core[1] - segment.core[0] <= rows
        assert len(values) > delays
        core.append(values[slice(*segment.core)])
        if segment.kind == "decay":
            assert values[0] % 1000 >= transient
    expected = [1000 * i + np.arange(transient * (trajectory.kind == "decay"), trajectory.length)
                for i, trajectory in enumerate(runs)]
    np.testing.assert_array_equal(np.concatenate(core), np.concatenate(expected))


def test_rows_computed_segment_by_segment_are_exactly_those_of_whole_runs():
    """Windows need context before, their derivatives on both sides, and the felt inputs as well."""
    for cut in cuts(100):
        check_rows(*cut)


def check_rows(delays, half_width, transient, lengths, rows):
    half_width = max(half_width, 1)
    stencil = central_difference(2 * half_width) if half_width < 4 else savitzky_golay(9, 4)
    rng = np.random.default_rng(5)
    runs = [Trajectory(TIMESTEP * np.arange(n + 2), rng.normal(size=(n + 2, 2)), rng.normal(size=(n + 2, 3)), kind)
            for n, kind in zip(lengths, KINDS)]

    def rows_of(observation, inputs, keep):
        window = delay_windows(observation, delays).flatten(1)
        rate, felt = stencil(window, TIMESTEP), stencil.held_input(inputs[delays:])
        middle = window[half_width:half_width + len(rate)]
        return keep(window, delays), keep(torch.cat([middle, rate, felt], dim=1), delays + half_width)

    whole = []
    for trajectory in runs:
        first = transient if trajectory.kind == "decay" else 0
        whole.append(rows_of(torch.from_numpy(trajectory.observation[first:].copy()),
                             torch.from_numpy(trajectory.input[first:].copy()), lambda rows, _: rows))
    data = SegmentDataset(runs, before=delays + half_width, after=half_width, rows=rows, transient=TIMESTEP * transient)
    cut_up = [rows_of(segment.observation, segment.input, segment.core_rows) for segment in data]
    for expected, found in zip(zip(*whole), zip(*cut_up)):
        torch.testing.assert_close(torch.cat(found), torch.cat(expected), rtol=0, atol=0)


def test_segments_of_a_file_are_those_of_memory(tmp_path):
    runs = [run(50, kind="decay"), run(33, 1000.0)]
    path = TrajectoryDataset(runs, np.zeros(2), ("a", "b"), ("u",)).save(tmp_path / "runs.h5")
    options = {"before": 3, "after": 2, "rows": 10, "transient": 0.05}
    stored, memory = (SegmentDataset(source, **options) for source in (TrajectoryDataset.load(path), runs))
    for found, expected in zip(stored, memory, strict=True):
        torch.testing.assert_close(found.observation, expected.observation, rtol=0, atol=0)
        torch.testing.assert_close(found.input, expected.input, rtol=0, atol=0)
        assert (found.core, found.kind, found.trajectory, found.index) == (
            expected.core, expected.kind, expected.trajectory, expected.index)


@pytest.mark.parametrize(("segments", "processes"), [(7, 2), (8, 2), (7, 3), (2, 2), (9, 4)])
def test_processes_share_the_segments_once_each_and_step_equally_often(segments, processes):
    data = SegmentDataset([run(10 * segments)], before=2, after=1, rows=10)
    shares = [SegmentShare(data, rank, processes) for rank in range(processes)]
    assert len({len(share) for share in shares}) == 1
    core = [segment.core_rows(segment.observation[:, 0], 0) for share in shares
            for segment in (share[i] for i in range(len(share)))]
    assert sorted(torch.cat(core).tolist()) == list(range(10 * segments))


def test_a_run_shorter_than_its_transient_and_context_is_refused_with_the_numbers():
    SegmentDataset([run(15, kind="decay")], before=4, after=2, transient=0.08)
    with pytest.raises(ValueError, match="'short' has 14 samples; a transient of 8 samples and 6 samples of context"):
        SegmentDataset([run(20), run(14, kind="decay", name="short")], before=4, after=2, transient=0.08)
    with pytest.raises(ValueError, match="rows is 0; expected at least 1"):
        SegmentDataset([run(20)], before=0, after=0, rows=0)


@pytest.mark.parametrize(("delays", "horizon"), [(0, 2), (3, 5), (6, 1)])
def test_all_starts_are_those_that_fit_and_none_crosses_two_runs(delays, horizon):
    runs = [run(delays + horizon + 1), run(delays + horizon, 1000.0), run(30, 2000.0)]
    data = RolloutDataset(runs, delays=delays, horizon=horizon)
    assert len(data) == 1 + 30 - delays - horizon
    for index in range(len(data)):
        item = data[index]
        values = torch.cat([item.window, item.outputs])[:, 0].numpy()
        np.testing.assert_array_equal(values, values[0] + np.arange(delays + 1 + horizon))
        np.testing.assert_array_equal(torch.cat([item.window_inputs, item.inputs])[:, 0], -values[:-1])
        assert values[-1] % 1000 < 30
        assert item.window.shape == (delays + 1, 2) and item.outputs.shape == (horizon, 2)
        assert item.window_inputs.shape == (delays, 1) and item.inputs.shape == (horizon, 1)


def test_starts_keep_their_stride_and_leave_out_the_transient_of_decays_only():
    runs = [run(40, kind="decay"), run(40, 1000.0)]
    data = RolloutDataset(runs, delays=2, horizon=4, stride=5, transient=0.1)
    assert data.starts.tolist() == [[0, k] for k in range(12, 36, 5)] + [[1, k] for k in range(2, 36, 5)]


def test_drawn_starts_are_distinct_repeat_with_the_seed_and_are_all_there_are_when_many_are_asked_for():
    runs = [run(200), run(100, 1000.0)]
    first, again, other = (RolloutDataset(runs, delays=1, horizon=10, starts=50, seed=seed).starts.tolist()
                           for seed in (3, 3, 4))
    assert first == again != other
    assert len({tuple(start) for start in first}) == 50
    assert {number for number, _ in first} == {0, 1}
    assert len(RolloutDataset(runs, delays=1, horizon=10, starts=10**6)) == 189 + 89


def test_a_horizon_that_no_run_can_hold_is_refused_with_the_numbers():
    with pytest.raises(ValueError, match="3 delays and a horizon of 10 samples need 14 samples, but the longest of 2 "
                                         "trajectories has 13"):
        RolloutDataset([run(13), run(5)], delays=3, horizon=10)
    with pytest.raises(ValueError, match="the longest of 0 trajectories has 0"):
        RolloutDataset([], delays=3, horizon=10)


def test_a_batch_stacks_single_starts():
    data = RolloutDataset([run(30)], delays=2, horizon=3)
    batch = stack_rollouts([data[0], data[5], data[7]])
    assert batch.window.shape == (3, 3, 2) and batch.outputs.shape == (3, 3, 2)
    torch.testing.assert_close(batch.outputs[1], data[5].outputs, rtol=0, atol=0)
    assert batch.to("cpu").inputs.dtype == torch.float64
