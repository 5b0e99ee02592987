"""Seeds, one thread, where the real measurements are, forged artifacts, the benchmarks' oscillators, and the wheel."""

import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg
import torch
from safetensors import safe_open
from safetensors.numpy import load_file, save_file

from ssmr_torch import configuration
from ssmr_torch.benchmarks import tracking_instance
from ssmr_torch.checksum import sealed_json
from ssmr_torch.control.actuator import Actuator
from ssmr_torch.control.designed import DesignedController
from ssmr_torch.control.disturbance_observer import DisturbanceObserver
from ssmr_torch.control.mpc_settings import PredictiveControlSettings
from ssmr_torch.data.windows import SegmentDataset
from ssmr_torch.fitting.closed_form_fit import ExactSolve

# A shell starts what runs in the background with these two ignored, and the tests of signals are about them.
for number, handler in ((signal.SIGINT, signal.default_int_handler), (signal.SIGHUP, signal.SIG_DFL)):
    if signal.getsignal(number) == signal.SIG_IGN:
        signal.signal(number, handler)

configuration.register()
ROOT = Path(__file__).resolve().parents[1]
MEASUREMENTS = Path(os.environ.get("SSMR_TORCH_DATA", ROOT.parent / "shared" / "data"))


@pytest.fixture(autouse=True)
def reproducible():
    torch.manual_seed(0)
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


@pytest.fixture
def measurements():
    """Path of a real data file or folder; the test is skipped where the data are not at hand."""

    def locate(name: str) -> Path:
        path = MEASUREMENTS / name
        if not path.exists():
            pytest.skip(f"the real measurements {name} are not at hand (set SSMR_TORCH_DATA to their folder)")
        return path

    return locate


@pytest.fixture
def rewrite():
    """Change arrays of an artifact's file, or what it notes of the model, and the card's hash of it: what a hash alone
    would not notice.
    """
    def change(directory, file="tables.safetensors", *, arrays=lambda arrays: None, noted=lambda noted: None):
        path, card = directory / file, json.loads((directory / "card.json").read_text())
        with safe_open(path, "np") as opened:
            metadata = opened.metadata()
        tables = load_file(path)
        arrays(tables)
        if metadata and "model" in metadata:
            model = json.loads(metadata["model"])
            noted(model)
            metadata["model"] = json.dumps(model)
        save_file(tables, path, metadata)
        card["sha256"][file] = hashlib.sha256(path.read_bytes()).hexdigest()
        (directory / "card.json").write_text(sealed_json(card))

    return change


@pytest.fixture
def solve_stages():
    """Run the stages of a closed-form procedure over trajectories, without a trainer."""

    def solve(procedure, trajectories, *, stages=None, ridge=0.0, rows=1024, transient=0.0):
        for stage in stages or procedure.stages:
            solver = ExactSolve(procedure.model.parameters(), ridge)
            for segment in SegmentDataset(trajectories, before=procedure.before, after=procedure.after, rows=rows,
                                          transient=transient):
                for name, found in procedure.regressions(segment, stage).items():
                    solver.accumulate(name, found.features, found.targets, (segment.trajectory + segment.index) % 5)
            solver.step()
            procedure.assign(stage, solver.solutions)
        return procedure.model

    return solve


@pytest.fixture(scope="session")
def trial():
    """The tracking problem of the benchmarks as a module: `oscillators`, `perturbed`, `ModelPlant`, `BOUNDS`, …"""
    return tracking_instance


@pytest.fixture(scope="session")
def by_hand(trial):
    """(task, **settings) → a `DesignedController` of the benchmark's oscillators, as a design makes one: delay, lag,
    friction and gains of the actuator, the stationary observer, weights in ranges.
    """
    model, outputs, span = trial.oscillators(), [f"y{k}" for k in range(6)], np.ptp(trial.BOUNDS, axis=0)
    A, B, _ = model.linearize(np.zeros(6), np.full(4, 0.2))
    G, H = scipy.linalg.block_diag(A, np.eye(6)), np.hstack([np.eye(6), np.eye(6)])
    process = scipy.linalg.block_diag(1e-4 * B @ B.T + 1e-12 * np.eye(6), 1e-10 * np.eye(6))
    P = scipy.linalg.solve_discrete_are(G.T, H.T, process, 1e-9 * np.eye(6))
    S = H @ P @ H.T + 1e-9 * np.eye(6)
    observer = partial(DisturbanceObserver, gain=np.linalg.solve(S, H @ P).T, covariance=S, limit=0.03, lost=0.005,
                       watched=(0, 1))
    actuator = Actuator(0.01, tuple(span), delay=2, lag=0.01, friction=0.05, gain=(1.0, 0.97, 1.0, 1.02))
    settings = PredictiveControlSettings(
        horizon=8, period=0.01, output_weight=1e9, input_weight=1.0, move_weight=40.0, huber=1e-4, observer=observer,
        actuator=actuator, approach=0.5, input_target=(0.1,) * 4)
    card = {"name": "oscillators", "output_names": outputs, "input_names": ["left", "right", "up", "down"],
            "input_unit": "N", "rest": [0.1] * 6, "input_range": trial.BOUNDS.tolist(), "sampling_time": 0.01}
    facts = {"tuned": "designed from 2.5 min of recordings", "minutes": 2.5, "reach": 0.02, "task": "figure eight"}

    def make(task=None, **changes):
        task = trial.figure_eight(laps=1.0, amplitude=0.005, tracked=("y0", "y1")) if task is None else task
        return DesignedController(model, task, trial.BOUNDS, settings.changed(**changes), timestep=0.01,
                                  output_names=outputs, facts=facts, card=card)

    return make


@pytest.fixture(scope="session")
def wheel(tmp_path_factory):
    """The package's wheel, built from a copy of its sources, so that nothing is left in the checkout."""
    sources, built = tmp_path_factory.mktemp("sources"), tmp_path_factory.mktemp("built")
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, sources)
    for name in ("ssmr_torch", "conf", "experiments"):
        shutil.copytree(ROOT / name, sources / name, ignore=shutil.ignore_patterns("__pycache__"))
    subprocess.run([sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", built, sources],
                   check=True)
    [path] = built.glob("*.whl")
    return path
