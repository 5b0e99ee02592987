import inspect
import json
import logging
import os
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io
import yaml

from ssmr_torch.data import readers
from ssmr_torch.data.matlab import read_koopman_struct, read_ssmlearn_cells
from ssmr_torch.data.recording import Recording, rest_at_end
from ssmr_torch.trajectory import TrajectoryDataset

DATA = Path(os.environ.get("SSMR_TORCH_DATA", Path(__file__).resolve().parents[3] / "shared" / "data"))
needs_data = pytest.mark.skipif(not DATA.is_dir(), reason=f"no measured data at {DATA}")


def decay(count=120, outputs=3, timestep=0.01, size=10.0):
    """Time (T,) and a damped oscillation (T, p) about zero, mm."""
    t = timestep * np.arange(count)
    phases = np.arange(outputs)
    return t, size * np.exp(-4 * t)[:, None] * np.cos(25 * t[:, None] + phases)


def write_cells_v73(path, cells, name="oData"):
    """A cell array as MATLAB 7.3 stores it: references, everything transposed."""
    with h5py.File(path, "w", userblock_size=512) as file:
        references = np.empty((2, len(cells)), dtype=h5py.ref_dtype)
        for i, row in enumerate(cells):
            for j, array in enumerate(row):
                dataset = file.create_dataset(f"#refs#/{i}_{j}", data=np.atleast_2d(array).T)
                references[j, i] = dataset.ref
        file.create_dataset(name, data=references, dtype=h5py.ref_dtype)


def object_array(rows):
    cells = np.empty((len(rows), len(rows[0])), dtype=object)
    for i, row in enumerate(rows):
        for j, array in enumerate(row):
            cells[i, j] = np.atleast_2d(array)
    return cells


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


# MATLAB layouts

@pytest.mark.parametrize("name", ["oData", "xData"])
@pytest.mark.parametrize("layout", ["v5", "v5 transposed", "v7.3"])
@pytest.mark.parametrize("cell", ["p×T", "T×p"])
def test_cell_arrays_of_every_layout_give_the_same_trajectories(tmp_path, name, layout, cell):
    truth = [decay(count, 3) for count in (50, 60, 70)]
    rows = [(t, y.T if cell == "p×T" else y) for t, y in truth]
    path = tmp_path / "decays.mat"
    if layout == "v7.3":
        write_cells_v73(path, rows, name)
    else:
        cells = object_array(rows)
        scipy.io.savemat(path, {name: cells.T if "transposed" in layout else cells})
    for (time, observation), (t, y) in zip(read_ssmlearn_cells(path), truth, strict=True):
        np.testing.assert_array_equal(time, t)
        np.testing.assert_array_equal(observation, y)


def test_two_scalar_trajectories_in_a_transposed_array_are_told_apart_by_time(tmp_path):
    truth = [decay(50, 1), decay(50, 1, size=3.0)]
    scipy.io.savemat(tmp_path / "d.mat", {"xData": object_array([(t, y.T) for t, y in truth]).T})
    for (time, observation), (t, y) in zip(read_ssmlearn_cells(tmp_path / "d.mat"), truth, strict=True):
        np.testing.assert_array_equal(time, t)
        np.testing.assert_array_equal(observation, y)


@pytest.mark.parametrize("nested", [False, True])
@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("version", ["v5", "v7.3"])
def test_runs_of_every_layout_give_the_same_fields(tmp_path, nested, turned, version):
    t, y = decay(40)
    u = np.random.default_rng(0).normal(size=(40, 4))
    fields = {"t": t[None], "y": y.T if turned else y, "u": u.T if turned else u,
              "y_eq": np.array([[1.0, 2.0, 3.0]])}
    path = tmp_path / "run.mat"
    if version == "v5":
        scipy.io.savemat(path, {"data": fields} if nested else fields)
    else:
        with h5py.File(path, "w", userblock_size=512) as file:
            for key, value in fields.items():
                file[f"data/{key}" if nested else key] = value.T
    read = read_koopman_struct(path)
    np.testing.assert_array_equal(read["t"], t)
    np.testing.assert_array_equal(read["y"], y)
    np.testing.assert_array_equal(read["u"], u)
    np.testing.assert_array_equal(np.ravel(read["y_eq"]), [1.0, 2.0, 3.0])


@pytest.mark.parametrize("read", [read_ssmlearn_cells, read_koopman_struct])
def test_a_file_that_is_no_matlab_file_is_refused(tmp_path, read):
    with pytest.raises(FileNotFoundError, match="absent.mat"):
        read(tmp_path / "absent.mat")
    (tmp_path / "empty.mat").touch()
    with pytest.raises(ValueError, match="empty.mat is empty"):
        read(tmp_path / "empty.mat")
    (tmp_path / "text.mat").write_text("t,y,u\n" * 100)
    with pytest.raises(ValueError, match="text.mat is not a MATLAB file"):
        read(tmp_path / "text.mat")


@pytest.mark.parametrize(("content", "message"), [
    ({"y": np.ones((3, 5))}, r"holds \['y'\]; expected a cell array"),
    ({"oData": np.ones((3, 5))}, "oData is not a cell array"),
    ({"oData": object_array([(np.ones(5), np.ones((3, 4)))])}, "expected rows {time 1×T, observation p×T}"),
    ({"oData": object_array([(np.ones((2, 5)), np.ones((3, 5)))])}, "expected rows "
                                                                    "{time 1×T, observation p×T}")])
def test_a_wrong_cell_layout_is_refused(tmp_path, content, message):
    scipy.io.savemat(tmp_path / "wrong.mat", content)
    with pytest.raises(ValueError, match=message):
        read_ssmlearn_cells(tmp_path / "wrong.mat")


@pytest.mark.parametrize(("changes", "message"), [
    ({"u": ...}, r"\['u'\] missing, expected t, y and u"), ({"y": "text"}, r"\['y'\] missing"),
    ({"u": np.ones((4, 7))}, r"u has shape \(4, 7\), but t has 5 samples"),
    ({"t": np.ones((2, 5))}, r"t has shape \(2, 5\)"), ({"y": np.ones((3, 5, 2))}, r"y has shape \(3, 5, "
                                                                                    r"2\)")])
def test_a_wrong_run_layout_is_refused(tmp_path, changes, message):
    fields = {"t": np.arange(5.0), "y": np.ones((3, 5)), "u": np.ones((4, 5))} | changes
    scipy.io.savemat(tmp_path / "wrong.mat", {k: v for k, v in fields.items() if v is not ...})
    with pytest.raises(ValueError, match=message):
        read_koopman_struct(tmp_path / "wrong.mat")


# The card

def test_a_card_turns_millimetres_into_displacements_in_metres(tmp_path):
    dataset = readers.custom(csv_card(tmp_path))
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
    write_csv(tmp_path / "a.csv", ["run", "y_0", "y_1", "y_2"], np.c_[run, table])
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["y"] = np.loadtxt(tmp_path / "a.csv", delimiter=",", skiprows=1)[:, 1:]
        file["run"], file["note"] = run, "x"
    card = {"columns": {"run": "run", "observation": ["y_0", "y_1", "y_2"]}, "sampling_time": 10,
            "units": {"length": "mm", "time": "ms"}, "rest": [0, 0, 0], "decays": ["a:1"],
            "split": {"test": ["a:2"]}}
    datasets = []
    for file in ("a.csv", "a.h5"):
        (tmp_path / "card.yaml").write_text(yaml.safe_dump(card | {"files": [file]}))
        datasets.append(readers.custom(tmp_path / "card.yaml"))
    for one, other in zip(*datasets, strict=True):
        np.testing.assert_array_equal(one.observation, other.observation)
        assert (one.kind, one.split, one.name) == (other.kind, other.split, other.name)
        assert one.timestep == pytest.approx(0.01) and one.input.shape == (100, 0)


def test_resting_samples_give_the_rest_position(tmp_path):
    t = 0.01 * np.arange(400)
    moving = np.where(t > 2, 10 * np.sin(5 * (t - 2)), 0.0)
    write_csv(tmp_path / "still.csv", ["t", "x", "y", "z", "u"],
              np.c_[t, np.array([5, -5, 100]) + moving[:, None], np.where(t > 2, 1.0, 0.0)])
    dataset = readers.custom(csv_card(tmp_path, files=["still.csv"], decays=[], split={},
                                      rest="median of resting samples"))
    np.testing.assert_allclose(dataset.rest, [0.005, -0.005, 0.1], atol=1e-5)


@pytest.mark.parametrize(("key", "nearest"), [("file", "files"), ("splits", "split"), ("seam", "seams"),
                                              ("rests", "rest")])
def test_an_unknown_key_of_the_card_is_refused_with_the_nearest(tmp_path, key, nearest):
    with pytest.raises(ValueError, match=f"unknown key '{key}'; did you mean '{nearest}'"):
        readers.custom(csv_card(tmp_path, **{key: []}))


@pytest.mark.parametrize(("changes", "message"), [
    ({"units": {"lenght": "mm"}}, "units has the unknown key 'lenght'; did you mean 'length'"),
    ({"units": {"length": "inch"}}, "units.length is 'inch'"), ({"units": ...}, "the card is "
                                                                                "incomplete.*units"),
    ({"rest": "somewhere"}, "rest is 'somewhere'"), ({"rest": [0, 0]}, "rest has 2 entries for 3"),
    ({"decays": ["release_9"]}, r"decays names the runs \['release_9'\].*do not exist"),
    ({"split": {"tset": ["inputs"]}}, "unknown key 'tset'; did you mean 'test'"),
    ({"decays": []}, "no run is a decay"), ({"sampling_time": 0.01}, "not both"), ({"files": []}, "no files"),
    ({"seams": {"inputs": [900]}}, r"seams \[900\] lie outside the 200 rows"),
    ({"columns": {"time": "t", "observation": ["x", "y", "tip"], "input": ["u"]}}, r"no numeric column "
                                                                                    r"\['tip'\]; it has"),
    ({"timestep": "fast"}, "timestep of the card is 'fast'; expected a number"),
    ({"rest": "median of resting samples"}, "give rest as a vector"),
    ({"minimum_length": 1000}, "no run is left")])
def test_a_wrong_card_is_refused(tmp_path, changes, message):
    path = csv_card(tmp_path, **changes)
    if changes.get("rest") == "median of resting samples":
        path = csv_card(tmp_path, files=["inputs.csv"], decays=[], **changes)
    with pytest.raises(ValueError, match=message):
        readers.custom(path)


def test_a_missing_card_or_file_is_reported(tmp_path):
    with pytest.raises(FileNotFoundError, match="no card at"):
        readers.custom(tmp_path / "card.yaml")
    with pytest.raises(FileNotFoundError, match="absent.csv"):
        readers.custom(csv_card(tmp_path, files=["absent.csv"], decays=[], split={}, rest=[0, 0, 0]))


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
        readers.custom(path)


def edit(path, row, column, value):
    lines = path.read_text().splitlines()
    cells = lines[row + 1].split(",")
    cells[column] = value
    lines[row + 1] = ",".join(cells)
    path.write_text("\n".join(lines))


def test_rows_with_empty_cells_are_refused_or_split_the_run(tmp_path):
    path = csv_card(tmp_path)
    edit(tmp_path / "inputs.csv", 80, 2, "")
    with pytest.raises(ValueError, match=r"inputs: 1 of 200 rows are not finite, the first are rows \[80\]"):
        readers.custom(path)
    parts = readers.custom(csv_card_keeping(tmp_path, missing="split")).select("test")
    assert [(p.name, p.length) for p in parts] == [("inputs/0", 80), ("inputs/1", 119)]


def csv_card_keeping(folder, **changes):
    card = yaml.safe_load((folder / "card.yaml").read_text()) | changes
    (folder / "card.yaml").write_text(yaml.safe_dump(card))
    return folder / "card.yaml"


@pytest.mark.parametrize(("value", "word"), [("0.79", "repeats"), ("0.5", "goes back")])
def test_time_that_does_not_increase_is_refused(tmp_path, value, word):
    path = csv_card(tmp_path)
    edit(tmp_path / "inputs.csv", 80, 0, value)
    with pytest.raises(ValueError, match=f"inputs: time {word} at row 80"):
        readers.custom(path)


@pytest.mark.parametrize(("declared", "likely"), [("m", "cm or mm"), ("mm", "m")])
def test_lengths_in_another_unit_than_declared_are_refused_naming_the_likely_one(tmp_path, declared, likely):
    path = csv_card(tmp_path, units={"length": declared, "input": "mN"})
    if declared == "mm":
        for name in ("release_1", "release_2", "inputs"):
            table = np.loadtxt(tmp_path / f"{name}.csv", delimiter=",", skiprows=1)
            table[:, 1:4] *= 1e-3
            write_csv(tmp_path / f"{name}.csv", ["t", "x", "y", "z", "u"], table)
    with pytest.raises(ValueError, match=f"when the columns are read in {declared}.*look like .*{likely}"):
        readers.custom(path)


def test_declared_and_found_seams_cut_the_run(tmp_path):
    path = csv_card(tmp_path, seams={"inputs": [50]})
    assert [p.length for p in readers.custom(path).select("test")] == [50, 150]
    path = csv_card(tmp_path)
    table = np.loadtxt(tmp_path / "inputs.csv", delimiter=",", skiprows=1)
    table[120:, 1:4] += 15
    table[160:, 0] += 0.05
    write_csv(tmp_path / "inputs.csv", ["t", "x", "y", "z", "u"], table)
    dataset = readers.custom(path)
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
        dataset = readers.custom(csv_card(tmp_path))
    text = json.dumps(dataset.provenance)
    assert str(tmp_path) not in text
    assert all(len(digest) == 64 for digest in dataset.provenance["sources"].values())
    assert all(sentence in caplog.text for sentence in dataset.provenance["assumptions"])


def test_a_stored_dataset_is_read_back(tmp_path):
    written = readers.custom(csv_card(tmp_path))
    read = readers.stored(written.save(tmp_path / "runs.h5"))
    np.testing.assert_array_equal(read[0].read().observation, written[0].observation)
    assert read.provenance == written.provenance


# The published files

def glued_diamond(folder, seam=3686, count=3900, scale=1.0):
    rng = np.random.default_rng(0)
    t = 0.01 * np.arange(count)
    y = 10 * np.stack([np.sin(3 * t), np.cos(2 * t), np.sin(t)], axis=1) + 1e-3 * rng.normal(size=(count, 3))
    y[seam:] = y[seam:][:, [1, 2, 0]] + 15
    inputs = 1000 * rng.uniform(size=(count, 4))
    cells = object_array([(a, scale * b.T) for a, b in [decay(), decay(90)]])
    scipy.io.savemat(folder / "controlled.mat", {"t": t, "y": scale * y, "u": inputs})
    scipy.io.savemat(folder / "decays.mat", {"oData": cells, "y_eq": np.zeros((1, 3))})


def test_a_simulated_diamond_is_cut_at_its_known_seam(tmp_path):
    glued_diamond(tmp_path)
    dataset = readers.diamond_simulated(tmp_path, static=False)
    controlled = dataset.select(kind="controlled")
    assert [(d.length, d.split) for d in controlled] == [(3686, "train"), (214, "test")]
    assert max(d.input.max() for d in controlled) <= 1.0


def test_a_simulated_diamond_with_another_seam_is_refused(tmp_path):
    glued_diamond(tmp_path, seam=3000)
    with pytest.raises(ValueError, match=r"seams found before rows \[3000\], expected before rows \[3686\]"):
        readers.diamond_simulated(tmp_path, static=False)


def test_a_simulated_diamond_in_metres_is_refused(tmp_path):
    glued_diamond(tmp_path, scale=1e-3)
    with pytest.raises(ValueError, match="read in mm.*look like .*m"):
        readers.diamond_simulated(tmp_path, static=False)


@pytest.mark.parametrize("read", [readers.trunk_hardware, readers.diamond_hardware, readers.diamond_simulated,
                                  readers.trunk_simulated])
def test_a_missing_directory_is_reported(tmp_path, read):
    with pytest.raises(FileNotFoundError, match="no directory"):
        read(tmp_path / "absent")


@needs_data
def test_the_trunk_hardware_has_37_long_decays_that_end_at_zero():
    dataset = readers.trunk_hardware(DATA / "trunk_hardware")
    decays = dataset.select("train", "decay")
    assert len(decays) == 37 and len(dataset.provenance["shorter_than_minimum"]) == 3
    assert max(np.abs(np.median(d.observation[-10:], axis=0)).max() for d in decays) < 1e-12
    assert [(d.name, d.length) for d in dataset.select("test")] == [("controlled_2", 8900)]
    np.testing.assert_allclose(dataset.rest[-3:], [0.103, -0.315, 0.095], atol=5e-3)


@needs_data
def test_the_diamond_hardware_is_on_a_grid_of_10_ms():
    dataset = readers.diamond_hardware(DATA / "diamond_hardware")
    assert len(dataset.select("train", "decay")) == 34 and len(dataset.select("test", "decay")) == 5
    assert {round(d.timestep, 9) for d in dataset} == {0.01}
    assert np.abs(dataset.select("test", "controlled")[0].observation[-100:]).max() < 1e-3
    raw = read_ssmlearn_cells(DATA / "diamond_hardware" / "decays.mat")
    np.testing.assert_allclose(dataset[0].observation[0], 1e-3 * raw[0][1][0, -3:], atol=1e-12)


@needs_data
def test_the_irregular_calibration_run_is_refused_with_its_numbers():
    with pytest.raises(ValueError, match=r"intervals from 0\.005632 to 0\.15 s.*mean 0\.03569"):
        readers.diamond_hardware(DATA / "diamond_hardware", train_share=1.0,
                                 controlled="calibration_irregular.mat",
                                 rest=[-0.63e-3, -0.34e-3, 110.12e-3])


@needs_data
@pytest.mark.parametrize(("read", "name", "train", "test"), [
    (readers.diamond_simulated, "diamond_simulated", 3686, 5006),
    (readers.trunk_simulated, "trunk_simulated", 6005, 1106)])
def test_the_simulated_robots_are_cut_at_their_seam_and_have_100_set_points(read, name, train, test):
    dataset = read(DATA / name)
    assert [d.length for d in dataset.select("train", "controlled")] == [train]
    assert [d.length for d in dataset.select("test", "controlled")] == [test]
    assert len(dataset.select(kind="static")) == 100
    assert all(np.ptp(d.input, axis=0).max() == 0 for d in dataset.select(kind="static"))


@needs_data
@pytest.mark.parametrize(("file", "count"), [("von_karman_beam_decay", 2), ("sloshing_decay", 3),
                                             ("resonant_double_beam_decay", 12)])
def test_the_standard_examples_of_the_field_are_read(file, count):
    cells = read_ssmlearn_cells(DATA / "generic" / f"{file}.mat")
    assert len(cells) == count
    assert all(len(t) == len(y) and (np.diff(t) > 0).all() and np.isfinite(y).all() for t, y in cells)


@pytest.mark.parametrize("name", readers.__all__)
def test_the_configuration_spells_out_every_argument_with_its_default(name):
    path = Path(__file__).resolve().parents[2] / "conf" / "data" / f"{name}.yaml"
    config = yaml.safe_load(path.read_text())
    assert config.pop("_target_") == f"ssmr_torch.data.readers.{name}"
    parameters = inspect.signature(getattr(readers, name)).parameters
    assert list(config) == list(parameters)
    for key, parameter in parameters.items():
        default = parameter.default
        if default is inspect.Parameter.empty:
            assert config[key] == "???", key
        else:
            assert config[key] == (list(default) if isinstance(default, tuple) else default), key


def test_a_dataset_is_what_every_reader_returns(tmp_path):
    assert isinstance(readers.custom(csv_card(tmp_path)), TrajectoryDataset)
