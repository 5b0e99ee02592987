"""Names of earlier versions: those that a user types are refused with the new name, those in files are understood."""

import subprocess
import sys

import pytest

from ssmr_torch import command, configuration, fit, renamed
from ssmr_torch.trajectory import Trajectory, TrajectoryDataset

TYPED = [*((f"{group}={old}", renamed.argument_now(f"{group}={old}")) for group, options in renamed.OPTIONS.items()
           for old in options),
         ("sweep=ssmr", "search=ssmr"), ("sweep=optuna", "search=own"), ("tuning=scp", "search=controller/scp"),
         ("experiment=trunk", "robot=trunk"), ("experiment=hardware", "robot=emulated_bench"),
         ("model=ssmr,koopman_lqr", "model=ssmr,static_pregain"), ("+data=trunk_hardware", "+data=real_trunk"),
         ("controller=hardware_ssmr", "controller=emulated_bench/ssmr"), ("rig=hardware", "rig=emulated_bench"),
         ("controller=trunk_control_augmented", "controller=trunk/ssmr_control_augmented"),
         ("fit=guarded", "fit=stability_guard"), ("launcher=joblib", "executor=joblib"),
         ("model=ssmr_guarded", "model=ssmr_stability_guard")]
ENTRY = {"controller": "control", "tuning": "control", "rig": "control", "launcher": "reproduce"}


@pytest.mark.parametrize(("old", "new"), TYPED)
def test_a_command_refuses_an_old_name_with_the_new_one(old, new, monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["ssmr", "train", old])
    assert command.main() == 2
    assert capsys.readouterr().err == f"ssmr train: {old} is {new} since version 0.11\n"


@pytest.mark.parametrize(("old", "new"), [pair for pair in TYPED if not pair[1].startswith(("+", "hydra"))])
def test_the_new_name_composes_and_the_old_one_is_refused_in_python(old, new):
    entry = ENTRY.get(old.partition("=")[0], "train")
    with pytest.raises(ValueError, match="since version 0.11"):
        configuration.composed(entry, [old])
    if (configuration.folder() / f"{entry}.yaml").is_file():  # reproduce goes with paper/
        configuration.composed(entry, [new.partition(",")[0]])


def test_a_script_refuses_old_names_as_its_command_does(tmp_path):
    script = command.script("train")
    done = subprocess.run([sys.executable, script, "experiment=trunk"], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 1 and done.stderr == "train: experiment=trunk is robot=trunk since version 0.11\n"


@pytest.mark.parametrize("argument", ["~tuned", "tuned=trunk/ssmr"])
def test_leaving_out_what_was_tuned_is_refused_with_what_to_do(argument):
    with pytest.raises(ValueError, match="add settings=found to take them"):
        renamed.refuse_old_names([argument])


def test_a_renamed_command_is_refused_with_its_new_name(monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["ssmr", "serve", "artifact=DIR"])
    assert command.main() == 2 and capsys.readouterr().err == "ssmr: serve is serve-controller since version 0.11\n"


@pytest.mark.parametrize("options", [{"kind": "koopman_lqr"}, {"kind": "ssmr", "fit": "guarded"},
                                     {"kind": "ssmr", "experiment": "trunk"}, {"kind": "ssmr_guarded"}])
def test_fit_refuses_old_names(options):
    run = Trajectory([0.0, 0.1, 0.2], [[0.0], [0.1], [0.2]], [[1.0], [1.0], [1.0]])
    dataset = TrajectoryDataset([run], [0.0], ["tip_x"], ["u"])
    with pytest.raises(ValueError, match="since version 0.11"):
        fit(dataset, options.pop("kind"), **options)


def test_what_is_not_renamed_stays():
    for argument in ("model=ssmr", "data.path=trunk_hardware", "+x=1", "plant=trunk", "outputs=[tip_x,tip_y]"):
        assert renamed.argument_now(argument) == argument
    renamed.refuse_old_names(["model=ssmr", "name=experiment", "controller=scp_trunk"])


def test_kinds_that_earlier_versions_wrote_are_understood():
    assert renamed.kind_now("koopman_lqr") == "static_pregain" and renamed.kind_now("edmd") == "edmd"
