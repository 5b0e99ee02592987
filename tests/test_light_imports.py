"""What runs alone imports little: seen by a fresh interpreter that has nothing else."""

import subprocess
import sys
from pathlib import Path

import pytest

ONLY = """
import sys
class Only:
    def find_spec(self, name, path=None, target=None):
        top = name.partition('.')[0]
        if top not in sys.stdlib_module_names and top not in {allowed!r}:
            raise ModuleNotFoundError(f'{{name}} is not among what may be imported', name=name)
sys.meta_path.insert(0, Only())
"""
ROBOT = {"numpy", "numba", "llvmlite", "safetensors", "proxsuite", "cmeel"}


def failure_with_only(allowed: set[str], code: str) -> str:
    """What a fresh interpreter complains of that has the standard library, the package and `allowed`; else empty."""
    text = ONLY.format(allowed={*allowed, "ssmr_torch"}) + code
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, cwd=Path(__file__).parents[1])
    return done.stderr if done.returncode else ""


def test_what_may_not_be_imported_is_not_there():
    assert "torch is not among" in failure_with_only({"numpy"}, "import torch")
    assert not failure_with_only({"numpy"}, "import numpy")


@pytest.mark.parametrize(("allowed", "modules"), [
    (set(), ["", "status", "provenance"]),
    (ROBOT, ["deployment.artifact", "control.mpc", "control.kalman_observers", "control.designed",
             "control.disturbance_observer", "control.solvers.proxqp", "wire.runner", "tasks.references"]),
    ({"numpy", "safetensors", "zmq"}, ["wire.runner", "wire.serving", "wire.link", "wire.robot_end"]),
    ({"numpy", "safetensors"}, ["deployment.exported_programs"]),
    ({"numpy"}, ["evaluation.open_loop", "evaluation.metrics"]),
    (ROBOT | {"h5py", "tqdm", "scipy"}, ["closed_loop.simulation", "trajectory", "plants.slow_manifold", "plants.trunk",
                                         "plants.emulated_rig"]),
], ids=["the package", "a robot", "the wire", "export in C", "scores", "a simulation"])
def test_what_runs_alone_needs_no_more_than_this(allowed, modules):
    """Neither Torch, Lightning, Hydra, wandb, matplotlib nor scikit-learn, unless it is named here."""
    names = [f"ssmr_torch.{module}".rstrip(".") for module in modules]
    assert not failure_with_only(allowed, f"import {', '.join(names)}")
