"""The environment of a robot, made by a line of the installation page: small, and enough for an artifact to control."""

import json
import os
import re
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

from ssmr_torch.closed_loop.simulation import simulate
from ssmr_torch.deployment import artifact
from ssmr_torch.plants.slow_manifold import SlowManifold
from ssmr_torch.wire.runner import build

ROOT = Path(__file__).resolve().parents[1]
LARGEST = 460  # MB, of all that the line installs
LIMIT = 120.0  # s after which a process is killed, so that no test hangs
ITSELF = ("pip", "setuptools", "pkg_resources", "_distutils_hack", "distutils-precedence")  # of venv, not of the line

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def light(wheel, tmp_path_factory):
    """A fresh environment after `pip install 'ssmr_torch[wire]'` of the wheel, as docs/installation.md shows it."""
    assert "| `pip install 'ssmr_torch[wire]'` |" in (ROOT / "docs" / "installation.md").read_text()
    at = tmp_path_factory.mktemp("light")
    subprocess.run([sys.executable, "-m", "venv", at], check=True)
    subprocess.run([at / "bin" / "pip", "install", "--quiet", f"{wheel}[wire]"], check=True)
    return at


@pytest.fixture(scope="module")
def shipped(trial, tmp_path_factory):
    """An artifact with the names of the slow manifold, and the settings that `ssmr serve-controller` writes for it."""
    plant, at = SlowManifold(), tmp_path_factory.mktemp("shipped")
    artifact.save(at / "artifact", trial.oscillators(), output_names=plant.output_names,
                  input_names=plant.input_names, rest=plant.rest, input_range=plant.input_bounds)
    subprocess.run([Path(sys.executable).with_name("ssmr"), "serve-controller", "artifact=artifact", "task=letter",
                    "controller=scp_trunk", "runs=0", "bind=tcp://127.0.0.1:*", "hydra.run.dir=serve"], cwd=at,
                   check=True)
    return at


def python(light, *arguments, cwd):
    alone = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    return subprocess.Popen([light / "bin" / "python", *map(str, arguments)], cwd=cwd, env=alone,
                            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def output(process):
    said, complained = process.communicate(timeout=LIMIT)
    assert process.returncode == 0, complained
    return said


def megabytes(light):
    [packages] = light.glob("lib/python*/site-packages")
    return sum(path.lstat().st_blocks * 512 for path in packages.rglob("*")
               if not path.relative_to(packages).parts[0].startswith(ITSELF)) / 2**20


def test_the_light_environment_is_small(light):
    assert 100 < megabytes(light) <= LARGEST


def test_it_holds_what_an_artifact_needs_and_neither_torch_nor_hydra(light, tmp_path):
    found = json.loads(output(python(light, "-m", "pip", "list", "--format=json", cwd=tmp_path)))
    names = {each["name"].lower() for each in found} - {"pip", "setuptools"}
    # SciPy and cmeel come with proxsuite, llvmlite with numba.
    assert names == {"numpy", "numba", "llvmlite", "safetensors", "proxsuite", "cmeel", "scipy", "pyzmq", "ssmr_torch"}


def test_an_artifact_predicts_and_controls_in_it(light, shipped, tmp_path):
    code = f"""
import numpy as np, ssmr_torch
from ssmr_torch.control.mpc import ModelPredictiveController
from ssmr_torch.plants.slow_manifold import SlowManifold
from ssmr_torch.tasks.references import figure_eight
assert not ssmr_torch.__file__.startswith({str(ROOT)!r})
model, plant = ssmr_torch.load({str(shipped / "artifact")!r}), SlowManifold()
inputs = np.tile([0.3, 0.0, 0.0, 0.0], (20, 1))
predicted = model.predict(np.zeros((model.delays + 1, len(plant.output_names))), inputs)
controller = ModelPredictiveController(model.reduced, figure_eight(tracked=("tip_x", "tip_y")), plant.input_bounds,
                                       output_names=plant.output_names)
command = controller(0.0, np.zeros(len(plant.output_names)))
assert predicted.shape == (20, len(plant.output_names)) and np.abs(predicted[-1]).max() > 1e-3
assert (plant.input_bounds[0] <= command.input).all() and (command.input <= plant.input_bounds[1]).all()
print(command.fallback)
"""
    assert output(python(light, "-c", code, cwd=tmp_path)) == "None\n"


def test_what_is_missing_in_it_is_named_with_its_extra(light, tmp_path):
    refused = subprocess.run([light / "bin" / "ssmr", "train"], cwd=tmp_path, capture_output=True, text=True)
    assert refused.returncode == 1 and "pip install 'ssmr_torch[train]'" in refused.stderr
    process = python(light, "-c", "import ssmr_torch; ssmr_torch.trajectories", cwd=tmp_path)
    assert "pip install 'ssmr_torch[data]'" in process.communicate(timeout=LIMIT)[1]


def test_the_example_of_the_wire_is_steered_by_the_runner_through_a_letter(light, shipped, tmp_path):
    [example] = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "wire.md").read_text(), flags=re.DOTALL)
    runner = python(light, "-m", "ssmr_torch.wire.runner", shipped / "artifact", "--settings",
                    shipped / "serve" / "settings.json", "--bind", "tcp://127.0.0.1:*", "--runs", 1, cwd=tmp_path)
    watchdog = threading.Timer(LIMIT, runner.kill)
    watchdog.start()
    line = runner.stdout.readline()
    assert "tcp://" in line, line + runner.stderr.read()
    (tmp_path / "robot.py").write_text(f"""
import numpy as np
from ssmr_torch.plants.slow_manifold import SlowManifold
plant = SlowManifold()
positions, TIMESTEP, SAFE_INPUT = [plant.reset()], plant.timestep, [0.0] * 4
DESCRIPTION = {{"name": plant.name, "output_names": list(plant.output_names), "timestep": TIMESTEP,
               "input_names": list(plant.input_names), "rest": plant.rest.tolist(),
               "input_bounds": plant.input_bounds.tolist()}}
measure = lambda: positions[-1]
apply = lambda u: positions.append(plant.step(np.array(u)))
{example.replace("tcp://127.0.0.1:5555", line.split()[-1])}
np.save("positions.npy", positions)
""")
    output(python(light, "robot.py", cwd=tmp_path))
    watchdog.cancel()
    assert "run 1: 1001 samples, {}" in output(runner)
    written = json.loads((shipped / "serve" / "settings.json").read_text())
    plant, task = SlowManifold(), build(written["task"])
    controller = build(written["controller"], artifact.load(shipped / "artifact").model, task, plant.input_bounds,
                       timestep=plant.timestep, output_names=plant.output_names)
    alone = simulate(plant, controller, task).observation
    np.testing.assert_allclose(np.load(tmp_path / "positions.npy")[:len(alone)], alone, rtol=0, atol=1e-7)
