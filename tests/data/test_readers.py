import inspect
import os
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io
import yaml
from omegaconf import OmegaConf

from ssmr_torch.configuration import composed
from ssmr_torch.data import readers
from ssmr_torch.data.matlab import read_koopman_struct, read_ssmlearn_cells

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


@pytest.mark.parametrize("read", [read_ssmlearn_cells, read_koopman_struct])
def test_a_truncated_matlab_file_is_refused_with_the_remedy(tmp_path, read):
    path = tmp_path / "cut.mat"
    write_cells_v73(path, [decay(500)])
    path.write_bytes(path.read_bytes()[:4000])
    with pytest.raises(ValueError, match="cut.mat cannot be read .*truncated.*copy or record it again"):
        read(path)


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
def test_the_composed_configuration_spells_out_every_argument_with_its_default(name):
    config = OmegaConf.to_container(composed("train", [f"data={name}"]).data)
    assert config.pop("_target_") == f"ssmr_torch.data.readers.{name}"
    parameters = inspect.signature(getattr(readers, name)).parameters
    assert set(config) == set(parameters)
    for key, parameter in parameters.items():
        default = parameter.default
        if default is inspect.Parameter.empty:
            assert config[key] == "???", key
        else:
            assert config[key] == (list(default) if isinstance(default, tuple) else default), key


@needs_data
def test_a_standard_example_sampled_every_95_microseconds_needs_its_own_interval_range(tmp_path):
    time, observation = read_ssmlearn_cells(DATA / "generic" / "von_karman_beam_decay.mat")[0]
    assert np.median(np.diff(time)) < 1e-4
    table = np.c_[time, 1e-2 * observation[:, :1] / np.abs(observation[:, 0]).max(), 0 * time]
    np.savetxt(tmp_path / "beam.csv", table, delimiter=",", header="t,y,u", comments="", fmt="%.12g")
    card = {"files": ["beam.csv"], "columns": {"time": "t", "observation": ["y"], "input": ["u"]},
            "units": {"length": "m"}, "rest": [0], "decays": ["beam"], "seams": {}}
    (tmp_path / "card.yaml").write_text(yaml.safe_dump(card))
    with pytest.raises(ValueError, match="interval_range"):
        readers.custom(tmp_path / "card.yaml")
    (tmp_path / "card.yaml").write_text(yaml.safe_dump(card | {"interval_range": [1e-5, 0.1]}))
    assert readers.custom(tmp_path / "card.yaml").timestep == pytest.approx(np.median(np.diff(time)), rel=1e-3)
