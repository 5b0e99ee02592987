import dataclasses
import json
import logging

import h5py
import numpy as np
import pytest
import yaml

from ssmr_torch.data.assembly import fingerprint, rest_at_end
from ssmr_torch.data.card_reader import custom
from ssmr_torch.data.recording_card import read_recording_card
from ssmr_torch.data.stored_trajectories import stored
from ssmr_torch.recording_faults.recording import Recording
from ssmr_torch.trajectory import TrajectoryDataset


def decay(count=120, outputs=3, timestep=0.01, size=10.0):
    """Time (T,) and a damped oscillation (T, p) about zero, mm."""
    t = timestep * np.arange(count)
    phases = np.arange(outputs)
    return t, size * np.exp(-4 * t)[:, None] * np.cos(25 * t[:, None] + phases)


def write_csv(path, names, table):
    np.savetxt(path, table, delimiter=",", header=",".join(names), comments="", fmt="%.10g")


def csv_card(folder, **changes):
    """Two decays about (5, -5, 100) mm and a controlled run in CSV, and their card; `changes` replace
    keys."""
    rest = np.array([5.0, -5.0, 100.0])
    t, y = decay(200)
    for name, scale in (("release_1", 1.0), ("release_2", -0.7)):
        write_csv(folder / f"{name}.csv", ["t", "x", "y", "z", "u"], np.c_[t, rest + scale * y, 0 * t])
    u = 1000 * np.sin(3 * t)
    write_csv(folder / "inputs.csv", ["t", "x", "y", "z", "u"],
              np.c_[t, rest + 5 * np.sin(3 * t)[:, None] * [1, 2, 3], u])
    card = {"files": ["release_1.csv", "release_2.csv", "inputs.csv"],
            "columns": {"time": "t", "observation": ["x", "y", "z"], "input": ["u"]},
            "units": {"length": "mm", "input": "mN", "time": "s"}, "rest": "last sample of decays",
            "decays": ["release_1", "release_2"], "split": {"test": ["inputs"]}, **changes}
    path = folder / "card.yaml"
    path.write_text(yaml.safe_dump({k: v for k, v in card.items() if v is not ...}))
    return path


def test_a_card_turns_millimetres_into_displacements_in_metres(tmp_path):
    dataset = custom(csv_card(tmp_path))
    t, y = decay(200)
    np.testing.assert_allclose(dataset.rest, 1e-3 * (np.array([5, -5, 100]) + 0.15 * y[-1]), atol=1e-9)
    absolute = 1e-3 * y + [5e-3, -5e-3, 0.1]
    np.testing.assert_allclose(dataset[0].observation, absolute - dataset.rest, atol=1e-9)
    np.testing.assert_allclose(dataset[2].input[:, 0], np.sin(3 * t), atol=1e-9)
    assert [(d.kind, d.split, d.name) for d in dataset] == [
        ("decay", "train", "release_1"), ("decay", "train", "release_2"), ("controlled", "test", "inputs")]
    assert dataset.input_unit == "N" and dataset.output_names == ("x", "y", "z")


def test_an_hdf5_file_with_a_run_column_equals_its_csv_file(tmp_path):
    t, y = decay(100)
    run = np.repeat([1.0, 2.0], 100)
    table = np.tile(y, (2, 1))
    write_csv(tmp_path / "a.csv", ["run", "y_0", "y_1", "y_2", "u"], np.c_[run, table, 0 * run])
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["y"] = np.loadtxt(tmp_path / "a.csv", delimiter=",", skiprows=1)[:, 1:4]
        file["run"], file["u"], file["note"] = run, 0 * run, "x"
    card = {"columns": {"run": "run", "observation": ["y_0", "y_1", "y_2"], "input": ["u"]}, "sampling_time": 10,
            "units": {"length": "mm", "time": "ms"}, "rest": [0, 0, 0], "decays": ["a:1"],
            "split": {"test": ["a:2"]}, "faults": {"copies": "keep"}}
    datasets = []
    for file in ("a.csv", "a.h5"):
        (tmp_path / "card.yaml").write_text(yaml.safe_dump(card | {"files": [file]}))
        datasets.append(custom(tmp_path / "card.yaml"))
    for one, other in zip(*datasets, strict=True):
        np.testing.assert_array_equal(one.observation, other.observation)
        assert (one.kind, one.split, one.name) == (other.kind, other.split, other.name)
        assert one.timestep == pytest.approx(0.01) and not one.input.any()


def test_resting_samples_give_the_rest_position(tmp_path):
    t = 0.01 * np.arange(400)
    moving = np.where(t > 2, 10 * np.sin(5 * (t - 2)), 0.0)
    write_csv(tmp_path / "still.csv", ["t", "x", "y", "z", "u"],
              np.c_[t, np.array([5, -5, 100]) + moving[:, None], np.where(t > 2, 1.0, 0.0)])
    dataset = custom(csv_card(tmp_path, files=["still.csv"], decays=[], split={},
                                      rest="median of resting samples"))
    np.testing.assert_allclose(dataset.rest, [0.005, -0.005, 0.1], atol=1e-5)


@pytest.mark.parametrize(("key", "nearest"), [("file", "files"), ("splits", "split"), ("seam", "seams"),
                                              ("rests", "rest")])
def test_an_unknown_key_of_the_card_is_refused_with_the_nearest(tmp_path, key, nearest):
    with pytest.raises(ValueError, match=f"unknown key '{key}'; did you mean '{nearest}'"):
        custom(csv_card(tmp_path, **{key: []}))


@pytest.mark.parametrize(("changes", "message"), [
    ({"units": {"lenght": "mm"}}, "units has the unknown key 'lenght'; did you mean 'length'"),
    ({"units": {"length": "inch"}}, "units.length is 'inch'"), ({"units": ...}, "the card lacks the key "
                                                                                "units; it needs files"),
    ({"units": {"input": "N"}}, "units lacks the key length"), ({"rest": "somewhere"}, "rest is 'somewhere'"),
    ({"rest": [0, 0]}, r"card.yaml: rest is \[0, 0\]; expected 3 numbers in mm"),
    ({"rest": [0, "a", 120]}, r"card.yaml: rest is \[0, 'a', 120\]; expected 3 numbers in mm"),
    ({"range": [1]}, r"range is \[1\]; expected two numbers in m, \[smallest, largest\]"),
    ({"range": 1}, r"range is 1; expected two numbers in m, \[smallest, largest\]"),
    ({"interval_range": [0.5, 0.1]}, "interval_range is .*two numbers in s"),
    ({"largest_input": -1}, "largest_input is -1"), ({"timestep": 10}, "timestep is 10 s; expected seconds"),
    ({"split": {"test": "inputs"}}, r"split.test is 'inputs'; expected a list of runs, as \[inputs\]"),
    ({"columns": {"time": "t", "observation": ["x", "y", "z"]}},
     r"columns.input is \[\]; expected .*one input column or more.*of zeros"),
    ({"columns": {"time": "t", "observation": ["x", "y", "x"], "input": ["u"]}}, r"\['x'\] twice"),
    ({"columns": {"time": "t", "observation": ["x", "y", "z"], "input": ["u", "u"]}}, r"\['u'\] twice"),
    ({"columns": {"time": "t", "observation": ["x", "y", "z"], "input": ["z"]}}, r"\['z'\] twice"),
    ({"decays": ["release_9"]}, r"decays names the runs \['release_9'\].*do not exist"),
    ({"split": {"tset": ["inputs"]}}, "unknown key 'tset'; did you mean 'test'"),
    ({"decays": []}, "no run is a decay"), ({"sampling_time": 0.01}, "not both"),
    ({"files": []}, "files is .*one file or more"),
    ({"seams": {"inputs": [900]}}, r"seams \[900\] lie outside the 200 rows"),
    ({"columns": {"time": "t", "observation": ["x", "y", "tip"], "input": ["u"]}}, r"no numeric column "
                                                                                    r"\['tip'\]; it has"),
    ({"timestep": "fast"}, "timestep is 'fast'; expected a number of s"),
    ({"rest": "median of resting samples"}, "give rest as a vector"),
    ({"minimum_length": 1000}, "no run is left"), ({"minimum_length": 9.5}, "minimum_length is 9.5; expected a whole"),
    ({"files": "a.csv"}, "files is 'a.csv'; expected the names of one file or more"),
    ({"units": "mm"}, "units is 'mm'; expected keys and values, as {length: mm}"),
    ({"columns": ["x"]}, r"columns is \['x'\]; expected keys and values, as {observation"),
    ({"columns": {"time": 5, "observation": ["x"], "input": ["u"]}}, "columns.time is 5; expected the name of a col"),
    ({"seams": "none"}, "seams is 'none'; expected auto or rows by run"),
    ({"range": [0.0, float("nan")]}, r"range is \[0.0, nan\]; expected two numbers in m"),
    ({"split": ["inputs"]}, r"split is \['inputs'\]; expected keys and values"),
    ({"columns": {"time": "t", 7: "x"}}, "card.yaml: columns has the unknown key '7'; did you mean")])
def test_a_wrong_card_is_refused(tmp_path, changes, message):
    path = csv_card(tmp_path, **changes)
    if changes.get("rest") == "median of resting samples":
        path = csv_card(tmp_path, files=["inputs.csv"], decays=[], **changes)
    with pytest.raises(ValueError, match=message):
        custom(path)


def test_what_yaml_reads_as_another_type_is_understood(tmp_path):
    """YAML 1.1 reads 1e-2 as text, and 1 and 20260101 as numbers."""
    path = csv_card(tmp_path, units={"length": "mm", "input": "mN"}, timestep="1e-2", range=["1e-3", 2])
    for key, name in (("20260101", "release_1"),):
        (tmp_path / f"{name}.csv").rename(tmp_path / f"{key}.csv")
    path.write_text(path.read_text().replace("release_1.csv", "20260101.csv").replace("release_1", "20260101"))
    assert "- 20260101\n" in path.read_text()
    assert [(run.kind, run.name) for run in custom(path)][0] == ("decay", "20260101")


def test_a_card_that_is_changed_is_checked_again(tmp_path):
    card = read_recording_card(csv_card(tmp_path))
    assert card.changed(minimum_length=20).minimum_length == 20 and card.minimum_length == 10
    with pytest.raises(ValueError, match="largest_input is 0; expected a positive number in N or 1"):
        card.changed(largest_input=0)
    with pytest.raises(ValueError, match="the card has the unknown key 'lowest_input'; did you mean 'largest_input'"):
        card.changed(lowest_input=0)


def test_a_missing_card_or_file_is_reported(tmp_path):
    with pytest.raises(FileNotFoundError, match="no card at"):
        custom(tmp_path / "card.yaml")
    with pytest.raises(FileNotFoundError, match="absent.csv"):
        custom(csv_card(tmp_path, files=["absent.csv"], decays=[], split={}, rest=[0, 0, 0]))


@pytest.mark.parametrize(("text", "message"), [
    ("", "inputs.csv is empty"), ("t,x,y,z,u\n", "has a header but no rows"),
    ("0,1,2,3,4\n1,1,2,3,4\n", "expected the names of the columns"),
    ("t,x,y,z,u\n0,1,2,3,4\n1,oops,2,3,4\n", r"row 1 \(from 0\), column 'x' holds 'oops'"),
    ("t,x,y,z,u\n0,1,2,3\n", "has 4 cells, the header 5"), ("t,x,x,z,u\n0,1,2,3,4\n", "names a column "
                                                                                      "twice")])
def test_a_wrong_csv_file_is_refused(tmp_path, text, message):
    path = csv_card(tmp_path)
    (tmp_path / "inputs.csv").write_text(text)
    with pytest.raises(ValueError, match=message):
        custom(path)


def edit(path, row, column, value):
    lines = path.read_text().splitlines()
    cells = lines[row + 1].split(",")
    cells[column] = value
    lines[row + 1] = ",".join(cells)
    path.write_text("\n".join(lines))


def test_rows_with_empty_cells_are_bridged_split_the_run_or_are_refused(tmp_path):
    """Up to five empty rows are bridged, or up to two with "split"; the run ends before more of them."""
    whole = custom(csv_card(tmp_path)).select("test")[0]
    path = csv_card(tmp_path, missing="refuse")
    for row in (80, 81, 82):
        edit(tmp_path / "inputs.csv", row, 2, "")
    with pytest.raises(ValueError, match=r"inputs: 3 of 200 rows are not finite, the first are rows \[80, 81, 82\]"):
        custom(path)
    parts = custom(csv_card_keeping(tmp_path, missing="split")).select("test")
    assert [(p.name, p.length) for p in parts] == [("inputs/0", 80), ("inputs/1", 117)]
    bridged, = custom(csv_card_keeping(tmp_path, missing="bridge")).select("test")
    np.testing.assert_allclose(bridged.observation, whole.observation, atol=1e-6)
    np.testing.assert_array_equal(bridged.input, whole.input)


def csv_card_keeping(folder, **changes):
    card = yaml.safe_load((folder / "card.yaml").read_text()) | changes
    (folder / "card.yaml").write_text(yaml.safe_dump(card))
    return folder / "card.yaml"


@pytest.mark.parametrize(("value", "word"), [("0.79", "repeats"), ("0.5", "goes back")])
def test_time_that_does_not_increase_is_refused(tmp_path, value, word):
    path = csv_card(tmp_path)
    edit(tmp_path / "inputs.csv", 80, 0, value)
    with pytest.raises(ValueError, match=f"inputs: time {word} at row 80"):
        custom(path)


@pytest.mark.parametrize(("declared", "likely"), [("m", "cm or mm"), ("mm", "m")])
def test_lengths_in_another_unit_than_declared_are_refused_naming_the_likely_one(tmp_path, declared, likely):
    path = csv_card(tmp_path, units={"length": declared, "input": "mN"})
    if declared == "mm":
        for name in ("release_1", "release_2", "inputs"):
            table = np.loadtxt(tmp_path / f"{name}.csv", delimiter=",", skiprows=1)
            table[:, 1:4] *= 1e-3
            write_csv(tmp_path / f"{name}.csv", ["t", "x", "y", "z", "u"], table)
    with pytest.raises(ValueError, match=f"read in {declared}; .*observations look like {likely}\\."):
        custom(path)


def rescale(folder, columns, factor):
    for name in ("release_1", "release_2", "inputs"):
        table = np.loadtxt(folder / f"{name}.csv", delimiter=",", skiprows=1)
        table[:, columns] *= factor
        write_csv(folder / f"{name}.csv", ["t", "x", "y", "z", "u"], table)


def test_150_mm_of_travel_in_metres_are_not_taken_for_millimetres(tmp_path):
    path = csv_card(tmp_path)
    rescale(tmp_path, slice(1, 4), 15e-3)
    with pytest.raises(ValueError, match="read in mm; expected between 0.001 and 2 m: .* look like m or cm"):
        custom(path)


@pytest.mark.parametrize("rest", ["last sample of decays", "median of resting samples"])
@pytest.mark.parametrize(("declared", "factor", "likely"), [("s", 1e3, "ms"), ("ms", 1.0, "s")])
def test_a_clock_in_another_unit_than_declared_is_refused_naming_the_likely_one(tmp_path, declared, factor, likely,
                                                                                rest):
    path = csv_card(tmp_path, units={"length": "mm", "input": "mN", "time": declared}, rest=rest)
    rescale(tmp_path, 0, factor)
    with pytest.raises(ValueError, match=f"median sampling interval is .* s when the times are read in {declared}; "
                                         f"expected between 0.0001 and 0.5 s: the times look like {likely}\\."):
        custom(path)


@pytest.mark.parametrize(("declared", "factor", "message"), [
    ("N", 1.0, r"largest input is .* N when the inputs are read in N; .*100 N: the inputs look like mN\."),
    ("1", 0.02, r"largest input is 20 when the inputs are read in 1; .* 10: the inputs look like N or mN\.")])
def test_inputs_in_another_unit_than_declared_are_refused_unless_the_card_widens_the_limit(tmp_path, declared, factor,
                                                                                         message):
    path = csv_card(tmp_path, units={"length": "mm", "input": declared})
    rescale(tmp_path, 4, factor)
    with pytest.raises(ValueError, match=message):
        custom(path)
    dataset = custom(csv_card_keeping(tmp_path, largest_input=1000))
    assert dataset.provenance["peaks"]["input"] == pytest.approx(1000 * factor, rel=1e-3)


def test_the_peaks_found_are_in_the_provenance(tmp_path):
    dataset = custom(csv_card(tmp_path))
    peaks = {"displacement_m": max(np.abs(t.observation).max() for t in dataset),
             "input": max(np.abs(t.input).max() for t in dataset)}
    assert dataset.provenance["peaks"] == pytest.approx(peaks)


def test_a_card_that_is_no_yaml_is_refused_in_one_line_that_names_the_line(tmp_path):
    (tmp_path / "card.yaml").write_text("files: [a.csv]\nrest: [0, 0\ndecays: []\n")
    with pytest.raises(ValueError, match="^card.yaml: line 3: .*expected YAML$") as caught:
        custom(tmp_path / "card.yaml")
    assert "\n" not in str(caught.value)


def test_a_truncated_hdf5_file_is_refused_with_the_remedy(tmp_path):
    dataset = custom(csv_card(tmp_path))
    for name, read in (("session.h5", lambda path: custom(csv_card(tmp_path, files=[path.name], decays=[]))),
                       ("runs.h5", stored)):
        path = dataset.save(tmp_path / name)
        path.write_bytes(path.read_bytes()[:5000])
        with pytest.raises(ValueError, match=f"{name} cannot be read .*truncated.*; copy or .* it again"):
            read(path)


def test_declared_and_found_seams_cut_the_run(tmp_path):
    path = csv_card(tmp_path, seams={"inputs": [50]})
    assert [p.length for p in custom(path).select("test")] == [50, 150]
    path = csv_card(tmp_path)
    table = np.loadtxt(tmp_path / "inputs.csv", delimiter=",", skiprows=1)
    table[120:, 1:4] += 15
    table[160:, 0] += 0.05
    write_csv(tmp_path / "inputs.csv", ["t", "x", "y", "z", "u"], table)
    dataset = custom(path)
    assert [p.length for p in dataset.select("test")] == [120, 40, 40]
    assert dataset.provenance["seams"] == {"inputs": [120, 160]}


def test_observations_and_inputs_of_different_length_are_refused():
    with pytest.raises(ValueError, match="run: 5 times, 5 observations and 4 inputs"):
        Recording("run", np.arange(5.0), np.ones((5, 1)), np.ones((4, 1)))


def test_a_run_that_does_not_end_at_rest_gives_no_rest_position():
    t = 0.01 * np.arange(300)
    with pytest.raises(ValueError, match="does not end at rest; give rest as a vector"):
        rest_at_end(t, t[:, None], t[:, None], "run")
    np.testing.assert_allclose(rest_at_end(t, 0 * t[:, None] + 7, np.minimum(t, 1.0)[:, None], "run"), [7.0])


# Provenance and stored files

def test_the_provenance_is_plain_names_no_directory_and_is_logged(tmp_path, caplog):
    with caplog.at_level(logging.INFO):
        dataset = custom(csv_card(tmp_path))
    text = json.dumps(dataset.provenance)
    assert str(tmp_path) not in text
    assert all(len(digest) == 64 for digest in dataset.provenance["sources"].values())
    assert all(sentence in caplog.text for sentence in dataset.provenance["assumptions"])


def test_a_stored_dataset_is_read_back(tmp_path):
    written = custom(csv_card(tmp_path))
    path = written.save(tmp_path / "runs.h5")
    read = stored(path)
    np.testing.assert_array_equal(read[0].read().observation, written[0].observation)
    assert read.provenance == written.provenance | {"stored": fingerprint(path)}
    assert list(read.provenance["stored"]) == ["runs.h5"] and str(tmp_path) not in json.dumps(read.provenance)


def test_stored_datasets_of_one_robot_are_joined_and_those_of_two_refused(tmp_path):
    written = custom(csv_card(tmp_path))
    paths = [written.save(tmp_path / name / "runs.h5") for name in ("one", "two")]
    joined = stored(paths)
    assert len(joined) == 2 * len(written)
    np.testing.assert_array_equal(joined[-1].read().input, written[-1].input)
    added = {"stored": fingerprint(paths[0]), "joined": [fingerprint(paths[1])]}
    assert joined.provenance == written.provenance | added
    for changes, message in (({"rest": written.rest + 0.01}, "differ in rest"),
                             ({"input_names": ["a", "b", "c", "d"][:written.input_dim]}, "differ in input_names")):
        other = dataclasses.replace(written, **changes).save(tmp_path / "other.h5")
        with pytest.raises(ValueError, match=f"runs.h5 and .*other.h5 {message}"):
            stored([paths[0], other])


def test_a_dataset_is_what_every_reader_returns(tmp_path):
    assert isinstance(custom(csv_card(tmp_path)), TrajectoryDataset)


def test_a_card_states_a_symmetry_for_the_selection(tmp_path):
    symmetry = {"angle": 180, "axis": [0, 0, 1], "inputs": ["-u"]}
    assert custom(csv_card(tmp_path, symmetry=symmetry)).provenance["symmetry"] == symmetry
    assert "symmetry" not in custom(csv_card(tmp_path)).provenance
    with pytest.raises(ValueError, match=r"symmetry.inputs names \['cable'\], but the inputs are"):
        custom(csv_card(tmp_path, symmetry={**symmetry, "inputs": ["cable"]}))
