"""The paper from one command, in miniature, through processes of its own: whole, killed and resumed, with a failure."""

import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import h5py
import pytest
from omegaconf import OmegaConf

from ssmr_torch.closed_loop.record import ClosedLoopRecord
from ssmr_torch.configuration import composed
from ssmr_torch.paper.jobs import plan, with_recordings

ROOT = Path(__file__).resolve().parents[2]
CONF, SCRIPT = ROOT / "conf", ROOT / "experiments" / "reproduce.py"
PRESETS = sorted(path.stem for path in (CONF / "preset").glob("*.yaml"))
UNSTEADY = {"solve_median", "solve_p99", "real_time", "fit_time"}  # wall times


def start(*arguments: str) -> subprocess.CompletedProcess:
    return subprocess.run([sys.executable, str(SCRIPT), "preset=miniature", *arguments], capture_output=True, text=True)


def reproduce(directory: Path, *arguments: str) -> str:
    done = start(f"hydra.run.dir={directory}", *arguments)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def rows(path: Path) -> list[dict]:
    """Of a table, without what a clock says; runs at a longer period, which a clock has asked for, are left out."""
    with open(path, newline="") as file:
        found = [row for row in csv.DictReader(file) if row.get("period", "0.02") == "0.02"]
    return [{name: value for name, value in row.items() if name not in UNSTEADY} for row in found]


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    for module in ("hydra_plugins.hydra_joblib_launcher", "daqp"):
        pytest.importorskip(module, reason="needs pip install 'ssmr_torch[parallel,daqp]'")
    directory = tmp_path_factory.mktemp("whole")
    reproduce(directory)
    return directory


@pytest.mark.slow
def test_one_command_leaves_data_models_scores_closed_loops_tables_and_the_report(whole):
    assert (whole / "report.html").is_file() and (whole / "delays" / "trunk" / "delays.json").is_file()
    assert {(row["robot"], row["method"]) for row in rows(whole / "models.csv")} == {
        ("trunk", "SSMR"), ("trunk", "SSSR"), ("trunk", "DMD"), ("emulated_bench", "SSSR"),
        ("emulated_bench", "static pregain")}
    runs = rows(whole / "runs.csv")
    assert {figure: sum(row["figure"] == figure for row in runs) for figure in ("fig7", "fig9", "fig11")} == {
        "fig7": 3, "fig9": 6, "fig11": 2}
    for row in runs:
        assert ClosedLoopRecord.load(whole / row["record"]).provenance["model"] == row["method"]
        assert (row["violation_ratio"] != "") == (row["figure"] == "fig9")
    with h5py.File(whole / "open_loop" / "trunk.h5") as file:
        assert set(file["error"]) == {"SSMR", "SSSR", "DMD"} and file["position"].shape == (50, 3)
        assert all(errors.shape == (50,) for errors in file["error"].values())
    assert not (whole / "unfinished").exists()


@pytest.mark.slow
def test_the_same_command_runs_nothing_twice(whole):
    before = {path: path.stat().st_mtime_ns for path in (whole / "jobs").rglob("*.json")}
    products = {path: path.stat().st_mtime_ns for pattern in ("*.h5", "*.ckpt", "metrics.json")
                for path in whole.rglob(pattern)}
    reproduce(whole)
    assert before == {path: path.stat().st_mtime_ns for path in (whole / "jobs").rglob("*.json")}
    assert all(path.stat().st_mtime_ns == then for path, then in products.items())


@pytest.mark.slow
def test_killed_and_resumed_it_finds_the_same_numbers_to_the_last_digit(whole, tmp_path):
    command = [sys.executable, str(SCRIPT), "preset=miniature", f"hydra.run.dir={tmp_path}"]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True)
    while process.poll() is None and len(list((tmp_path / "models").rglob("card.json"))) < 2:
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    kept = {path: path.stat().st_mtime_ns for path in (tmp_path / "jobs" / "data").rglob("*.json")}
    assert len(kept) == 2 and not (tmp_path / "runs.csv").exists()
    reproduce(tmp_path, "launcher=basic")
    assert all(path.stat().st_mtime_ns == then for path, then in kept.items())
    for table in ("models.csv", "runs.csv"):
        assert rows(tmp_path / table) == rows(whole / table)
    for path in (whole / "models").rglob("card.json"):
        again = tmp_path / path.relative_to(whole)
        assert json.loads(again.read_text())["sha256"] == json.loads(path.read_text())["sha256"]


@pytest.mark.slow
def test_interrupted_it_leaves_no_process_behind(tmp_path):
    process = subprocess.Popen([sys.executable, str(SCRIPT), "preset=miniature", f"hydra.run.dir={tmp_path}"],
                               stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, start_new_session=True)

    def running() -> list[str]:
        found = subprocess.run(["ps", "-ww", "-o", "args=", "-s", str(process.pid)], capture_output=True, text=True)
        return found.stdout.splitlines()

    def wait_until(condition) -> bool:
        until = time.monotonic() + 120
        while not condition() and time.monotonic() < until:
            time.sleep(0.2)
        return condition()

    assert wait_until(lambda: any("LokyProcess" in line for line in running()))
    process.send_signal(signal.SIGINT)
    assert "ended by a signal; the same command goes on" in process.communicate()[1]
    assert process.returncode != 0 and wait_until(lambda: not running()), running()


@pytest.mark.slow
def test_a_failing_job_is_reported_and_missing_and_stops_no_other(whole, tmp_path):
    elsewhere = tmp_path / "a copy"
    shutil.copytree(whole, elsewhere)
    done = start(f"hydra.run.dir='{elsewhere}'", "+preset.train.DMD=['model.timestep=0.013']", "figures=[fig5,fig7]",
                 "launcher=basic")
    assert done.returncode == 1 and "models/trunk/DMD: " in done.stderr and "Traceback" not in done.stderr
    assert "1 jobs were left out" in done.stderr
    assert [row["method"] for row in rows(elsewhere / "runs.csv") if row["figure"] == "fig7"] == ["SSMR", "SSSR"]
    assert "DMD" not in {row["method"] for row in rows(elsewhere / "models.csv")}
    kept = [path for path in (elsewhere / "runs" / "fig7").rglob("metrics.json") if "DMD" not in str(path)]
    assert len(kept) >= 2 and all(
        path.stat().st_mtime_ns == (whole / path.relative_to(elsewhere)).stat().st_mtime_ns for path in kept)


@pytest.mark.slow
@pytest.mark.parametrize(("arguments", "message"), [
    (["figures=fig13"], "figures is 'fig13'; expected all or some of table1, fig3"),
    (["launcher.module=hydra_plugins.nowhere"], "nowhere is not installed: pip install 'ssmr_torch[parallel]'"),
    (["recordings=nowhere"], "recordings=nowhere is no folder; expected the one with the bench's decays.mat"),
    (["preset.figures.fig7.robot=snake"], "no robot 'snake'; the settings have trunk, emulated_bench"),
])
def test_bad_input_ends_in_one_clear_message_before_any_work(tmp_path, arguments, message):
    done = start(*arguments, f"hydra.run.dir={tmp_path}")
    assert done.returncode != 0 and message in done.stderr and "Traceback" not in done.stderr, done.stderr
    assert not (tmp_path / "jobs").exists()


@pytest.mark.parametrize("launcher", sorted(path.stem for path in (CONF / "launcher").glob("*.yaml")))
def test_every_launcher_names_a_plugin_and_how_to_get_it(launcher):
    config = composed("reproduce", [f"launcher={launcher}", "workers=3"])
    chosen = OmegaConf.to_container(config.launcher, resolve=True)
    assert set(chosen) == {"plugin", "module", "install", "settings"}
    assert launcher in chosen["plugin"] and (3 in chosen["settings"].values()) == (launcher != "basic")


@pytest.mark.slow
@pytest.mark.parametrize("preset", PRESETS)
def test_every_job_of_every_preset_composes(preset, tmp_path):
    settings = OmegaConf.to_container(composed("reproduce", [f"preset={preset}"]).preset, resolve=True)
    assert settings["name"] == preset
    for jobs in plan(with_recordings(settings, str(tmp_path))).values():
        for step in (step for job in jobs if job.about.get("seed", 0) == 0 for step in job.steps):
            composed(step.entry, step.overrides)


def test_the_quick_preset_makes_every_figure_of_the_paper():
    for preset in ("quick", "paper"):
        figures = composed("reproduce", [f"preset={preset}"]).preset.figures
        assert list(figures) == ["table1", *(f"fig{number}" for number in range(3, 13))]
