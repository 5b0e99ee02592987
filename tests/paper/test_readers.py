"""The recordings that the paper's authors published: cut at their known boundaries, in SI units."""

import inspect
import os
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from omegaconf import OmegaConf

from ssmr_torch.configuration import composed
from ssmr_torch.data.matlab_reader import read_ssmlearn_cells
from ssmr_torch.paper import readers

DATA = Path(os.environ.get("SSMR_TORCH_DATA", Path(__file__).resolve().parents[3] / "shared" / "data"))
needs_data = pytest.mark.skipif(not DATA.is_dir(), reason=f"no measured data at {DATA}")


def glued_diamond(folder, seam=3686, count=3900, scale=1.0):
    rng = np.random.default_rng(0)
    t = 0.01 * np.arange(count)
    y = 10 * np.stack([np.sin(3 * t), np.cos(2 * t), np.sin(t)], axis=1) + 1e-3 * rng.normal(size=(count, 3))
    y[seam:] = y[seam:][:, [1, 2, 0]] + 15
    inputs = 1000 * rng.uniform(size=(count, 4))
    cells = np.empty((2, 2), dtype=object)
    for row, samples in zip(cells, (120, 90)):
        time = 0.01 * np.arange(samples)
        row[:] = time[None], scale * 10 * np.exp(-4 * time) * np.cos(25 * time + np.arange(3)[:, None])
    scipy.io.savemat(folder / "controlled.mat", {"t": t, "y": scale * y, "u": inputs})
    scipy.io.savemat(folder / "decays.mat", {"oData": cells, "y_eq": np.zeros((1, 3))})


def test_a_simulated_diamond_is_cut_at_its_known_seam(tmp_path):
    glued_diamond(tmp_path)
    dataset = readers.authors_simulated_diamond(tmp_path, static=False)
    controlled = dataset.select(kind="controlled")
    assert [(d.length, d.split) for d in controlled] == [(3686, "train"), (214, "test")]
    assert max(d.input.max() for d in controlled) <= 1.0


def test_a_simulated_diamond_with_another_seam_is_refused(tmp_path):
    glued_diamond(tmp_path, seam=3000)
    with pytest.raises(ValueError, match=r"seams were found before rows \[3000\], but expected before rows \[3686\]"):
        readers.authors_simulated_diamond(tmp_path, static=False)


def test_a_simulated_diamond_in_metres_is_refused(tmp_path):
    glued_diamond(tmp_path, scale=1e-3)
    with pytest.raises(ValueError, match="read in mm.*look like .*m"):
        readers.authors_simulated_diamond(tmp_path, static=False)


@pytest.mark.parametrize("read", [readers.real_trunk, readers.real_diamond, readers.authors_simulated_diamond,
                                  readers.authors_simulated_trunk])
def test_a_missing_directory_is_reported(tmp_path, read):
    with pytest.raises(FileNotFoundError, match="no directory"):
        read(tmp_path / "absent")


@needs_data
def test_the_trunk_hardware_has_37_long_decays_that_end_at_zero():
    dataset = readers.real_trunk(DATA / "trunk_hardware")
    decays = dataset.select("train", "decay")
    assert len(decays) == 37 and len(dataset.provenance["shorter_than_minimum"]) == 3
    assert max(np.abs(np.median(d.observation[-10:], axis=0)).max() for d in decays) < 1e-12
    assert [(d.name, d.length) for d in dataset.select("test")] == [("controlled_2", 8900)]
    np.testing.assert_allclose(dataset.rest[-3:], [0.103, -0.315, 0.095], atol=5e-3)


@needs_data
def test_the_diamond_hardware_is_on_a_grid_of_10_ms():
    dataset = readers.real_diamond(DATA / "diamond_hardware")
    assert len(dataset.select("train", "decay")) == 34 and len(dataset.select("test", "decay")) == 5
    assert {round(d.timestep, 9) for d in dataset} == {0.01}
    assert np.abs(dataset.select("test", "controlled")[0].observation[-100:]).max() < 1e-3
    raw = read_ssmlearn_cells(DATA / "diamond_hardware" / "decays.mat")
    np.testing.assert_allclose(dataset[0].observation[0], 1e-3 * raw[0][1][0, -3:], atol=1e-12)


@needs_data
def test_the_irregular_calibration_run_is_refused_with_its_numbers():
    with pytest.raises(ValueError, match=r"intervals from 0\.005632 to 0\.15 s.*mean 0\.03569"):
        readers.real_diamond(DATA / "diamond_hardware", train_share=1.0,
                                 controlled="calibration_irregular.mat",
                                 rest=[-0.63e-3, -0.34e-3, 110.12e-3])


@needs_data
@pytest.mark.parametrize(("read", "name", "train", "test"), [
    (readers.authors_simulated_diamond, "diamond_simulated", 3686, 5006),
    (readers.authors_simulated_trunk, "trunk_simulated", 6005, 1106)])
def test_the_simulated_robots_are_cut_at_their_seam_and_have_100_set_points(read, name, train, test):
    dataset = read(DATA / name)
    assert [d.length for d in dataset.select("train", "controlled")] == [train]
    assert [d.length for d in dataset.select("test", "controlled")] == [test]
    assert len(dataset.select(kind="static")) == 100
    assert all(np.ptp(d.input, axis=0).max() == 0 for d in dataset.select(kind="static"))

@pytest.mark.parametrize("name", readers.__all__)
def test_the_composed_configuration_spells_out_every_argument_with_its_default(name):
    config = OmegaConf.to_container(composed("train", [f"data={name}"]).data)
    assert config.pop("_target_") == f"ssmr_torch.paper.readers.{name}"
    for key, parameter in inspect.signature(getattr(readers, name)).parameters.items():
        default = parameter.default
        assert config.pop(key) == ("???" if default is inspect.Parameter.empty else
                                   list(default) if isinstance(default, tuple) else default), key
    assert not config
