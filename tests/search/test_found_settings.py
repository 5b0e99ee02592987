"""Tables of found settings: what is written is read again, rows are options, and a run says which row it takes."""

import json

import pytest
from omegaconf import OmegaConf

from ssmr_torch import configuration, fit, found_settings
from ssmr_torch.search import best_row

ROW = {"found": {"date": "2026-11-30", "metric": "validation/rmse", "score": 1.0e-5, "trials": 3},
       "settings": {"model": {"delays": 4}, "fit": {"closed_form": {"ridge": {"default": 4.2524551443780844e-10}}}}}
CHOICES = {"model": "ssmr", "robot": "trunk", "settings": "found"}


def lines(found=None, **choices):
    return list(found_settings.lines(found, CHOICES | choices, lambda *asked: asked == ("trunk", "ssmr")))


def test_a_merged_row_is_read_to_the_last_bit_and_leaves_the_others(tmp_path):
    path = tmp_path / "found" / "arm.yaml"
    found_settings.merge(path, "models", "ssmr", ROW)
    found_settings.merge(path, "models", "edmd", ROW)
    found_settings.merge(path, "models", "ssmr", ROW | {"settings": {"model": {"delays": 5}}})
    table = found_settings.read(path)
    assert table["models"]["edmd"] == ROW and table["models"]["ssmr"]["settings"] == {"model": {"delays": 5}}
    assert [each.name for each in path.parent.iterdir()] == ["arm.yaml"]


@pytest.mark.parametrize(("text", "said"), [
    ("model: {delays: 3}\n", "holds model; expected a table of found settings"),
    ("models: {ssmr: {settings: {}}}\n", "the row models.ssmr lacks found"),
    ("controllers: {ssmr: {settings: {}, found: {}}}\n", "the row controllers.ssmr lacks controller")])
def test_a_file_that_is_no_table_is_refused(tmp_path, text, said):
    (tmp_path / "arm.yaml").write_text(text)
    with pytest.raises(ValueError, match=said):
        found_settings.read(tmp_path / "arm.yaml")


def test_a_run_says_which_row_it_takes_or_that_the_defaults_hold():
    record = {"table": "conf/found/trunk.yaml", "row": "models.ssmr"} | ROW["found"]
    assert lines(record) == ["found settings: row models.ssmr of conf/found/trunk.yaml, of 2026-11-30 "
                             "(validation/rmse 1e-05; best of 3 trials)"]
    assert "has no row models.edmd; the defaults of conf/model/edmd.yaml" in lines(model="edmd")[0]
    assert "settings=found takes row models.ssmr of found/trunk.yaml" in lines(settings="default")[0]
    assert lines(model=None, controller="scp", settings=None) == [
        "no found settings: the defaults of conf/controller/scp.yaml"]


def test_found_settings_without_a_robot_are_refused():
    with pytest.raises(ValueError, match="add robot=NAME"):
        lines(robot=None)
    with pytest.raises(ValueError, match="add robot=NAME"):
        configuration.settings_lines(configuration.composed("train", ["settings=found"]),
                                     {"settings": "found", "model": "ssmr"})


def test_a_table_in_a_folder_of_the_users_own_gives_options_there(tmp_path):
    found_settings.merge(tmp_path / "found" / "arm.yaml", "models", "ssmr", ROW)
    found_settings.merge(tmp_path / "found" / "arm.yaml", "controllers", "ssmr", {
        "controller": "scp", "observer": "kalman", "found": ROW["found"], "settings": {"input_weight": 7.0}})
    (tmp_path / "groups").mkdir()
    (tmp_path / "groups" / "robot.yaml").write_text("arm: {_package_: _global_, outputs: [tip_x]}\n")
    trained = configuration.composed("train", ["robot=arm", "model=ssmr", "settings=found"], config_dir=tmp_path)
    assert trained.model.delays == 4 and trained.found.table == str(tmp_path / "found" / "arm.yaml")
    assert list(trained.outputs) == ["tip_x"]
    controlled = configuration.composed("control", ["controller=arm/ssmr"], config_dir=tmp_path)
    assert controlled.controller.input_weight == 7.0 and controlled.controller.observer.disturbance == "none"
    assert {"arm", "trunk"} <= set(configuration.options("robot", tmp_path))


def test_python_takes_found_settings_as_the_command_does(tmp_path, capsys):
    with pytest.raises(ValueError, match="experiment=trunk is robot=trunk since version 0.11"):
        fit(_dataset(), "ssmr", experiment="trunk")
    found_settings.merge(tmp_path / "found" / "arm.yaml", "models", "dmd", ROW | {"settings": {"model": {"delays": 3}}})
    (tmp_path / "robot").mkdir()
    (tmp_path / "robot" / "arm.yaml").write_text("# @package _global_\noutputs: null\n")
    model = fit(_dataset(), "dmd", robot="arm", settings="found", config_dir=tmp_path)
    assert model.delays == 3
    assert model.card["provenance"]["training"]["configuration"]["found"]["row"] == "models.dmd"
    assert "found settings: row models.dmd of" in capsys.readouterr().out


def _dataset():
    import numpy as np

    from ssmr_torch.trajectory import Trajectory, TrajectoryDataset

    rng = np.random.default_rng(0)
    time, inputs = 0.01 * np.arange(2000), rng.uniform(-1, 1, (2000, 1))
    path = np.zeros((2000, 2))
    for k in range(1999):
        path[k + 1] = 0.95 * path[k] + 1e-3 * np.array([1.0, 0.5]) * inputs[k]
    return TrajectoryDataset([Trajectory(time, path, inputs, name=f"run-{k}") for k in range(2)], np.zeros(2),
                             ["x", "y"], ["u"])


def job(directory, overrides, composed, card=None):
    """A finished job of a search, as it lies in its folder."""
    (directory / "0" / ".hydra").mkdir(parents=True)
    (directory / "0" / "result.json").write_text(json.dumps({"overrides": overrides}))
    OmegaConf.save(OmegaConf.create(composed), directory / "0" / ".hydra" / "config.yaml")
    if card:
        (directory / "artifact").mkdir()
        (directory / "artifact" / "card.json").write_text(json.dumps(card))


def searched(**choices):
    return OmegaConf.create({"search_minutes": 8, "save_to": None, "hydra": {
        "runtime": {"choices": choices}, "sweeper": {"n_trials": 30, "sampler": {"seed": 0}},
        "overrides": {"task": [f"search={choices['search']}", "save_to=x.yaml"], "hydra": ["hydra.sweep.dir=here"]},
        "job": {"name": "train"}}})


def test_the_best_row_holds_what_was_searched_and_another_fit_written_out(tmp_path):
    composed = {"fit": {"closed_form": {"ridge": {"default": 0.1}}, "guard": {"reach": 3.0}}, "model": {"delays": 4}}
    job(tmp_path, ["model.delays=4", "fit.closed_form.ridge.default=0.1", "fit=stability_guard", "module.transient=0.2",
                   "data.path=x.h5"], composed)
    best_row.save_best(tmp_path, searched(search="ssmr", model="ssmr", robot="trunk"),
                       [{"job": "0", "validation/relative": 0.123456}], "validation/relative")
    row = found_settings.read(tmp_path / "found.yaml")["models"]["ssmr"]
    assert row["settings"] == composed | {"module": {"transient": 0.2}}
    assert row["found"] | {"date": ""} == {
        "date": "", "command": "ssmr train -m search=ssmr", "budget": "30 trials, 8 CPU minutes", "trials": 1,
        "seed": 0, "metric": "validation/relative", "score": 0.1235}


def test_a_search_from_found_settings_keeps_those_that_it_does_not_vary(tmp_path):
    job(tmp_path, ["model.delays=2"], {"found": {"table": "conf/found/trunk.yaml", "row": "models.ssmr"}})
    best_row.save_best(tmp_path, searched(search="ssmr", model="ssmr", robot="trunk"), [{"job": "0", "score": 0.1}],
                       "score")
    settings = found_settings.read(tmp_path / "found.yaml")["models"]["ssmr"]["settings"]
    assert settings["model"] == {"state_dim": 10, "delays": 2, "dynamics_degree": 2, "parametrization_degree": 1,
                                 "control_degree": 1}


def test_the_best_row_of_a_controller_has_the_name_of_the_model_of_its_artifact(tmp_path):
    job(tmp_path, ["controller.input_weight=3.0", "plant=trunk"], {"artifact": str(tmp_path / "artifact")},
        {"name": "static pregain", "provenance": {"training": {"kind": "koopman_lqr"}}})
    best_row.save_best(tmp_path, searched(search="controller/static_pregain", controller="static_pregain"),
                       [{"job": "0", "ise": 2.0e-6}], "ise")
    row = found_settings.read(tmp_path / "found.yaml")["controllers"]["static_pregain"]
    assert row["settings"] == {"input_weight": 3.0} and "observer" not in row
    assert (row["found"]["metric"], row["found"]["score"]) == ("ISE, mm²", 2.0)
