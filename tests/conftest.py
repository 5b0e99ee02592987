"""Seeds, one thread, where the real measurements are, forged artifacts, the benchmark's oscillators, and the wheel."""

import hashlib
import importlib.util
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from safetensors import safe_open
from safetensors.numpy import load_file, save_file

from ssmr_torch import configuration
from ssmr_torch.data.windows import SegmentDataset
from ssmr_torch.fitting.exact import ExactSolve

configuration.register()
ROOT = Path(__file__).resolve().parents[1]
MEASUREMENTS = Path(os.environ.get("SSMR_TORCH_DATA", ROOT.parent / "shared" / "data"))
BENCHMARK = ROOT / "experiments" / "benchmarks" / "control_step.py"


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
        (directory / "card.json").write_text(json.dumps(card))

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
def bench():
    """The benchmark as a module: `oscillators`, `perturbed`, `ModelPlant`, `BOUNDS`, `measure`."""
    spec = importlib.util.spec_from_file_location("control_step", BENCHMARK)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


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
