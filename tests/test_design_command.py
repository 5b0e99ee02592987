"""ssmr design: recordings → an artifact that carries its controller, which ssmr control then runs."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import ssmr_torch as ssmr
from ssmr_torch import command
from ssmr_torch.controller_design.design import Designed

SSMR = Path(sys.executable).with_name("ssmr")


class Report:
    """What a design found, as far as the command shows it."""

    sentences = ("The actuators: none.",)
    facts = {"predicted_error": 1e-3, "model_error": 2e-3, "actuator_error": None, "reach": 0.02, "minutes": 2.5,
             "seconds": 1.0}

    def save(self, folder, *, figures):
        (folder / "design.md").write_text(f"figures: {figures}\n")


@pytest.fixture
def recorded(tmp_path):
    """Two short runs of something with the outputs of the slow manifold's tip."""
    time, rng = 0.01 * np.arange(50), np.random.default_rng(0)
    runs = [(time, 1e-3 * rng.normal(size=(50, 3)), rng.uniform(0, 1, (50, 4))) for _ in range(2)]
    data = ssmr.trajectories(controlled=runs, output_names=["tip_x", "tip_y", "tip_z"], range=(0.0, 1.0))
    return data.save(tmp_path / "recorded.h5")


def run(monkeypatch, tmp_path, *arguments):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.argv", ["ssmr", "design", "data.path=recorded.h5", "hydra.run.dir=out", *arguments])
    return command.main()


@pytest.mark.parametrize("given", [[], ["plant=slow_manifold", "bounds=[[0],[1]]"]], ids=["neither", "both"])
def test_bounds_come_from_the_plant_or_are_given(recorded, monkeypatch, tmp_path, given):
    with pytest.raises(SystemExit, match="design: give either plant=NAME, whose bounds hold, or bounds="):
        run(monkeypatch, tmp_path, *given)


def test_options_of_a_model_are_refused_as_kinds_are_fitted_by_their_defaults(recorded, monkeypatch, tmp_path):
    with pytest.raises(SystemExit, match="design: model.state_dim=4 is given, and a kind of model is fitted by its"):
        run(monkeypatch, tmp_path, "plant=slow_manifold", "model=ssmr", "model.state_dim=4")


@pytest.mark.parametrize("given", [["plant=slow_manifold"], ["bounds=[[0,0,0,0],[1.5,1.5,1.5,1.5]]"]],
                         ids=["plant", "bounds"])
def test_the_design_is_asked_with_data_task_and_bounds_and_all_is_written(recorded, by_hand, monkeypatch, tmp_path,
                                                                        capsys, given):
    asked = []

    def design(model, data, task, bounds, progress):
        asked.append((model, data.output_names, task.name, np.array(bounds).tolist()))
        return Designed(by_hand(), Report())

    monkeypatch.setattr("ssmr_torch.controller_design.design.design", design)
    assert run(monkeypatch, tmp_path, "task=circle", "model=dmd", "figures=false", *given) == 0
    assert asked == [("dmd", ("tip_x", "tip_y", "tip_z"), "circle", [[0.0] * 4, [1.5] * 4])]
    assert "figures: False" in (tmp_path / "out" / "design.md").read_text()
    assert ssmr.load(tmp_path / "out" / "artifact").controller().facts["minutes"] == 2.5
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    assert result["metrics"]["predicted_error"] == 1e-3 and result["metrics"]["actuator_error"] is None
    assert "The actuators: none." in capsys.readouterr().out


@pytest.mark.slow
def test_recordings_become_a_controller_that_traces_another_task(tmp_path):
    def ssmr_(*arguments):
        done = subprocess.run([SSMR, *arguments], cwd=tmp_path, capture_output=True, text=True, timeout=300)
        assert done.returncode == 0, done.stderr[-2000:]
        return done.stdout

    ssmr_("collect", "plant=slow_manifold", "excitation=five_minutes", "hydra.run.dir=collect")
    said = ssmr_("design", "data.path=collect/trajectories.h5", "plant=slow_manifold", "task=circle",
                 "task.amplitude=0.008", "outputs=[tip_x,tip_y,tip_z]", "hydra.run.dir=design")
    assert "DesignReport for 'circle'" in said
    assert {"design.md", "design.json", "sensitivity.png", "twin.png"} <= {
        path.name for path in (tmp_path / "design").iterdir()}
    said = ssmr_("control", "artifact=design/artifact", "controller=designed", "task=rose", "task.amplitude=0.008",
                 "hydra.run.dir=control")
    metrics = json.loads((tmp_path / "control" / "metrics.json").read_text())
    assert metrics["rmse"] < 1e-4 and metrics["fallbacks"] == 0 and 0.1 < metrics["speed"] < 2.0
    assert metrics["tuned"].startswith("designed from") and "of the first natural frequency" in said
    refused = subprocess.run([SSMR, "control", "artifact=design/artifact", "controller=designed", "task=rose",
                              "task.tracked=[tip_x,tip_z]", "hydra.run.dir=refused"], cwd=tmp_path,
                             capture_output=True, text=True)
    assert refused.returncode == 1 and "was designed to track ['tip_x', 'tip_y']" in refused.stderr
