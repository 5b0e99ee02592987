"""Claims about wrong settings: each command refuses them in one sentence that names the key, before any work."""

import subprocess
import sys
from pathlib import Path

import pytest

from ssmr_torch.faults.commands_in_process import Ended, run_command
from ssmr_torch.faults.wrong_settings import is_legal, verdict, wrong_settings
from ssmr_torch.ranges import Number, OrNone, Whole

SSMR = Path(sys.executable).with_name("ssmr")
NOWHERE = "data.path=nowhere.h5"


@pytest.mark.parametrize(("command", "overrides", "said"), [
    ("serve_controller", ["artifact=A", "rest_tolerance=nan"], "rest_tolerance is nan m; expected"),
    ("serve_controller", ["artifact=A", "rest_tolerance=0"], "rest_tolerance is 0 m; expected"),
    ("serve_controller", ["artifact=A", "bind=tcp://*:99999"], "bind is 'tcp://*:99999'; expected an address"),
    ("serve_controller", ["artifact=A", "runs=1.5"], "runs is 1.5; expected a whole number"),
    ("serve_plant", ["connect=5555"], "connect is 5555; expected an address"),
    ("serve_plant", ["answer_within=0"], "answer_within is 0; expected"),
    ("control", ["artifact=A", "controller.range_factor=nan"], "controller.range_factor is nan; expected"),
    ("control", ["artifact=A", "controller.range_factor=-1"], "controller.range_factor is -1; expected"),
    ("control", ["artifact=A", "controller.horizon=2.5"], "controller.horizon is 2.5; expected a whole number"),
    ("control", ["artifact=A", "controller.output_weight=1e300"], "controller.output_weight is 1e+300 1/m²; expected"),
    ("control", ["artifact=A", "task.tracked=7"], "task.tracked is 7; expected a list"),
    ("control", ["artifact=A", "plant.substeps=1000000000"], "plant.substeps is 1000000000; expected"),
    ("control", ["artifact=A", "++controller.horizon={a: 1}"], "controller.horizon is {'a': 1}; expected"),
    ("control", ["artifact=A", "++plant._target_=nowhere.Thing"], "plant._target_ is 'nowhere.Thing'; expected"),
    ("control", ["artifact=A", "rig.outputs=${nowhere}"], "rig.outputs is '${nowhere}', which names nothing"),
    ("control", ["artifact=A", "task=nothing"], "task=nothing is no option"),
    ("train", [NOWHERE, "model.delays=1.5"], "model.delays is 1.5; expected a whole number from 0 to 1000"),
    ("train", [NOWHERE, "model.dynamics_degree=30"], "model.dynamics_degree is 30; expected"),
    ("train", [NOWHERE, "seed=-1"], "seed is -1; expected"),
    ("train", [NOWHERE, "fit=nothing"], "fit=nothing is no option"),
    ("train", [NOWHERE, "model.delay=1"], "model.delay is no setting of this command; did you mean model.delays?"),
    ("train", [NOWHERE, "+model.delay=1"], "model.delay is no setting of SSMR; did you mean delays?"),
    ("train", [NOWHERE, "model.delays=[1,2"], "model.delays=[1,2: "),
    ("train", [NOWHERE, "plant=5"], "plant=5 is no option"),
    ("train", [NOWHERE, "trainer.devices=0"], "trainer.devices is 0; expected"),
    ("collect", ["excitation.release.probability=1e-300"], "excitation.release.probability is 1e-300; expected"),
    ("collect", ["excitation.controlled=null"], "excitation.controlled is None; expected a list"),
    ("collect", ["workers='many'"], "workers is 'many'; expected"),
    ("compare", [NOWHERE, "horizons=[0.1,nan]"], "horizons[1] is nan s; expected"),
    ("evaluate", [NOWHERE, "artifact=A", "split=all"], "split is 'all'; expected one of"),
    ("export", ["checkpoint=A", "formats=[pdf]"], "formats is ['pdf']; expected"),
    ("design", [NOWHERE, "bounds=[[0],[inf]]"], "bounds[1][0] is inf; expected"),
    ("report", ["directory=''"], "directory is ''; expected the path"),
    ("commission", ["card=A", "confirm=maybe"], "confirm is 'maybe'; expected one of ask, yes"),
    ("reproduce", ["workers=0"], "workers is 0; expected")])
def test_a_wrong_setting_is_refused_in_one_sentence_that_names_the_key(command, overrides, said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    ended = run_command(command, overrides, tmp_path / "run", 120.0)  # much of it imports
    assert ended.how == "refused" and said in ended.said, ended
    assert ended.said.count("\n") < 3 and len(ended.said) < 420


@pytest.mark.parametrize(("arguments", "said"), [
    (["collect", "plant=trunkk"], "collect: plant=trunkk is no option; did you mean plant=trunk? The options are"),
    pytest.param(["train", "model.delays=["], "train: model.delays=[", marks=pytest.mark.slow)])
def test_what_hydra_says_of_a_command_line_is_one_line(arguments, said, tmp_path):
    done = subprocess.run([SSMR, *arguments], capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 1 and done.stderr.startswith(said) and len(done.stderr.splitlines()) == 1


@pytest.mark.parametrize(("ended", "legal", "outcome"), [
    (Ended("refused", "train: delays is 1.5; expected a whole number", 0.1), False, "refused"),
    (Ended("refused", "train: something is wrong", 0.1), False, "wrong"),
    (Ended("refused", "train: delays\n1\n2\n3", 0.1), False, "wrong"),
    (Ended("done", "", 0.1), False, "wrong"), (Ended("done", "", 0.1), True, "survived"),
    (Ended("late", "", 10.0), False, "hang"), (Ended("late", "", 2.0), True, "survived"),
    (Ended("traceback", "TypeError", 0.1), True, "traceback")])
def test_the_judge_of_wrong_settings_finds_each_kind_of_fault(ended, legal, outcome):
    assert verdict(ended, legal, ["delays"])[0] == outcome


def test_no_range_makes_nan_or_a_number_beyond_all_quantities_legal():
    assert is_legal(Number(), 1.0, 3.0) and is_legal(OrNone(Whole(0, 5)), None, None)
    assert not is_legal(Number(), 1.0, float("nan")) and not is_legal(Number(), 1.0, 1e300)
    assert not is_legal(Whole(0, 5), 1, 1.5) and not is_legal(None, True, 1)


@pytest.mark.slow
def test_random_wrong_settings_give_no_traceback_and_are_never_accepted():
    found = wrong_settings(25, seed=11)
    assert [row for row in found if row["outcome"] not in ("refused", "survived")] == []
    assert sum(row["outcome"] == "refused" for row in found) > 15
