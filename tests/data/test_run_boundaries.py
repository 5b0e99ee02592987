import os
from pathlib import Path

import numpy as np
import pytest

from ssmr_torch.data.matlab_reader import read_koopman_struct
from ssmr_torch.data.run_boundaries import check_seams, find_seams
from ssmr_torch.recording_clocks.gaps import find_time_gaps
from ssmr_torch.recording_files.reading import read_tables

DATA = Path(os.environ.get("SSMR_TORCH_DATA", Path(__file__).resolve().parents[3] / "shared" / "data"))
needs_data = pytest.mark.skipif(not DATA.is_dir(), reason=f"no measured data at {DATA}")
MARKERS = [f"{axis}{i}" for i in (1, 2, 3) for axis in "xyz"]


def swinging(count=600, phase=0.0, noise=1e-5, seed=0):
    t = 0.01 * np.arange(count)
    rng = np.random.default_rng(seed)
    modes = [np.sin(6 * t + phase), np.cos(5 * t + 2 * phase), 0.3 * np.sin(11 * t + phase)]
    y = 0.02 * np.stack(modes, axis=1)
    return y + noise * rng.normal(size=y.shape)


def test_the_seam_between_two_glued_runs_is_found_exactly():
    glued = np.concatenate([swinging(phase=0.0), swinging(phase=2.0, seed=1), swinging(phase=4.0, seed=2)])
    assert find_seams(glued).tolist() == [600, 1200]


def test_the_unit_of_length_does_not_matter():
    glued = np.concatenate([swinging(), swinging(phase=2.0)])
    assert find_seams(1e3 * glued).tolist() == find_seams(glued).tolist() == [600]


def test_one_run_has_no_seam():
    assert not len(find_seams(swinging()))
    assert not len(find_seams(np.zeros((100, 3))))
    assert not len(find_seams(swinging(5)))


@pytest.mark.parametrize("length", [1, 2, 3])
def test_a_camera_error_that_returns_is_not_a_seam(length):
    y = swinging()
    y[300:300 + length] += 0.05
    assert not len(find_seams(y))


def test_a_step_of_the_input_is_not_a_seam():
    t = 0.01 * np.arange(400)
    since = np.maximum(t - 2.0, 0.0)
    step = 0.05 * (1 - np.exp(-3 * since) * (np.cos(30 * since) + 0.1 * np.sin(30 * since)))
    assert not len(find_seams(step[:, None]))


def test_lost_time_is_a_gap():
    time = 0.01 * np.arange(20)
    time[7:] += 0.05
    assert find_time_gaps(time).tolist() == [7]


def test_a_file_whose_seams_differ_from_the_known_ones_is_refused():
    check_seams(np.array([5]), [5], "file")
    with pytest.raises(ValueError, match=r"seams were found before rows \[4\], but expected before rows \[5\]"):
        check_seams(np.array([4]), [5], "file")


@needs_data
@pytest.mark.parametrize(("file", "seams"), [
    ("diamond_simulated/controlled.mat", [3686]), ("trunk_simulated/controlled.mat", [1106]),
    ("diamond_simulated/static.mat", []), ("trunk_simulated/static.mat", []),
    ("diamond_hardware/controlled_2022.mat", []), ("diamond_hardware/controlled_2023.mat", []),
    ("diamond_hardware/static_2023.mat", []), ("diamond_hardware/calibration_irregular.mat", [])])
def test_the_seams_of_the_measured_matlab_files_are_the_known_ones(file, seams):
    assert find_seams(read_koopman_struct(DATA / file)["y"]).tolist() == seams


@needs_data
@pytest.mark.parametrize("run", ["controlled_1", "controlled_2", "beta_controlled_200g"])
def test_the_measured_trunk_runs_have_no_seam(run):
    path = DATA / "trunk_hardware" / f"observations_{run}.csv"
    assert not len(find_seams(read_tables(path)[0].numbers(MARKERS, path.name)))


@needs_data
def test_glued_decays_of_the_trunk_are_cut_only_between_decays():
    path = DATA / "trunk_hardware" / "observations_manual_decay_200g.csv"
    table = read_tables(path)[0]
    between = (np.flatnonzero(np.diff(table.numbers(["ID"], path.name)[:, 0])) + 1).tolist()
    assert find_seams(table.numbers(MARKERS, path.name)).tolist() == between
