"""Trajectories and their HDF5 file."""

import json
import os

import h5py
import numpy as np
import pytest

from ssmr_torch import checksum
from ssmr_torch import trajectory as module
from ssmr_torch.checksum import Damaged
from ssmr_torch.trajectory import Trajectory, TrajectoryDataset
from ssmr_torch.trajectory_file import BEFORE, FORMAT

TIMESTEP = 0.01


def run(samples=40, p=3, m=2, seed=0, timestep=TIMESTEP, jitter=0.0, **labels):
    rng = np.random.default_rng(seed)
    time = 5.0 + timestep * (np.arange(samples) + jitter * rng.uniform(-0.5, 0.5, samples))
    return Trajectory(time, rng.normal(size=(samples, p)), rng.normal(size=(samples, m)), **labels)


@pytest.fixture
def dataset():
    runs = [run(seed=1, kind="decay", name="first"), run(55, seed=2, split="test", name="sécond / 2", jitter=1e-4),
            run(2, seed=3, kind="static", split="validation")]
    return TrajectoryDataset(runs, [0.1, 0.2, 1 / 3], ("x", "y", "z"), ("u1", "u2"), "1", {"source": "drawn", "n": 3})


@pytest.fixture
def stored(dataset, tmp_path):
    return TrajectoryDataset.load(dataset.save(tmp_path / "deep" / "runs.h5"))


@pytest.fixture
def saved(dataset, tmp_path):
    """Its file, which nobody has opened."""
    return dataset.save(tmp_path / "runs.h5")


def assert_equal(found, expected):
    for name in ("time", "observation", "input"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name), strict=True)
    assert (found.kind, found.split, found.name) == (expected.kind, expected.split, expected.name)


def test_the_file_gives_back_every_bit_and_every_label(dataset, stored):
    for found, expected in zip(stored, dataset, strict=True):
        assert_equal(found.read(), expected)
        assert (found.length, found.timestep) == (expected.length, expected.timestep)
        assert (found.kind, found.split, found.name) == (expected.kind, expected.split, expected.name)
    np.testing.assert_array_equal(stored.rest, dataset.rest)
    for name in ("output_names", "input_names", "input_unit", "provenance", "timestep"):
        assert getattr(stored, name) == getattr(dataset, name)


def test_a_stored_dataset_can_be_saved_over_its_own_file(dataset, stored):
    stored.save(stored[0].path)
    for found, expected in zip(TrajectoryDataset.load(stored[0].path), dataset, strict=True):
        assert_equal(found.read(), expected)


@pytest.mark.parametrize(("start", "stop"), [(0, 40), (3, 17), (10, 10**6), (-7, 40), (5, -4), (0, 1), (40, 50),
                                             (30, 20)])
def test_a_stored_trajectory_is_sliced_as_one_in_memory(dataset, stored, start, stop):
    for found, expected in zip(stored[0].slice(start, stop), dataset[0].slice(start, stop), strict=True):
        np.testing.assert_array_equal(found, expected)


def test_parts_of_parts_seen_through_columns_are_the_same_in_memory_and_in_the_file(dataset, stored):
    expected, found = dataset[1], stored[1]
    for change in (lambda t: t.part(5, 50), lambda t: t.observing([2, 0]), lambda t: t.part(3, split="train"),
                   lambda t: t.observing([1]), lambda t: t.part(0, -10, name="tail")):
        expected, found = change(expected), change(found)
        assert found.length == expected.length
        assert_equal(found.read(), expected)
        for ours, theirs in zip(found.slice(2, 9), expected.slice(2, 9), strict=True):
            np.testing.assert_array_equal(ours, theirs)


@pytest.mark.parametrize(("start", "stop", "samples"), [(39, None, 1), (40, 50, 0), (20, 10, 0)])
def test_a_part_of_less_than_two_samples_is_refused_in_memory_and_in_the_file(dataset, stored, start, stop, samples):
    for trajectory in (dataset[0], stored[0]):
        with pytest.raises(ValueError, match=f"first: {samples} samples; expected at least 2"):
            trajectory.part(start, stop)


def test_only_the_samples_asked_for_are_read_from_the_file(stored, monkeypatch):
    read = []
    original = h5py.Dataset.__getitem__

    def counting(dataset, rows, *rest):
        found = original(dataset, rows, *rest)
        read.append(len(found))
        return found

    monkeypatch.setattr(h5py.Dataset, "__getitem__", counting)
    part = stored[1].part(10, 50)
    assert read == []
    part.slice(4, 9)
    assert read == [5, 5]


def test_a_save_that_is_interrupted_leaves_the_old_file_as_it_was(dataset, stored, monkeypatch):
    path, before = stored[0].path, stored[0].path.read_bytes()
    original, writes = h5py.Group.__setitem__, []

    def interrupted(group, name, value):
        writes.append(name)
        if len(writes) == 3:
            raise KeyboardInterrupt
        original(group, name, value)

    monkeypatch.setattr(h5py.Group, "__setitem__", interrupted)
    with pytest.raises(KeyboardInterrupt):
        TrajectoryDataset([run(seed=9)], np.zeros(3), "xyz", "ab").save(path)
    monkeypatch.undo()
    assert path.read_bytes() == before
    TrajectoryDataset([run(seed=9)], np.zeros(3), "xyz", "ab").save(path)
    assert len(TrajectoryDataset.load(path)) == 1
    assert os.listdir(path.parent) == [path.name]


def test_provenance_that_json_cannot_hold_is_refused_before_anything_is_written(dataset, tmp_path):
    bad = TrajectoryDataset(dataset.trajectories, dataset.rest, "xyz", "ab", provenance={"array": np.zeros(2)})
    with pytest.raises(TypeError, match="not JSON serializable"):
        bad.save(tmp_path / "runs.h5")
    assert not list(tmp_path.iterdir())


def test_a_trajectory_does_not_change_the_callers_arrays_nor_follow_their_changes():
    time, observation, inputs, rest = TIMESTEP * np.arange(5), np.ones((5, 2)), np.ones((5, 1)), np.ones(2)
    trajectory = Trajectory(time, observation, inputs)
    dataset = TrajectoryDataset([trajectory], rest, "ab", "u")
    for array in (time, observation, inputs, rest):
        assert array.flags.writeable
        array[:] = np.nan
    assert_equal(trajectory, Trajectory(TIMESTEP * np.arange(5), np.ones((5, 2)), np.ones((5, 1))))
    np.testing.assert_array_equal(dataset.rest, [1, 1])


def test_the_arrays_of_a_trajectory_are_read_only(dataset):
    trajectory = dataset[0]
    for array in (trajectory.time, trajectory.observation, trajectory.input, trajectory.slice(0, 3)[0], dataset.rest):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0


def test_datasets_can_be_compared_and_hashed(dataset, stored):
    assert dataset == dataset and dataset != stored
    assert len({dataset, stored, dataset}) == 2


@pytest.mark.parametrize(("change", "message"), [
    ({"time": np.zeros((9, 1))}, r"\(9, 1\), \(9, 2\), \(9, 1\)"),
    ({"observation": np.zeros(9)}, r"expected time \(T,\).*\(9,\)"),
    ({"input": np.zeros((8, 1))}, "9 times, 9 observations and 8 inputs"),
    ({"time": np.zeros(1), "observation": np.zeros((1, 2)), "input": np.zeros((1, 1))}, "1 samples; expected"),
    ({"kind": "free"}, "kind 'free' and split 'train'.*'decay'"), ({"split": "dev"}, "split 'dev'.*'validation'"),
    ({"observation": np.where(np.arange(18).reshape(9, 2) > 12, np.nan, 0)},
     "3 of 9 samples of observation are not finite, the first one is sample 6"),
    ({"input": np.full((9, 1), np.inf)}, "9 of 9 samples of input are not finite"),
    ({"time": 0.1 * np.array([0, 1, 2, 3, 3, 4, 5, 6, 7])}, "time does not increase at sample 4"),
    ({"time": 0.1 * np.array([0, 1, 2, 3, 4.01, 5, 6, 7, 8])},
     r"up to 1 % from 0.1 s, more than the permitted 0.1 %; resample")])
def test_a_bad_trajectory_is_refused_with_the_numbers(change, message):
    good = {"time": 0.1 * np.arange(9), "observation": np.zeros((9, 2)), "input": np.zeros((9, 1)), "name": "bad one"}
    Trajectory(**good)
    with pytest.raises(ValueError, match=f"bad one: .*{message}"):
        Trajectory(**(good | change))


def test_jitter_is_accepted_up_to_the_tolerance():
    for share, accepted in ((0.99, True), (1.01, False)):
        steps = np.full(100, 1.0)
        steps[50] += share * module.JITTER_TOLERANCE
        steps[51] -= share * module.JITTER_TOLERANCE
        time = np.r_[0, np.cumsum(steps)]
        if accepted:
            Trajectory(time, np.zeros((101, 1)), np.zeros((101, 1)))
        else:
            with pytest.raises(ValueError, match="0.101 %"):
                Trajectory(time, np.zeros((101, 1)), np.zeros((101, 1)))


@pytest.mark.parametrize(("runs", "rest", "message"), [
    ([], np.zeros(3), "contains no trajectory; expected at least one"),
    ([run()], np.zeros(2), r"rest has shape \(2,\), but there are 3 output names"),
    ([run(), run(p=4, name="wide")], np.zeros(3), "'wide' has 4 outputs and 2 inputs; the dataset declares 3 and 2"),
    ([run(), run(m=1, name="thin")], np.zeros(3), "'thin' has 3 outputs and 1 inputs; the dataset declares 3 and 2"),
    ([run(), run(timestep=0.0102, name="slow")], np.zeros(3), "'slow' is sampled every 0.0102 s, but the first "
                                                              "one every 0.01 s")])
def test_runs_that_do_not_belong_together_are_refused_with_the_numbers(runs, rest, message):
    with pytest.raises(ValueError, match=message):
        TrajectoryDataset(runs, rest, ("x", "y", "z"), ("u1", "u2"))


@pytest.mark.parametrize("names", [{"output_names": ("x", "y", "x")}, {"input_names": ("x", "x")}])
def test_two_columns_of_one_name_are_refused(names):
    with pytest.raises(ValueError, match="puts are named 'x'; give each a different name"):
        TrajectoryDataset([run()], np.zeros(3), **dict(output_names=("x", "y", "z"), input_names=("a", "b")) | names)


@pytest.mark.parametrize("asked", [{"split": "tset"}, {"kind": "decays"}])
def test_a_split_or_kind_that_does_not_exist_is_refused(dataset, asked):
    with pytest.raises(ValueError, match="expected one of .*, or None for all"):
        dataset.select(**asked)


def test_runs_are_selected_by_split_and_kind(dataset):
    assert dataset.select(kind="decay") == (dataset[0],) and dataset.select(split="test") == (dataset[1],)
    assert dataset.select("train", "controlled") == () and dataset.select() == dataset.trajectories


def test_outputs_are_observed_by_name_in_the_order_asked_for(dataset, stored):
    for source in (dataset, stored):
        seen = source.observing(("z", "x"))
        assert seen.output_names == ("z", "x")
        np.testing.assert_array_equal(seen.rest, dataset.rest[[2, 0]])
        np.testing.assert_array_equal(seen[1].read().observation, dataset[1].observation[:, [2, 0]])
        np.testing.assert_array_equal(seen.observing(["x"])[1].slice(3, 9)[0], dataset[1].observation[3:9, :1])
        assert source.observing(None) is source and source.observing(("x", "y", "z")) is source
    with pytest.raises(ValueError, match=r"no outputs \['tip'\]; the dataset has \['x', 'y', 'z'\]"):
        dataset.observing(["x", "tip"])


def test_files_of_another_kind_are_refused(tmp_path, stored):
    with pytest.raises(FileNotFoundError, match="no trajectory file at .*absent.h5; make one"):
        TrajectoryDataset.load(tmp_path / "absent.h5")
    text = tmp_path / "text.h5"
    text.write_text("time,x\n0,1\n")
    with pytest.raises(ValueError, match="text.h5 is not an HDF5 file"):
        TrajectoryDataset.load(text)
    foreign = tmp_path / "foreign.h5"
    with h5py.File(foreign, "w") as file:
        file["trajectories"] = np.zeros(3)
    with pytest.raises(ValueError, match="not a trajectory file .*data=custom"):
        TrajectoryDataset.load(foreign)
    with h5py.File(foreign, "a") as file:
        file.attrs["card"] = json.dumps({"format": "ssmr_torch trajectories 99"})
    with pytest.raises(ValueError, match="has the format 'ssmr_torch trajectories 99'; this version reads '.* 2'"):
        TrajectoryDataset.load(foreign)
    cut = tmp_path / "cut.h5"
    cut.write_bytes(stored[0].path.read_bytes()[:-500])
    with pytest.raises(Damaged, match="truncated file"):
        TrajectoryDataset.load(cut)


def without_checksum(path, format=FORMAT):
    """The same file as a version without checksums wrote it, with this format."""
    path.write_bytes(path.read_bytes()[:-checksum.LENGTH])
    with h5py.File(path, "a") as file:
        file.attrs["card"] = json.dumps(json.loads(file.attrs["card"]) | {"format": format})
    return path


def test_a_file_of_an_earlier_version_loads_and_the_log_says_that_it_has_no_checksum(dataset, saved, caplog):
    path = without_checksum(saved, BEFORE)
    for found, expected in zip(TrajectoryDataset.load(path), dataset, strict=True):
        assert_equal(found.read(), expected)
    assert [record.getMessage() for record in caplog.records] == [
        f"{path} carries no checksum ({BEFORE}); damage to it may go unseen until it is written again"]


def test_a_file_whose_checksum_was_removed_does_not_pass_as_one_of_an_earlier_version(saved):
    with pytest.raises(Damaged, match="its format 'ssmr_torch trajectories 2' has a checksum, which is missing"):
        TrajectoryDataset.load(without_checksum(saved))


@pytest.mark.parametrize(("change", "says"), [
    (lambda file: file["trajectories/00001/observation"].__setitem__((7, 2), np.nan),
     "sécond / 2: sample 7 of observation is not finite"),
    (lambda file: file["trajectories/00000/time"].__setitem__(9, 5.0),
     "first: the time after sample 8 does not follow"),
    (lambda file: file["rest"].__setitem__(1, np.inf), "rest holds 1 numbers that are not finite"),
    (lambda file: file["trajectories/00000"].attrs.update(timestep=-0.01), "sampled every -0.01 s"),
    (lambda file: file["trajectories/00000"].attrs.update(timestep=0.02), "the time after sample 0 does not follow"),
    (lambda file: file["trajectories/00000"].attrs.update(kind="dcay"), "has the kind 'dcay'"),
    (lambda file: file["trajectories/00000"].pop("input"), "input"),
    (lambda file: file.attrs.update(card="{"), "its card cannot be read"),
    (lambda file: file.attrs.update(card="[" * 10 ** 5), "its card cannot be read"),
    (lambda file: file.attrs.update(card=file.attrs["card"].replace('"time_unit": "s"', '"time_unit": "ms"')),
     "no valid time_unit in its card")])
def test_a_wrong_value_in_a_file_without_checksum_is_refused_by_name_when_it_is_loaded(saved, change, says):
    path = without_checksum(saved, BEFORE)
    with h5py.File(path, "a") as file:
        change(file)
    with pytest.raises(Damaged, match=says):
        TrajectoryDataset.load(path)


def test_no_link_out_of_a_trajectory_file_is_followed(saved, tmp_path):
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["rest"] = np.zeros(3)
    path = without_checksum(saved, BEFORE)
    with h5py.File(path, "a") as file:
        del file["rest"]
        file["rest"] = h5py.ExternalLink(str(tmp_path / "other.h5"), "rest")
    with pytest.raises(ValueError, match="'rest' is a link to another file"):
        TrajectoryDataset.load(path)


def test_trajectories_whose_file_was_replaced_are_refused_instead_of_read_from_the_new_file(dataset, stored):
    stored[0].slice(0, 5)
    dataset.save(stored[0].path)  # the same content
    np.testing.assert_array_equal(stored[0].slice(0, 5)[0], dataset[0].observation[:5])
    TrajectoryDataset([run(seed=9)], np.zeros(3), "xyz", "ab").save(stored[0].path)
    for read in (stored[0].read, lambda: stored[0].slice(0, 5)):
        with pytest.raises(ValueError, match="was replaced since its trajectories were loaded; load it again"):
            read()


def test_the_file_has_the_permissions_that_the_user_asks_for(dataset, tmp_path):
    for mask, mode in ((0o022, 0o644), (0o077, 0o600)):
        before = os.umask(mask)
        try:
            assert dataset.save(tmp_path / "runs.h5").stat().st_mode & 0o777 == mode
        finally:
            os.umask(before)
