"""Multiruns on the processes that a launcher of Hydra starts, from any folder and without PYTHONPATH."""

import csv
import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow
SSMR = Path(sys.executable).with_name("ssmr")


def ssmr(at: Path, *arguments: str) -> None:
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"} | {"OMP_NUM_THREADS": "1"}
    done = subprocess.run([SSMR, *arguments], cwd=at, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    at = tmp_path_factory.mktemp("elsewhere")
    ssmr(at, "collect", "excitation.decays.count=12", "excitation.validation_decays=1", "excitation.test_decays=1",
         "excitation.decay_duration=2.0", "excitation.progress=false", "workers=1", "hydra.run.dir=collect")
    return at


@pytest.mark.parametrize(("launcher", "module", "options"), [
    ("submitit_local", "hydra_submitit_launcher", ["hydra.launcher.timeout_min=10"]),
    ("joblib", "hydra_joblib_launcher", ["hydra.launcher.n_jobs=2"])])
def test_models_are_trained_side_by_side(recorded, launcher, module, options):
    pytest.importorskip(f"hydra_plugins.{module}")
    ssmr(recorded, "train", "-m", "model=sssr,dmd", "data.path=collect/trajectories.h5", f"hydra/launcher={launcher}",
         *options, "trainer.enable_progress_bar=false", "figures=false", "logger=csv", f"hydra.sweep.dir={launcher}")
    with open(recorded / launcher / "sweep.csv", newline="") as file:
        jobs = {row["job"]: row["model"] for row in csv.DictReader(file)}
    assert {jobs["0"], jobs["1"]} == {"SSSR", "DMD"}
    assert len(list((recorded / launcher).glob("*/model.ckpt"))) == 2
