"""The runner and the entry points, in processes of their own."""

import json
import subprocess
import sys
import threading
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from ssmr_torch.closed_loop.record import ClosedLoopRecord
from ssmr_torch.closed_loop.simulation import simulate
from ssmr_torch.control.mpc import ModelPredictiveController
from ssmr_torch.control.mpc_settings import PredictiveControlSettings
from ssmr_torch.deployment import artifact
from ssmr_torch.plants.slow_manifold import SlowManifold
from ssmr_torch.tasks.references import figure_eight
from ssmr_torch.wire import runner
from ssmr_torch.wire.link import RobotLink
from ssmr_torch.wire.messages import RobotDescription
from ssmr_torch.wire.robot_end import RobotEnd

EXPERIMENTS = Path(__file__).parents[2] / "experiments"
ABSENT = ("torch", "scipy", "qpsolvers", "matplotlib", "hydra", "omegaconf", "h5py", "tqdm", "lightning", "wandb")
LIMIT = 120.0  # s after which a process is killed, so that no test hangs


@pytest.fixture(scope="module")
def shipped(trial, tmp_path_factory):
    """An artifact with the names of the slow manifold, whose model knows it only roughly."""
    plant = SlowManifold()
    return artifact.save(tmp_path_factory.mktemp("shipped") / "artifact", trial.oscillators(),
                         output_names=plant.output_names, input_names=plant.input_names, rest=plant.rest,
                         input_range=plant.input_bounds)


@pytest.fixture
def settings(tmp_path):
    path = tmp_path / "settings.json"
    path.write_text(json.dumps(runner.DEFAULT | {"task": runner.DEFAULT["task"] | {"laps": 0.7}}))
    return path


@contextmanager
def process(*command, cwd=None):
    """A process and the address that it prints, perhaps after the settings that were found for it."""
    running = subprocess.Popen(list(map(str, command)), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
                               cwd=cwd)
    watchdog = threading.Timer(LIMIT, running.kill)
    watchdog.start()
    try:
        line = running.stdout.readline()
        if "found settings" in line:
            line = running.stdout.readline()
        assert "tcp://" in line, line + running.stderr.read()
        yield running, line.split()[-1]
    finally:
        watchdog.cancel()
        running.kill()
        running.wait()
        running.stdout.close()
        running.stderr.close()


def without(*modules):
    return [sys.executable, "-c", f"import sys\nfor name in {modules!r}: sys.modules[name] = None\n"
                                  "from ssmr_torch.wire import runner\nsys.exit(runner.main(sys.argv[1:]))"]


def test_the_runner_steers_as_one_process_does_without_torch_scipy_hydra_and_the_rest(shipped, settings):
    plant, applied = SlowManifold(), []
    step = plant.step
    plant.step = lambda u: (applied.append(np.array(u)), step(u))[1]
    command = [*without(*ABSENT), shipped, "--settings", settings, "--bind", "tcp://127.0.0.1:*", "--runs", "1"]
    with process(*command) as (running, address), RobotLink(address) as link:
        RobotEnd(plant, link).drive(wait=60.0)
        said, complained = running.communicate(timeout=60)
    assert running.returncode == 0, complained
    task, bare = figure_eight(laps=0.7, tracked=("tip_x", "tip_y")), SlowManifold()
    chosen = {name: value for name, value in runner.DEFAULT["controller"].items() if name != "_target_"}
    controller = ModelPredictiveController(artifact.load(shipped).model, task, bare.input_bounds, timestep=0.01,
                                           output_names=bare.output_names, **chosen)
    record = simulate(bare, controller, task)
    np.testing.assert_allclose(applied[:-1], record.input[:-1], atol=1e-7)
    assert f"run 1: {len(record.time)} samples, {{}}" in said


@pytest.mark.parametrize("own_task", [True, False], ids=["the design's task", "a task of the settings"])
def test_the_runner_uses_the_controller_that_the_artifact_carries(by_hand, trial, tmp_path, own_task):
    designed, plant, applied = by_hand(), trial.ModelPlant(trial.oscillators()), []
    designed.card = designed.card | {"rest": [0.0] * 6, "input_names": list(plant.input_names)}
    designed.save(tmp_path / "artifact")
    more, task = [], designed.task
    if not own_task:
        rose = {"_target_": "ssmr_torch.tasks.references.rose", "amplitude": 0.003, "laps": 0.2, "ramp": 0.3,
                "tracked": ["y0", "y1"]}
        (tmp_path / "task.json").write_text(json.dumps({"task": rose}))
        more, task = ["--settings", tmp_path / "task.json"], runner.build(rose)
    step = plant.step
    plant.step = lambda u: (applied.append(np.array(u)), step(u))[1]
    command = [*without(*ABSENT), tmp_path / "artifact", *more, "--bind", "tcp://127.0.0.1:*", "--runs", "1"]
    with process(*command) as (running, address), RobotLink(address) as link:
        RobotEnd(plant, link).drive(wait=60.0)
        _, complained = running.communicate(timeout=60)
    assert running.returncode == 0, complained
    record = simulate(trial.ModelPlant(trial.oscillators()), designed.changed(task), task)
    np.testing.assert_allclose(applied[:-1], record.input[:-1], atol=1e-7)


@pytest.mark.parametrize("tolerance", [float("nan"), -1e-3])
def test_an_impossible_rest_tolerance_is_refused(shipped, tolerance):
    with pytest.raises(ValueError, match="rest_tolerance is .* m; expected a finite number, 0 or more"):
        runner.controller_for(artifact.load(shipped), lambda *_, **__: None, rest_tolerance=tolerance)


def test_the_default_settings_can_be_printed_and_built(capsys):
    assert runner.main(["--print-settings"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert all(printed[part] | chosen == printed[part] for part, chosen in runner.DEFAULT.items())
    assert runner.build(printed["task"]).tracked == ("tip_x", "tip_y")
    numbers = {name: value for name, value in printed["controller"].items() if name != "_target_"}
    assert PredictiveControlSettings(**numbers) == PredictiveControlSettings() and numbers["input_weight"] == 225.0


@pytest.mark.parametrize(("settings", "what"), [
    ({"_target_": "os.system", "command": "ls"}, "a class or function in ssmr_torch.control. or ssmr_torch.tasks."),
    ({"_target_": "ssmr_torch.control.mpc.ModelPredictiveController", "qp": "elsewhere:Solver"},
     "the settings name 'elsewhere.Solver' as qp"),
    ({}, "the settings name None"), (None, "the settings name None"),
    ({"_target_": "ssmr_torch.tasks.references.triangle"}, "cannot load ssmr_torch.tasks.references.triangle"),
    ({"_target_": "ssmr_torch.tasks.nothing.triangle"}, "cannot load"),
    ({"_target_": "ssmr_torch.tasks.references.circle", "radius": 1.0}, "not accept the arguments {'radius': 1.0}"),
])
def test_settings_with_a_wrong_class_or_argument_are_refused(settings, what):
    with pytest.raises(ValueError, match=what):
        runner.build(settings)


@pytest.mark.parametrize(("arguments", "what"), [
    ([], "the artifact is missing; give its directory"), (["nowhere"], "no artifact at nowhere"),
    (["{shipped}", "--settings", "nowhere.json"], "nowhere.json"),
    (["{shipped}"], "the artifact has no designed controller; run ssmr design data.path=FILE.h5"),
    (["{shipped}", "--settings", "{settings}", "--bind", "nonsense"], "cannot wait at 'nonsense'"),
    (["{shipped}", "--settings", "{settings}", "--timeout", "-1"], "positive timeout and patience"),
])
def test_bad_input_ends_in_one_message(shipped, settings, arguments, what, capsys):
    assert runner.main([argument.format(shipped=shipped, settings=settings) for argument in arguments]) == 1
    assert what in capsys.readouterr().err


def test_a_letter_in_a_font_says_what_to_install_where_fonttools_is_missing(shipped, tmp_path):
    (tmp_path / "text.ttf").touch()
    task = {"_target_": "ssmr_torch.tasks.symbols.symbol", "font": str(tmp_path / "text.ttf")}
    (tmp_path / "settings.json").write_text(json.dumps(runner.DEFAULT | {"task": task}))
    done = subprocess.run([*without("fontTools"), str(shipped), "--settings", str(tmp_path / "settings.json")],
                          capture_output=True, text=True)
    assert done.returncode == 1
    assert done.stderr == "runner: fontTools is not installed: pip install 'ssmr_torch[plots]'\n"


@pytest.mark.parametrize("text", ["{", "[]", '{"other": {}}'])
def test_a_file_that_is_not_settings_is_refused(shipped, tmp_path, text, capsys):
    (tmp_path / "settings.json").write_text(text)
    assert runner.main([str(shipped), "--settings", str(tmp_path / "settings.json")]) == 1
    assert "--print-settings shows" in capsys.readouterr().err


class Mismatched:
    """A slow manifold that says something else of itself."""

    def __init__(self, **changes):
        plant = SlowManifold()
        for name in ("name", "timestep", "rest", "input_bounds", "input_unit", "output_names", "input_names"):
            setattr(self, name, changes.get(name, getattr(plant, name)))


@pytest.mark.parametrize(("changes", "both"), [
    ({"output_names": tuple("abcdef")}, ["'tip_x', 'tip_y'", "but this robot or data has ['a', 'b'"]),
    ({"output_names": tuple("abc"), "rest": np.zeros(3)}, ["'mid_z']", "but this robot or data has ['a', 'b', 'c']"]),
    ({"input_names": tuple("abcd")}, ["'cable_+x'", "but this robot or data has ['a', 'b', 'c', 'd']"]),
    ({"input_unit": "bar"}, ["trained with input unit N", "but this robot or data has bar"]),
    ({"rest": np.full(6, 0.3)}, ["trained with the rest [0.0, 0.0, 0.2", "robot's rest is [0.3, 0.3", "1 mm"]),
    ({"timestep": 0.015}, ["0.02", "0.015"]),
], ids=["outputs", "dimension", "inputs", "unit", "rest", "timestep"])
def test_a_robot_that_does_not_match_the_model_is_refused_with_both_sides(shipped, changes, both):
    task = runner.build(runner.DEFAULT["task"])
    build = runner.controller_for(artifact.load(shipped), lambda model, bounds, **more: ModelPredictiveController(
        model, task, bounds, **more))
    with pytest.raises(ValueError) as refusal:
        build(RobotDescription.of(Mismatched(**changes)))
    assert all(part in str(refusal.value) for part in both), refusal.value


def test_the_same_robot_gets_the_same_controller_again(shipped):
    task, made = runner.build(runner.DEFAULT["task"]), []
    build = runner.controller_for(artifact.load(shipped), lambda *given, **more: made.append(more) or object())
    robot = RobotDescription.of(SlowManifold())
    assert build(robot) is build(robot) and len(made) == 1 and task.name == "figure eight"
    build(RobotDescription.of(SlowManifold(input_bounds=(0.0, 1.0))))
    assert len(made) == 2


def test_controllers_of_past_robots_are_forgotten_and_bounds_that_a_run_changed_are_set_back(shipped):
    class Bounded:
        def __init__(self, bounds):
            self.input_bounds = np.array(bounds)

    build = runner.controller_for(artifact.load(shipped), lambda model, bounds, **more: Bounded(bounds))

    def robot(highest):
        return RobotDescription.of(Mismatched(input_bounds=np.array([[0.0] * 4, [highest] * 4])))

    first = build(robot(1.0))
    first.input_bounds = np.zeros((2, 4))
    assert build(robot(1.0)) is first and first.input_bounds.max() == 1.0
    for highest in range(2, 2 + runner.REMEMBERED):
        build(robot(float(highest)))
    assert build(robot(1.0)) is not first


@pytest.mark.slow
def test_two_commands_over_the_wire_give_the_ise_of_one_and_settings_for_the_runner(shipped, tmp_path):
    python = [sys.executable]
    same = [f"artifact={shipped}", "task.laps=1"]
    with process(*python, EXPERIMENTS / "serve_controller.py", *same, "bind=tcp://127.0.0.1:*", "hydra.run.dir=served",
                 cwd=tmp_path) as (running, address):
        robot = subprocess.run([*python, EXPERIMENTS / "serve_plant.py", f"connect={address}", "wait=60",
                                "hydra.run.dir=robot"], cwd=tmp_path, capture_output=True, text=True, timeout=LIMIT)
        said, complained = running.communicate(timeout=LIMIT)
    assert robot.returncode == 0 and running.returncode == 0, robot.stderr + complained
    with process(*python, EXPERIMENTS / "serve_controller.py", f"artifact={shipped}", "bind=tcp://127.0.0.1:*",
                 "hydra.run.dir=refusing", cwd=tmp_path) as (_, address):
        done = subprocess.run([*python, EXPERIMENTS / "serve_plant.py", f"connect={address}", "wait=60",
                               "plant.observe=state", "hydra.run.dir=refused"], cwd=tmp_path, capture_output=True,
                              text=True, timeout=LIMIT)
    assert "but this robot or data has ['q1'" in done.stderr and "Traceback" not in done.stderr and done.returncode != 0
    alone = subprocess.run([*python, EXPERIMENTS / "control.py", *same, "noise_std=0", "progress=false",
                            "hydra.run.dir=alone"], cwd=tmp_path, capture_output=True, text=True, timeout=LIMIT)
    assert alone.returncode == 0, alone.stderr
    ises = [json.loads((tmp_path / at / "result.json").read_text())["metrics"]["ise"] for at in ("served", "alone")]
    assert ises[0] == pytest.approx(ises[1], rel=1e-6)
    assert ClosedLoopRecord.load(tmp_path / "served" / "record.h5").provenance["model"] == "SSMR"
    written = json.loads((tmp_path / "served" / "settings.json").read_text())
    assert runner.build(written["task"]).duration == pytest.approx(np.pi / 2 + 1.0)
