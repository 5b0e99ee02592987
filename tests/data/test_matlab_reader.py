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
from ssmr_torch.data.card_reader import custom
from ssmr_torch.data.matlab_reader import read_koopman_struct, read_ssmlearn_cells
from ssmr_torch.data.stored_trajectories import stored

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
    ({"y": np.ones((3, 5))}, r"contains \['y'\]; expected a cell array"),
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


@needs_data
@pytest.mark.parametrize(("file", "count"), [("von_karman_beam_decay", 2), ("sloshing_decay", 3),
                                             ("resonant_double_beam_decay", 12)])
def test_the_standard_examples_of_the_field_are_read(file, count):
    cells = read_ssmlearn_cells(DATA / "generic" / f"{file}.mat")
    assert len(cells) == count
    assert all(len(t) == len(y) and (np.diff(t) > 0).all() and np.isfinite(y).all() for t, y in cells)


@pytest.mark.parametrize("reader", [stored, custom])
def test_the_composed_configuration_spells_out_every_argument_with_its_default(reader):
    config = OmegaConf.to_container(composed("train", [f"data={reader.__name__}"]).data)
    assert config.pop("_target_") == f"{reader.__module__}.{reader.__name__}"
    parameters = inspect.signature(reader).parameters
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
        custom(tmp_path / "card.yaml")
    (tmp_path / "card.yaml").write_text(yaml.safe_dump(card | {"interval_range": [1e-5, 0.1]}))
    assert custom(tmp_path / "card.yaml").timestep == pytest.approx(np.median(np.diff(time)), rel=1e-3)
