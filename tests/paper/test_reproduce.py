"""The paper from one command, in miniature: whole, on every executor, killed and resumed, with a failure."""

import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import time
import uuid
from pathlib import Path

import h5py
import pytest

from ssmr_torch.closed_loop.record import ClosedLoopRecord
from ssmr_torch.configuration import composed, plain
from ssmr_torch.paper.jobs import plan

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
    pytest.importorskip("daqp", reason="needs pip install 'ssmr_torch[daqp]'")
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
    products = {path: path.stat().st_mtime_ns for pattern in ("*.h5", "*.ckpt", "metrics.json", "jobs/*/*.log")
                for path in whole.rglob(pattern)}
    reproduce(whole)
    assert all(path.stat().st_mtime_ns == then for path, then in products.items())


EXECUTORS = {"local": ["executor=local"], "joblib": [], "ray": ["executor=ray"],
             "submitit": ["executor=submitit", "executor.cluster=local"]}


@pytest.mark.slow
@pytest.mark.parametrize("executor", ["local", "ray", "submitit"])
def test_the_same_numbers_come_from_every_executor_to_the_last_digit(whole, tmp_path, executor):
    """Those of joblib are there; from the same data, models, open loops and closed loops are made again."""
    if executor != "local":
        pytest.importorskip(executor)
    shutil.copytree(whole / "data", tmp_path / "data")
    (tmp_path / "jobs").mkdir()
    shutil.copy(whole / "jobs" / "done.json", tmp_path / "jobs")
    reproduce(tmp_path, *EXECUTORS[executor], "figures=[fig5,fig7]")
    for table, mine in (("models.csv", lambda row: row["robot"] == "trunk"),
                        ("runs.csv", lambda row: row["figure"] == "fig7")):
        expected = [row for row in rows(whole / table) if mine(row)]
        assert len(expected) == 3 and rows(tmp_path / table) == expected
    scores = [json.loads((place / "open_loop" / "trunk.json").read_text())["scores"] for place in (tmp_path, whole)]
    assert scores[0] == scores[1]


@pytest.mark.slow
def test_killed_and_resumed_it_finds_the_same_numbers_to_the_last_digit(whole, tmp_path):
    command = [sys.executable, str(SCRIPT), "preset=miniature", f"hydra.run.dir={tmp_path}"]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True)
    while process.poll() is None and len(list((tmp_path / "models").rglob("card.json"))) < 2:
        time.sleep(0.05)
    process.kill()
    process.wait()
    kept = {path: path.stat().st_mtime_ns for path in (tmp_path / "data").rglob("trajectories.h5")}
    assert len(kept) == 2 and not (tmp_path / "runs.csv").exists()
    reproduce(tmp_path, "executor=local", "workers=1")
    assert all(path.stat().st_mtime_ns == then for path, then in kept.items())
    for table in ("models.csv", "runs.csv"):
        assert rows(tmp_path / table) == rows(whole / table)
    for path in (whole / "models").rglob("card.json"):
        again = tmp_path / path.relative_to(whole)
        assert json.loads(again.read_text())["sha256"] == json.loads(path.read_text())["sha256"]


@pytest.mark.slow
@pytest.mark.parametrize(("executor", "number"), [
    ("local", signal.SIGINT), ("local", signal.SIGKILL), ("joblib", signal.SIGTERM), ("joblib", signal.SIGKILL),
    ("ray", signal.SIGINT), ("submitit", signal.SIGTERM)])
def test_ended_by_a_signal_it_leaves_no_process_behind(tmp_path, executor, number):
    """submitit's processes outlive a killed command, as jobs of a cluster do, and find that their turn is over."""
    if executor in ("ray", "submitit"):
        pytest.importorskip(executor)
    mark = uuid.uuid4().hex
    command = [sys.executable, str(SCRIPT), "preset=miniature", f"hydra.run.dir={tmp_path}", *EXECUTORS[executor]]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
                               env=os.environ | {"SSMR_TEST_MARK": mark}, start_new_session=True)
    assert wait_until(lambda: list((tmp_path / "jobs").rglob("*/*.log")) or process.poll() is not None)
    assert len(marked(mark)) > 1
    process.send_signal(number)
    said = process.communicate()[1]
    if number == signal.SIGKILL:
        assert process.returncode == -number
    else:
        name = "Ctrl-C" if number == signal.SIGINT else "SIGTERM"
        assert process.returncode == 128 + number and not (tmp_path / "unfinished").exists()
        assert f"ended by {name}; the same command with hydra.run.dir={tmp_path} goes on" in said
        assert "Traceback" not in said or executor == "submitit"  # of submitit's own processes, which Ctrl-C ends
    assert wait_until(lambda: not marked(mark)), marked(mark)


def marked(mark: str) -> list[str]:
    """Commands of the processes that have this in their environment."""
    found = []
    for place in Path("/proc").glob("[0-9]*"):
        try:
            if mark.encode() in (place / "environ").read_bytes():
                found.append((place / "cmdline").read_text().replace("\0", " "))
        except OSError:  # it ended, or is another user's
            continue
    return found


def wait_until(condition) -> bool:
    until = time.monotonic() + 120
    while not condition() and time.monotonic() < until:
        time.sleep(0.2)
    return bool(condition())


@pytest.mark.slow
def test_a_failing_job_is_reported_and_missing_and_stops_no_other(whole, tmp_path):
    elsewhere = tmp_path / "a copy"
    shutil.copytree(whole, elsewhere)
    done = start(f"hydra.run.dir='{elsewhere}'", "+preset.train.DMD=['model.timestep=0.013']", "figures=[fig5,fig7]",
                 "executor=local")
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
    (["executor=submitit", "executor.cluster=moon"], "executor.cluster is 'moon'; expected slurm or local"),
    (["+preset.needs.nowhere='pip install nowhere'"], "nowhere is not installed: pip install nowhere"),
    (["recordings=nowhere"], "recordings=nowhere is no folder; expected the one with decays.mat"),
    (["preset.figures.fig7.robot=snake"], "no robot 'snake'; the settings have trunk, emulated_bench"),
])
def test_bad_input_ends_in_one_clear_message_before_any_work(tmp_path, arguments, message):
    done = start(*arguments, f"hydra.run.dir={tmp_path}")
    assert done.returncode != 0 and message in done.stderr and "Traceback" not in done.stderr, done.stderr
    assert not (tmp_path / "jobs").exists()


@pytest.mark.slow
@pytest.mark.parametrize("preset", PRESETS)
def test_every_job_of_every_preset_composes(preset, tmp_path):
    settings = plain(composed("reproduce", [f"preset={preset}"]).preset)
    assert settings["name"] == preset
    for job in plan(settings, recordings=str(tmp_path)).jobs:
        for step in job.steps if job.about.get("seed", 0) == 0 else ():
            composed(step.entry, step.overrides)


def test_the_quick_preset_makes_every_figure_of_the_paper():
    for preset in ("quick", "paper"):
        figures = composed("reproduce", [f"preset={preset}"]).preset.figures
        assert list(figures) == ["table1", *(f"fig{number}" for number in range(3, 13))]
