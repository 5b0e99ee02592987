"""A designed controller goes into an artifact and comes back the same, to the last bit."""

import copy
import hashlib
import json
import pickle
import sys

import numpy as np
import pytest

import ssmr_torch as ssmr
from ssmr_torch import tasks
from ssmr_torch.checksum import sealed_json
from ssmr_torch.control.designed import DesignedController
from ssmr_torch.control.kalman_observers import KalmanObserver
from ssmr_torch.deployment import artifact
from ssmr_torch.deployment.exported_programs import deploy
from ssmr_torch.targets import build, written


@pytest.fixture(scope="module")
def plant(trial):
    return trial.ModelPlant(trial.perturbed(trial.oscillators(), 0.03))


@pytest.fixture(scope="module")
def saved(by_hand, tmp_path_factory):
    return by_hand().save(tmp_path_factory.mktemp("designed") / "artifact")


def commands(controller, plant, seed=0, steps=150):
    """What it commands while the plant obeys, with noise, a missing sample and an outlier."""
    rng, sample, found = np.random.default_rng(seed), plant.reset(), []
    controller.reset()
    for k in range(steps):
        seen = sample + 1e-5 * rng.standard_normal(6) + (0.1 if k == 60 else np.nan if k == 90 else 0.0)
        found.append(controller(0.01 * k, seen).input)
        sample = plant.step(found[-1])
    return np.array(found)


def test_the_loaded_controller_commands_what_the_designed_one_does_to_the_last_bit(by_hand, saved, plant):
    loaded = ssmr.load(saved).controller()
    assert isinstance(loaded, DesignedController) and loaded.counts.total() == 0
    ours, theirs = commands(by_hand(), plant), commands(loaded, plant)
    assert ours.std() > 0.01
    np.testing.assert_array_equal(ours, theirs)
    assert loaded.counts["gated"] == 1 and loaded.counts["missing"] == 1 and not loaded.fallbacks


def test_copies_and_pickles_command_the_same(by_hand, plant):
    controller = by_hand()
    expected = commands(controller, plant)
    for again in (copy.deepcopy(controller), pickle.loads(pickle.dumps(controller))):
        np.testing.assert_array_equal(commands(again, plant), expected)


def test_an_artifact_that_is_saved_again_or_deployed_keeps_its_controller(saved, tmp_path):
    first = (saved / "controller.json").read_bytes()
    model = ssmr.load(saved)
    model.save(tmp_path / "again")
    model.controller().save(tmp_path / "by the controller")
    deploy(tmp_path / "again", ["c"])
    model.save(tmp_path / "again")  # replaces what is there, its controller.json as well
    for folder in ("again", "by the controller"):
        assert (tmp_path / folder / "controller.json").read_bytes() == first
        assert artifact.load(tmp_path / folder).card["sha256"]["controller.json"] == hashlib.sha256(first).hexdigest()
    assert "controller: tracks y0, y1; designed from 2.5 min of recordings" in repr(model)


def test_numbers_in_the_file_are_the_settings_to_the_last_bit(by_hand, saved):
    controller, stored = by_hand(), json.loads((saved / "controller.json").read_text())
    observer = stored["controller"]["observer"]
    assert observer["_target_"] == "ssmr_torch.control.disturbance_observer.DisturbanceObserver"
    assert observer["_partial_"] is True
    np.testing.assert_array_equal(observer["gain"], controller.settings.observer.keywords["gain"])
    again = ssmr.load(saved).controller()
    assert again.settings.changed(observer=None) == controller.settings.changed(observer=None)
    assert again.facts == controller.facts and again.task.name == "figure eight"


def test_a_controller_that_was_changed_or_is_missing_is_refused(saved, tmp_path):
    ssmr.load(saved).save(tmp_path / "one")
    path, text = tmp_path / "one" / "controller.json", (saved / "controller.json").read_text()
    path.write_text(text.replace('"huber": 0.0001', '"huber": 0.0002'))
    with pytest.raises(ValueError, match="controller.json is missing or differs from the hash in the card"):
        ssmr.load(tmp_path / "one")
    path.unlink()
    with pytest.raises(ValueError, match="controller.json is missing or differs"):
        ssmr.load(tmp_path / "one")
    model = artifact.load(saved)
    bare = artifact.save(tmp_path / "bare", model.model, **{
        key: model.card[key] for key in ("output_names", "input_names", "rest", "input_range")})
    (bare / "controller.json").write_text(text)
    with pytest.raises(ValueError, match="controller.json is missing or differs"):
        artifact.load(bare)


@pytest.mark.parametrize(("text", "message"), [
    ("{", "is not valid JSON"), ("[]", "is not a designed controller: it has no controller, tracked"),
    ("{}", "design it again")])
def test_a_file_that_is_not_a_controller_is_refused(saved, tmp_path, text, message):
    ssmr.load(saved).save(tmp_path / "one")
    (tmp_path / "one" / "controller.json").write_text(text)
    card = json.loads((tmp_path / "one" / "card.json").read_text())
    card["sha256"]["controller.json"] = hashlib.sha256(text.encode()).hexdigest()
    (tmp_path / "one" / "card.json").write_text(sealed_json(card))
    with pytest.raises(ValueError, match=message):
        artifact.load(tmp_path / "one")


def test_a_file_cannot_make_the_program_load_anything_but_settings(saved):
    model = ssmr.load(saved)
    model.designed["controller"]["observer"]["_target_"] = "os.system"
    with pytest.raises(ValueError, match=r"name 'os.system' as _target_; expected a class or function in"):
        model.controller()


@pytest.mark.parametrize("settings", [
    {"_target_": "ssmr_torch.control.designed.found", "home": "antigravity:"},
    {"_target_": "ssmr_torch.control.designed.build", "settings": {"_target_": "os.system"}, "packages": ["os"]},
    {"_target_": "ssmr_torch.control.solvers.solver_named", "name": "antigravity:Solver", "dim": 1, "rows": 0},
    {"_target_": "ssmr_torch.control.solvers.import_module", "name": "antigravity"},
    {"_target_": "ssmr_torch.control.designed.Path", "a": "b"}], ids=lambda settings: settings["_target_"])
def test_a_file_cannot_call_what_a_room_has_imported_from_elsewhere(settings):
    with pytest.raises(ValueError, match="which no settings may call"):
        build(settings)
    assert "antigravity" not in sys.modules


def test_another_task_of_the_same_outputs_is_taken_and_others_are_refused_with_both_lists(saved, plant):
    model = ssmr.load(saved)
    rose = tasks.rose(amplitude=0.004, tracked=["y1", "y0"])
    assert model.controller(rose).task is rose
    assert model.controller().changed(rose, horizon=5).settings.horizon == 5
    for refuse in (model.controller, model.controller().changed):
        with pytest.raises(ValueError, match=r"tracks \['y0', 'y2'\], .* designed to track \['y0', 'y1'\]"):
            refuse(tasks.rose(tracked=["y0", "y2"]))


def test_commands_stay_within_the_robots_bounds_and_the_designs(saved, plant, trial):
    controller = ssmr.load(saved).controller(bounds=[[-1.0] * 4, [0.3, 0.6, 5.0, 0.6]])
    np.testing.assert_array_equal(controller.input_bounds, [[0.0] * 4, [0.3, 0.6, 0.6, 0.6]])
    np.testing.assert_array_equal(controller.changed().input_bounds, controller.input_bounds)
    assert commands(controller, plant)[:, 0].max() <= 0.3
    with pytest.raises(ValueError, match="does not overlap it"):
        ssmr.load(saved).controller(bounds=[[2.0] * 4, [3.0] * 4])


def test_an_artifact_without_a_controller_says_what_to_run(trial, tmp_path):
    model = trial.oscillators()
    artifact.save(tmp_path / "bare", model, output_names=list("abcdef"), input_names=list("ghij"), rest=[0.0] * 6,
                  input_range=trial.BOUNDS)
    with pytest.raises(ValueError, match="has no designed controller; run ssmr design data.path=FILE.h5"):
        ssmr.load(tmp_path / "bare").controller()


def test_a_robot_of_another_timestep_is_refused_with_both_numbers(saved):
    with pytest.raises(ValueError, match=r"samples every 0.01 s, but the robot has 0.02 s"):
        ssmr.load(saved).controller(timestep=0.02)



def test_a_task_that_a_file_cannot_hold_must_be_given_again(by_hand, tmp_path):
    task = tasks.Task("mine", 1.0, ("y0", "y1"), lambda time: np.zeros((len(time), 2)))
    by_hand(task).save(tmp_path / "artifact")
    with pytest.raises(ValueError, match=r"a file cannot hold; give a task that tracks \['y0', 'y1'\]"):
        ssmr.load(tmp_path / "artifact").controller()
    assert ssmr.load(tmp_path / "artifact").controller(task).task is task


@pytest.mark.parametrize("task", [
    tasks.circle(), tasks.figure_eight(tracked=["a", "b"]), tasks.rose(), tasks.letter("Oß", tracked=["a", "b"]),
    tasks.path([0.0, 1.0], [[0.0, 1.0], [1.0, 1.0]], outputs=["a", "b"]),
    tasks.circle(obstacles=[tasks.obstacles.Circle([0.0, 0.01], 0.004), tasks.obstacles.HalfPlane([1.0, 0.0], 0.02),
                            tasks.obstacles.Circle(tasks.obstacles.drifting([0.0, 0.0], [0.01, 0.0]), 0.002)])],
    ids=lambda task: f"{task.name}, {len(task.obstacles)} obstacles")
def test_every_task_of_the_package_is_the_same_after_a_file_to_the_last_bit(task):
    again, times = build(json.loads(json.dumps(written(task), allow_nan=False))), np.linspace(-1.0, 30.0, 997)
    np.testing.assert_array_equal(again.reference(times), task.reference(times))
    assert (again.name, again.duration, again.tracked) == (task.name, task.duration, task.tracked)
    outputs = np.random.default_rng(0).normal(0.0, 0.01, (997, 2))
    for ours, theirs in zip(again.obstacles, task.obstacles, strict=True):
        np.testing.assert_array_equal(ours.clearance(times, outputs), theirs.clearance(times, outputs))


@pytest.mark.parametrize(("value", "message"), [
    (float("nan"), "limit is NaN"), (lambda: 0, "limit is <function .* which cannot be written to a file"),
    ({"gain": json.dumps}, "limit.gain is <function dumps")])
def test_a_setting_that_a_file_cannot_hold_is_refused_by_name(value, message):
    with pytest.raises(ValueError, match=message):
        written(value, "limit")


def test_infinite_bounds_and_classes_are_the_same_after_a_file(by_hand, tmp_path):
    bounds = [[-np.inf] * 6, [0.01] + [np.inf] * 5]
    by_hand(output_bounds=bounds, observer=KalmanObserver, actuator=None).save(tmp_path / "artifact")
    settings = ssmr.load(tmp_path / "artifact").controller().settings
    np.testing.assert_array_equal(settings.output_bounds, bounds)
    assert settings.observer.func.__name__ == "build"


def test_a_controller_made_by_hand_without_a_card_cannot_be_saved(by_hand, tmp_path):
    controller = by_hand()
    bare = DesignedController(controller.model, controller.task, controller.input_bounds, controller.settings,
                              output_names=controller.output_names)
    with pytest.raises(ValueError, match="does not know the names, the rest position and the unit of its robot"):
        bare.save(tmp_path / "artifact")
