"""The wheel alone, outside the checkout: from a plant to a controlled robot, by the command that it installs."""

import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from omegaconf import OmegaConf

ROOT = Path(__file__).resolve().parents[1]

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory):
    """A folder with the wheel's content, and the environment of a process that sees the package there."""
    target = tmp_path_factory.mktemp("installed")
    subprocess.run([sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--target", target, wheel],
                   check=True)
    return target, os.environ | {"PYTHONPATH": str(target), "OMP_NUM_THREADS": "1"}


@pytest.fixture(scope="module")
def line(installed, tmp_path_factory):
    """collect → train → export → evaluate → control → report with the slow manifold, in an empty folder."""
    target, environment = installed
    at = tmp_path_factory.mktemp("outside")

    def ssmr(*arguments):
        done = subprocess.run([target / "bin" / "ssmr", *arguments], cwd=at, env=environment, capture_output=True,
                              text=True)
        assert done.returncode == 0, done.stdout + done.stderr

    ssmr("collect", "excitation.decays.count=12", "excitation.validation_decays=0", "excitation.test_decays=1",
         "excitation.decay_duration=2.0", "excitation.progress=false", "workers=1", "hydra.run.dir=collect")
    ssmr("train", "model=ssmr", "data.path=collect/trajectories.h5", "trainer.enable_progress_bar=false",
         "hydra.run.dir=train")
    ssmr("export", "checkpoint=train/model.ckpt", "artifact=artifact")
    ssmr("evaluate", "artifact=artifact", "data.path=collect/trajectories.h5", "kind=controlled", "starts=100",
         "hydra.run.dir=evaluate")
    ssmr("control", "artifact=artifact", "task.laps=1", "progress=false", "hydra.run.dir=control")
    ssmr("report", "directory=.", "hydra.run.dir=report")
    return at


def test_every_module_and_every_configuration_is_in_the_wheel(wheel):
    inside = set(zipfile.ZipFile(wheel).namelist())
    places = {"ssmr_torch": "ssmr_torch", "conf": "ssmr_torch/conf", "experiments": "ssmr_torch/experiments"}
    wanted = {f"{place}/{path.relative_to(ROOT / folder).as_posix()}" for folder, place in places.items()
              for path in (ROOT / folder).rglob("*") if path.is_file() and "__pycache__" not in path.parts}
    scripts_of_the_checkout = ("hydra_plugins/",)
    wanted = {name for name in wanted
              if not name.removeprefix("ssmr_torch/experiments/").startswith(scripts_of_the_checkout)}
    assert wanted | {"hydra_plugins/search_sweeper.py"} <= inside
    assert {name.split("/")[0] for name in inside if ".dist-info" not in name} == {"ssmr_torch", "hydra_plugins"}


def test_the_package_that_runs_is_the_wheels(installed, line):
    target, environment = installed
    code = ("import hydra_plugins.search_sweeper as plugin, ssmr_torch, ssmr_torch.conf as conf, "
            "ssmr_torch.experiments.train as train; print(plugin.__file__, ssmr_torch.__file__, conf.__file__, "
            "train.__file__, sep='\\n')")
    places = subprocess.run([sys.executable, "-c", code], cwd=line, env=environment, capture_output=True, text=True,
                            check=True).stdout.splitlines()
    assert len(places) == 4 and all(Path(place).is_relative_to(target) for place in places)
    sources = OmegaConf.load(line / "train" / ".hydra" / "hydra.yaml").hydra.runtime.config_sources
    assert str(target / "ssmr_torch" / "conf") in [source.path for source in sources]


def test_the_line_runs_from_the_wheel_alone_and_its_controller_tracks(line):
    scores = json.loads((line / "evaluate" / "scores.json").read_text())["scores"]
    at_200_ms = {name: score["horizons"][1]["mean"] for name, score in scores.items()}
    assert at_200_ms["SSMR"] < 0.3 * at_200_ms["constant velocity"]
    metrics = json.loads((line / "control" / "metrics.json").read_text())
    assert metrics["rmse"] < 1e-3 and metrics["fallbacks"] == 0
    assert (line / "report.html").is_file()


def test_what_a_command_leaves_lies_in_outputs_of_the_working_directory(line):
    assert len(list((line / "outputs" / "export").iterdir())) == 1
