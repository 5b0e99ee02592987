"""Robots that no default was made on: what is chosen from the data does not diverge, and nothing is better.

Short recordings of 72 s, made here, of the robots that are simulated fast enough; or those of five minutes, and of all
robots, in the folder SSMR_TORCH_ROBOTS, as `ssmr benchmark robots folder=FOLDER` keeps them.
"""

import os
from pathlib import Path

import pytest

import ssmr_torch as ssmr
from ssmr_torch.benchmarks import robots

PACKAGES = {"tendon_chain": "mujoco", "cosserat_rod": "elastica", "pressure_arm": "numba", "isupport": "soromox",
            "planar_hsa": "soromox"}
RECORDED_HERE = ("tendon_chain", "pressure_arm", "planar_hsa")  # a minute of the others takes minutes to simulate
RIVALS = ("dmd", "edmd_relift", "edmd_bilinear", "ssmr_control_augmented")


@pytest.fixture(scope="module", params=PACKAGES)
def found(request):
    """The comparison of one robot, by defaults."""
    robot, folder = request.param, os.environ.get("SSMR_TORCH_ROBOTS")
    path = None if folder is None else Path(folder) / robot / "trajectories.h5"
    if path is None or not path.is_file():
        if robot not in RECORDED_HERE:
            pytest.skip(f"a recording of {robot} takes minutes; set SSMR_TORCH_ROBOTS to a folder that has one")
        pytest.importorskip(PACKAGES[robot], reason="the extra robots is not installed")
    data = ssmr.load(path) if path is not None and path.is_file() else robots.recorded(robot, short=True)
    return ssmr.compare(data, ["auto", *RIVALS], progress=False)


@pytest.mark.slow
def test_nothing_that_is_chosen_diverges_in_any_group(found):
    assert {"smooth-test", "double-speed-test", "mpc-test", "decays"} <= set(found.groups)
    assert {name: found.diverged(name) for name in found.models} == dict.fromkeys(found.models, 0.0)


@pytest.mark.slow
def test_the_chosen_model_is_best_or_tied_over_every_horizon_of_every_group(found):
    assert found.behind("AUTO") == dict.fromkeys(found.groups, []), found


@pytest.mark.slow
def test_the_summary_has_a_row_for_the_robot(found):
    row = robots.row("robot", found)
    assert row["robot"] == "robot" and row["best baseline, 1 s"].split()[-1] in found.models
    assert 0 < row["50 ms, mm"] < row["1 s, mm"]
