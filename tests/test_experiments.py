"""The line end to end, through its commands."""

import contextlib
import csv
import io
import json
import os
import subprocess
import sys
import time
import warnings
from pathlib import Path
from typing import NamedTuple

import pytest

from ssmr_torch import command, found_settings
from ssmr_torch.closed_loop.record import ClosedLoopRecord
from ssmr_torch.deployment import artifact
from ssmr_torch.search.multirun_table import baselines
from ssmr_torch.trajectory import TrajectoryDataset

SSMR = Path(sys.executable).with_name("ssmr")
SMALL = ["excitation.decays.count=20", "excitation.validation_decays=1", "excitation.test_decays=1",
         "excitation.decay_duration=2.0", "excitation.progress=false"]
QUIET = ["trainer.enable_progress_bar=false"]


class Ended(NamedTuple):
    returncode: int
    stdout: str
    stderr: str


def start(name: str, *arguments: str, cwd: Path) -> Ended:
    """`ssmr NAME …` in this process, which has loaded Torch already; the process is left as it was."""
    said, complained, before = io.StringIO(), io.StringIO(), (sys.argv, sys.path[:], dict(os.environ))
    try:
        with contextlib.chdir(cwd), contextlib.redirect_stdout(said), contextlib.redirect_stderr(complained), \
                warnings.catch_warnings():
            warnings.simplefilter("default")
            sys.argv = ["ssmr", name, *map(str, arguments)]
            status = command.main()
    except SystemExit as end:
        status = end.code if isinstance(end.code, int) else 1
        complained.write("" if isinstance(end.code, int) else str(end.code))
    finally:
        sys.argv, sys.path[:] = before[:2]
        os.environ.clear()
        os.environ.update(before[2])
    return Ended(status, said.getvalue(), complained.getvalue())


def run(name: str, *arguments: str, cwd: Path) -> str:
    done = start(name, *arguments, cwd=cwd)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def run_alone(*arguments: str, cwd: Path) -> None:
    """`ssmr …` in a process of its own."""
    done = subprocess.run([SSMR, *arguments], cwd=cwd, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.fixture(scope="module")
def line(tmp_path_factory):
    """collect → train (a sweep) → export → evaluate → control (a sweep) → report, in miniature."""
    at = tmp_path_factory.mktemp("line")
    run("collect", *SMALL, "hydra.run.dir=collect", cwd=at)
    run("train", "-m", "model=ssmr,sssr", "data.path=collect/trajectories.h5", *QUIET, "hydra.sweep.dir=train", cwd=at)
    run("export", "-m", "checkpoint=train/0/model.ckpt,train/1/model.ckpt", "hydra.sweep.dir=export", cwd=at)
    both = ["export/0/artifact", "export/1/artifact"]
    run("evaluate", f"artifact=[{','.join(both)}]", "data.path=collect/trajectories.h5", "kind=controlled",
        "starts=200", "outputs=[tip_x,tip_y,tip_z]", "hydra.run.dir=evaluate", cwd=at)
    run("control", "-m", f"artifact={','.join(both)}", "task.laps=2", "progress=false", "hydra.sweep.dir=control",
        cwd=at)
    run("report", "directory=.", "hydra.run.dir=report", cwd=at)
    return at


TRUNK = ["plant=trunk_coarse", "rig.noise_std=1e-5"]


@pytest.fixture(scope="module")
def trunk_line(tmp_path_factory):
    """The same on the finite-element trunk, with an interruption after the first kept trajectories."""
    at = tmp_path_factory.mktemp("trunk")
    short = ["excitation=trunk", "excitation.decays=8", "excitation.validation_decays=0", "excitation.test_decays=1",
             "excitation.decay_duration=1.5", "excitation.progress=false", "hydra.run.dir=collect"]
    process = subprocess.Popen([SSMR, "collect", *TRUNK, *short], cwd=at,
                               stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while process.poll() is None and len(list(at.glob("collect/recorded/*.h5"))) < 2:
        time.sleep(0.05)
    process.kill()
    process.wait()
    kept = {path: path.stat().st_mtime_ns for path in at.glob("collect/recorded/*.h5")}
    run("collect", *TRUNK, *short, cwd=at)
    run("train", "robot=trunk", "model=sssr", "settings=found", "data.path=collect/trajectories.h5", *QUIET,
        "hydra.run.dir=train", cwd=at)
    run("export", "checkpoint=train/model.ckpt", "artifact=artifact", "hydra.run.dir=export", cwd=at)
    run("control", *TRUNK, "artifact=artifact", "controller=scp_trunk", "task=letter", "task.duration=4.0",
        "task.half_size=0.008", "progress=false", "animate=true", "hydra.run.dir=control", cwd=at)
    run("report", "directory=.", "hydra.run.dir=report", cwd=at)
    return at, kept


@pytest.mark.slow
def test_a_killed_collection_goes_on_where_it_was_and_leaves_one_file(trunk_line):
    at, kept = trunk_line
    assert len(kept) >= 2 and not list(at.glob("collect/recorded/*"))
    dataset = TrajectoryDataset.load(at / "collect" / "trajectories.h5")
    assert len(dataset.select(kind="decay")) == 9 and dataset.timestep == pytest.approx(0.01)
    assert dataset.provenance["plant"]["origin"]["nodes"] == 457
    slowest = complex(*dataset.provenance["eigenvalues"][0])
    assert -2 < slowest.real < -1 and 9 < abs(slowest.imag) < 12


@pytest.mark.slow
def test_the_trunk_writes_a_letter_and_the_report_shows_it(trunk_line):
    at, _ = trunk_line
    metrics = json.loads((at / "control" / "metrics.json").read_text())
    assert metrics["rmse"] < 0.8e-3 and metrics["fallbacks"] == 0
    assert (at / "control" / "robot.gif").read_bytes().startswith(b"GIF")
    page = (at / "report.html").read_text()
    assert "path of its tip so far" in page and "stiffness_scale" in page


@pytest.mark.slow
def test_the_line_learns_a_model_that_beats_its_linear_counterpart_and_the_baselines(line):
    scores = json.loads((line / "evaluate" / "scores.json").read_text())["scores"]
    mean = {name: [part["mean"] for part in score["horizons"][:3]] for name, score in scores.items()}
    assert set(mean) == {"SSMR", "SSSR", "persistence", "constant velocity"}
    for horizon in range(3):
        assert mean["SSMR"][horizon] < 0.5 * mean["SSSR"][horizon]
        assert mean["SSSR"][horizon] < 0.6 * mean["constant velocity"][horizon]
    assert all(part["diverged"] == 0 for part in scores["SSMR"]["horizons"])


@pytest.mark.slow
def test_the_controller_tracks_the_figure_eight_on_the_plant_with_the_exported_artifact(line):
    for job, name in ((0, "SSMR"), (1, "SSSR")):
        record = ClosedLoopRecord.load(line / "control" / str(job) / "record.h5")
        metrics = json.loads((line / "control" / str(job) / "metrics.json").read_text())
        assert record.provenance["model"] == name
        assert record.provenance["artifact"] == artifact.load(line / "export" / str(job) / "artifact").card["sha256"]
        assert metrics["rmse"] < 0.8e-3 and metrics["fallbacks"] == 0


@pytest.mark.slow
def test_the_trunk_goes_around_obstacles_with_an_observer_margins_and_another_solver(trunk_line):
    pytest.importorskip("daqp", reason="needs pip install 'ssmr_torch[daqp]'")
    at, _ = trunk_line
    text = run("control", *TRUNK, "artifact=artifact", "controller=scp_trunk", "task=stanford_obstacles", "qp=daqp",
               "task.duration=4.0", "task.half_size=0.008", "progress=false",
               "observer@controller.observer=output_disturbance", "residuals=collect/trajectories.h5",
               "quantile=0.5", "hydra.run.dir=obstacles", cwd=at)
    metrics = json.loads((at / "obstacles" / "metrics.json").read_text())
    assert "margins: " in text and metrics["max_violation"] < 1e-3 and metrics["fallbacks"] == 0
    assert 0 <= metrics["violation_ratio"] < 0.2 and metrics["rmse"] < 3e-3


@pytest.mark.slow
def test_a_sweep_ends_with_a_table_of_its_jobs_best_first(line):
    with open(line / "train" / "sweep.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["job"] for row in rows] == ["0", "1"]
    assert float(rows[0]["validation/rmse"]) < float(rows[1]["validation/rmse"])
    assert "model=ssmr" in rows[0]["overrides"]


def test_a_sweeps_table_shows_the_baselines_that_its_jobs_were_scored_beside():
    row = {"job": "0", "model": "SSMR", "validation/rmse": 0.001, "validation/rmse_persistence": 0.02,
           "validation/rmse_constant_velocity": 0.05}
    assert baselines(row) == [{"job": "–", "model": "persistence", "validation/rmse": 0.02},
                              {"job": "–", "model": "constant velocity", "validation/rmse": 0.05}]
    assert baselines({"job": "0", "ISE": 1.0}) == []


@pytest.mark.slow
def test_the_report_holds_tables_and_figures_and_nothing_from_outside(line):
    page = (line / "report.html").read_text()
    assert page.count("<svg") >= 9 and page.count("<table") >= 4
    assert "src=" not in page and "@import" not in page
    for word in ("SSMR", "SSSR", "persistence", "constant velocity", "ISE"):
        assert word in page


@pytest.mark.slow
def test_the_same_seed_gives_the_same_scores_to_the_last_digit(line):
    run_alone("train", "model=ssmr", "data.path=collect/trajectories.h5", *QUIET, "hydra.run.dir=again", cwd=line)
    first, again = (json.loads((line / at / "result.json").read_text())["metrics"] for at in ("train/0", "again"))
    assert first == again


@pytest.mark.slow
def test_training_resumes_as_it_was_begun_and_can_be_refined_by_rollouts(line):
    same = ["model=ssmr", "data.path=collect/trajectories.h5", *QUIET, "module.stride=40", "hydra.run.dir=refined"]
    run("train", *same, cwd=line)
    before = json.loads((line / "refined" / "result.json").read_text())["metrics"]
    run("train", *same, "fit=rollout", "fit.refinement.epochs=2", "resume=true", cwd=line)
    after = json.loads((line / "refined" / "result.json").read_text())["metrics"]
    assert after["validation/rmse"] <= before["validation/rmse"]
    assert (line / "refined" / "checkpoints" / "refinement" / "best.ckpt").is_file()
    changed = start("train", *same, "model.delays=2", "resume=true", cwd=line)
    assert "was started with model.delays=1, but now it is 2" in changed.stderr and "Traceback" not in changed.stderr
    elsewhere = start("train", *same[:-1], "resume=true", "hydra.run.dir=elsewhere", cwd=line)
    assert "there are no checkpoints below" in elsewhere.stderr


@pytest.mark.slow
def test_a_job_that_fails_leaves_the_rest_of_its_sweep_and_the_table(line):
    done = start("train", "-m", "model.state_dim=99,6", "data.path=collect/trajectories.h5", *QUIET,
                 "hydra.sweep.dir=sweep", cwd=line)
    assert done.returncode == 1 and "train: 1 of 2 jobs failed" in done.stderr and "Traceback" not in done.stderr
    assert "\njob 0: a window of" in done.stderr and "fewer than the 99 reduced coordinates" in done.stderr
    with open(line / "sweep" / "sweep.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["job"] for row in rows] == ["1", "0"] and float(rows[0]["validation/rmse"]) > 0
    assert "fewer than the 99 reduced coordinates" in rows[1]["failed"]


@pytest.mark.slow
def test_a_search_goes_on_where_it_was_never_sees_the_test_runs_and_leaves_the_best_settings(line):
    pytest.importorskip("optuna", reason="needs pip install 'ssmr_torch[search]'")
    command = ["train", "-m", "search=sssr", "data.path=collect/trajectories.h5", "module.starts=100",
               "hydra.sweep.dir=search"]
    run(*command, "hydra.sweeper.n_trials=3", cwd=line)
    before = {path: path.stat().st_mtime_ns for path in line.glob("search/*/result.json")}
    assert "trial 5 of 5" in run(*command, "hydra.sweeper.n_trials=5", cwd=line)
    assert len(before) == 3 and all(path.stat().st_mtime_ns == then for path, then in before.items())
    with open(line / "search" / "sweep.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert {row["job"] for row in rows} == set("01234") and len({row["overrides"] for row in rows}) == 5
    scores = [float(row["validation/relative"]) for row in rows]
    assert scores == sorted(scores) and not any(column.startswith("test/") for column in rows[0])
    row = found_settings.read(line / "search" / "found.yaml")["models"]["sssr"]
    assert f"model.state_dim={row['settings']['model']['state_dim']}" in rows[0]["overrides"]
    ridge = row["settings"]["fit"]["closed_form"]["ridge"]["default"]
    assert f"fit.closed_form.ridge.default={ridge}" in rows[0]["overrides"]
    assert row["found"]["score"] == pytest.approx(scores[0], rel=1e-3) and row["found"]["trials"] == 5
    assert row["found"]["command"].startswith("ssmr train -m search=sssr data.path=collect/trajectories.h5")
    assert (line / "search" / "sweep.svg").is_file()
    short = run(*command[:-1], "hydra.sweep.dir=short", "search_minutes=1.0e-3", cwd=line)
    assert "the 0.001 CPU minutes are over after 1 trials" in short
    changed = start(*command, "model.delays=3", cwd=line)
    assert "now it is ['model.delays=3']" in changed.stderr and "Traceback" not in changed.stderr


@pytest.mark.slow
def test_a_controller_is_searched_on_a_task_of_its_own_and_its_best_settings_are_an_option(line):
    pytest.importorskip("optuna", reason="needs pip install 'ssmr_torch[search]'")
    run("control", "-m", "search=controller/scp_observer", "artifact=export/0/artifact", "hydra.sweeper.n_trials=3",
        "task.amplitude=0.008", "save_to=mine/found/own.yaml", "hydra.sweep.dir=controllers", cwd=line)
    with open(line / "controllers" / "sweep.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [float(row["ise"]) for row in rows] == sorted(float(row["ise"]) for row in rows) and len(rows) == 3
    row = found_settings.read(line / "mine" / "found" / "own.yaml")["controllers"]["ssmr"]
    assert (row["controller"], row["observer"]) == ("scp", "output_disturbance")
    settings = row["settings"]
    assert f"controller.input_weight={settings['input_weight']}" in rows[0]["overrides"]
    assert f"controller.observer.measurement_noise={settings['observer']['measurement_noise']}" in rows[0]["overrides"]
    said = run("control", "--config-dir", "mine", "controller=own/ssmr", "artifact=export/0/artifact", "task.laps=1",
               "progress=false", "picture=false", "hydra.run.dir=own", cwd=line)
    assert said.splitlines()[0].startswith("found settings: row controllers.ssmr of ")
    assert json.loads((line / "own" / "result.json").read_text())["found"]["row"] == "controllers.ssmr"


@pytest.mark.slow
def test_a_model_of_the_tip_controls_a_robot_that_shows_more(trunk_line):
    at, _ = trunk_line
    run("train", "robot=trunk", "model=sssr", "settings=found", "data.path=collect/trajectories.h5", *QUIET,
        "outputs=[tip_x,tip_y,tip_z]", "model.delays=4", "hydra.run.dir=tip", cwd=at)
    run("export", "checkpoint=tip/model.ckpt", "artifact=tip_artifact", "formats=[]", "hydra.run.dir=tip_export",
        cwd=at)
    run("control", *TRUNK, "artifact=tip_artifact", "controller=scp_trunk", "task=letter", "task.duration=4.0",
        "task.half_size=0.008", "progress=false", "hydra.run.dir=tip_control", cwd=at)
    record = ClosedLoopRecord.load(at / "tip_control" / "record.h5")
    assert record.observation.shape[1] == 3 and (at / "tip_control" / "robot.svg").is_file()
    assert json.loads((at / "tip_control" / "metrics.json").read_text())["rmse"] < 4e-3


@pytest.mark.slow
def test_a_study_ends_with_a_table_and_a_figure_of_its_scores(line):
    quick = [*QUIET, "data.path=collect/trajectories.h5", "module.starts=100", "figures=false"]
    run("train", "-m", "study=decays", "model=ssmr,sssr", "module.decays=3,20", *quick, "hydra.sweep.dir=decays",
        cwd=line)
    with open(line / "decays" / "study.csv", newline="") as file:
        rows = {(row["model"], row["module.decays"]): float(row["1 s"]) for row in csv.DictReader(file)}
    assert len(rows) == 4 and rows["SSMR", "20.0"] < rows["SSMR", "3.0"] < rows["SSSR", "20.0"]
    run("collect", "excitation=amplitude", "excitation.progress=false", "hydra.run.dir=amplitude", cwd=line)
    run("train", "-m", "study=amplitude", "model=ssmr", "study.runs=amplitude/trajectories.h5", *quick,
        "hydra.sweep.dir=amplitudes", cwd=line)
    with open(line / "amplitudes" / "study.csv", newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["model"] == "SSMR"]
    assert [row["run"] for row in rows] == [f"share-{share}-0" for share in (0.25, 0.5, 0.75, 1.0)]
    assert float(rows[0]["1 s"]) < float(rows[1]["1 s"]) < float(rows[3]["1 s"])
    assert (line / "decays" / "study.svg").is_file() and (line / "amplitudes" / "study.svg").is_file()


@pytest.mark.slow
def test_the_delay_study_takes_the_record_of_a_closed_loop(line):
    text = run("delay_study", "data.path=collect/trajectories.h5", "record=control/0/record.h5",
               "manifold.delays=[2,8]", "hydra.run.dir=delays", cwd=line)
    rows = json.loads((line / "delays" / "delays.json").read_text())["rows"]
    assert [(row["delays"], row["reparametrized"]) for row in rows] == [(2, False), (2, True), (8, False), (8, True)]
    assert rows[2]["error"] > rows[0]["error"] and rows[2]["error"] > rows[3]["error"] and "reparametrized" in text
    assert (line / "delays" / "delays.svg").is_file()


@pytest.mark.slow
def test_two_processes_started_by_the_entry_point_give_the_scores_of_one(line):
    run_alone("train", "model=ssmr", "data.path=collect/trajectories.h5", *QUIET, "trainer=ddp", "hydra.run.dir=ddp",
              cwd=line)
    alone, both = (json.loads((line / at / "result.json").read_text())["metrics"] for at in ("train/0", "ddp"))
    assert both == pytest.approx(alone, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "arguments", "message"), [
    ("train", ["data.path=nowhere.h5"], "no trajectory file at"),
    ("train", ["data.path=collect/trajectories.h5", "outputs=[nose]"], r"no outputs ['nose']; the dataset has"),
    ("train", ["data.path=collect/trajectories.h5", "model.state_dim=13"], "fewer than the 13 reduced coordinates"),
    ("train", ["data.path=collect/trajectories.h5", "model.state_dim=many"], "expected an integer"),
    ("train", ["data.path=collect/trajectories.h5", "fit.closed_form.calibration=both"], "expected one of"),
    ("evaluate", ["artifact=collect", "data.path=collect/trajectories.h5"], "no artifact at collect"),
    ("export", [], "give either checkpoint=FILE.ckpt or mat=FILE.mat"),
    ("export", ["checkpoint=collect/trajectories.h5"], "cannot be read as a checkpoint"),
    ("train", ["data.path=collect/trajectories.h5", "metric=test/rmse"], "never by the test runs"),
    ("train", ["data.path=collect/trajectories.h5", "model.chart_degree=2"], "set detection_delays above"),
    ("control", ["artifact=export/0/artifact", "task.tracked=[nose]"], "tracks 'nose'"),
    ("control", ["artifact=export/0/artifact", "residuals=collect/trajectories.h5",
                 "controller.margins=[0.0,0.0,0.0,0.0,0.0]"], "leave controller.margins null"),
    ("report", ["directory=collect"], "nothing to report below"),
    ("collect", ["plant=trunk", "plant.mesh=elephant"], "no mesh file at elephant; give a file, or one of"),
    ("collect", ["plant=trunk", "plant.length_unit=m"], "check the unit of the mesh"),
    ("collect", ["plant=trunk_coarse", "plant.scheme=bdf2"], "use backward_euler with corotational"),
    ("collect", ["plant=trunk_coarse", "rig.sensor_delay=0.015"], "expected a whole multiple"),
    ("collect", ["plant=trunk_coarse", "plant.young=-1"], "plant.young is -1 Pa; expected a number from"),
])
def test_bad_input_ends_in_one_clear_message_before_any_work(line, name, arguments, message):
    done = start(name, *arguments, f"hydra.run.dir=refused-{name}", *(QUIET if name == "train" else []), cwd=line)
    assert done.returncode != 0
    assert message in done.stderr and "Traceback" not in done.stderr, done.stderr
