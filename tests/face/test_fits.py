"""Fits by the name of a kind."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import ssmr_torch as ssmr
from ssmr_torch.fitting.options import dotted

ROOT = Path(__file__).resolve().parents[2]


def test_a_fit_equals_the_command_to_the_last_bit(data, tmp_path):
    """`fit(data, "ssmr", …)` against experiments/train.py with the same settings."""
    import torch

    from ssmr_torch.fitting.checkpoints import load_model

    stored = ssmr.load(data.save(tmp_path / "data.h5"))
    model = ssmr.fit(stored, "ssmr", state_dim=4, transient=0.05, progress=False)
    subprocess.run([sys.executable, ROOT / "experiments" / "train.py", f"data.path={tmp_path / 'data.h5'}",
                    "model=ssmr", "model.state_dim=4", "module.transient=0.05", "logger=csv", "figures=false",
                    f"hydra.run.dir={tmp_path / 'run'}"], check=True, capture_output=True,
                   env=os.environ | {"OMP_NUM_THREADS": str(torch.get_num_threads())})  # sums are split by threads
    trained, card = load_model(tmp_path / "run" / "model.ckpt")
    found = model.module.state_dict()
    assert all(torch.equal(value, found[name]) for name, value in trained.state_dict().items())
    assert card["scores"] == model.card["scores"] and card["name"] == model.name == "SSMR"


def test_a_fit_leaves_the_random_numbers_of_a_notebook_alone_and_writes_nothing(data, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    np.random.seed(7)
    expected = np.random.default_rng(7), np.random.get_state()[1].copy()
    ssmr.fit(data, "dmd", progress=False)
    assert (np.random.get_state()[1] == expected[1]).all() and not list(tmp_path.iterdir())


def test_a_directory_keeps_what_the_command_keeps(data, tmp_path):
    ssmr.fit(data, "dmd", progress=False, directory=tmp_path / "run")
    assert (tmp_path / "run" / "model.ckpt").is_file() and (tmp_path / "run" / "checkpoints" / "closed_form").is_dir()


@pytest.mark.parametrize(("kind", "options", "error", "message"), [
    ("smr", {}, ValueError, "no kind of model 'smr'; did you mean 'ssmr'"),
    ("ssmr", {"derivative": "gausian"}, ValueError, "no derivative 'gausian'; did you mean 'gaussian'"),
    ("ssmr", {"ridge": {"dynamic": 0.1}, "state_dim": 4}, ValueError, r"ridge names \[.dynamic.\]; this fit has"),
    ("ssmr", {"state_dims": 4}, TypeError, "no option state_dims; did you mean model.state_dim"),
    ("ssmr", {"fit.closed_form.rige": 0.0}, TypeError, "no key fit.closed_form.rige; did you mean fit.closed_form"),
])
def test_options_that_do_not_exist_are_refused_with_the_nearest(data, kind, options, error, message):
    with pytest.raises(error, match=message):
        ssmr.fit(data, kind, progress=False, **options)


def test_a_ridge_may_be_given_for_one_regression_as_on_the_command_line(data):
    model = ssmr.fit(data, "ssmr", state_dim=4, ridge={"dynamics": 0.1}, progress=False)
    ridge = model.card["provenance"]["training"]["configuration"]["fit"]["closed_form"]["ridge"]
    assert ridge["dynamics"] == 0.1 and len(ridge["default"]) > 1


def test_one_output_may_be_named_without_a_list(data):
    assert data.observing("y").output_names == ("y",) and data.columns("y") == [1]


def test_a_controller_takes_the_models_names_and_refuses_others(dmd):
    task, bounds = ssmr.tasks.path([0.0, 0.1], [[0.0], [0.001]], outputs=["y"]), [[-1.0, -1.0], [1.0, 1.0]]
    controller = ssmr.ModelPredictiveController(dmd, task, bounds)
    assert controller.task.columns(dmd.output_names) == (1,)
    for names in (["x", "y"], ["y", "x", "z"]):
        with pytest.raises(ValueError, match="the model has 3 outputs, .*: name these, in this order"):
            ssmr.ModelPredictiveController(dmd, task, bounds, output_names=names)
    with pytest.raises(TypeError, match="settings a dict; expected a model, .* and PredictiveControlSettings"):
        ssmr.ModelPredictiveController(dmd, task, bounds, {"horizon": 3})
    with pytest.raises(TypeError, match="model is a str"):
        ssmr.ModelPredictiveController("artifact", task, bounds)


def test_an_option_of_two_steps_is_refused_with_both_names():
    configuration = {"outputs": None, "model": {"delays": 1}, "module": {"starts": 500},
                     "fit": {"closed_form": {"folds": 5}, "refinement": {"starts": 64, "_target_": "a.b"}}}
    assert dotted({"folds": 3, "fit.refinement.starts": 8}, configuration) == {
        "fit.closed_form.folds": 3, "fit.refinement.starts": 8}
    with pytest.raises(TypeError, match="starts may mean module.starts or fit.refinement.starts; give the full name"):
        dotted({"starts": 3}, configuration)
