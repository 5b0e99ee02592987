"""Every configuration composes and instantiates, and every partial is called."""

import inspect
from datetime import date
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from hydra import compose, initialize_config_dir
from hydra.utils import instantiate
from omegaconf import OmegaConf

from ssmr_torch import configuration, found_settings, option_tables
from ssmr_torch.closed_loop.rerun_view import RerunView
from ssmr_torch.data.derivatives import Stencil
from ssmr_torch.fitting.lightning_fit import ModelFit
from ssmr_torch.models.koopman import Koopman
from ssmr_torch.models.polynomial import PolynomialModel
from ssmr_torch.models.ssmr import SSSR
from ssmr_torch.plants.base import Plant
from ssmr_torch.plants.emulated_rig import Rig
from ssmr_torch.tasks.references import Task
from ssmr_torch.trajectory import TrajectoryDataset

VIEW_SETTINGS = [name for name, parameter in inspect.signature(RerunView).parameters.items()
                 if parameter.kind is parameter.KEYWORD_ONLY]
CONF = Path(__file__).resolve().parents[1] / "conf"
PRIMARY = sorted(path.stem for path in CONF.glob("*.yaml") if path.stem != "directories")


PAPER = (CONF.parent / "ssmr_torch" / "paper").is_dir()


def group(name: str) -> list[str]:
    """Options of a group; where paper/ was deleted, without those that build something of it."""
    entries = option_tables.entries(CONF, name)
    return [each for each in configuration.options(name)
            if PAPER or not str(entries.get(each, {}).get("_target_")).startswith("ssmr_torch.paper.")]


ROBOTS = sorted(path.stem for path in (CONF / "found").glob("*.yaml"))
ROWS = [(robot, model) for robot in ROBOTS for model in group(f"row/found/{robot}")]
FOUND_CONTROLLERS = [f"{robot}/{model}" for robot in ROBOTS for model in group(f"controller/{robot}")]


@pytest.fixture(autouse=True)
def configurations():
    configuration.register()
    with initialize_config_dir(str(CONF), version_base="1.3"):
        yield


@pytest.mark.parametrize("name", PRIMARY)
def test_every_entry_point_has_a_configuration_that_composes(name):
    config = compose(name, return_hydra_config=True)
    assert config.hydra.run.dir and (name == "docs_numbers" or config.hydra.callbacks.multirun_table)
    assert (CONF.parent / "experiments" / f"{name}.py").is_file()


SIMULATED_BY = {"tendon_chain": "mujoco", "cosserat_rod": "elastica", "isupport": "soromox", "planar_hsa": "soromox"}
SLOW = {name: pytest.mark.slow for name, package in SIMULATED_BY.items() if package == "soromox"}


# The remote one is there only when its robot is: tests/wire. soromox compiles for some ten seconds.
@pytest.mark.parametrize("plant", [pytest.param(name, marks=SLOW.get(name, ()))
                                   for name in group("plant") if name != "remote"])
def test_every_plant_is_one(plant):
    if plant in SIMULATED_BY:
        pytest.importorskip(SIMULATED_BY[plant], reason="the extra robots is not installed")
    assert isinstance(instantiate(compose("collect", [f"plant={plant}"]).plant), Plant)


@pytest.mark.parametrize("choice", group("rig"))
@pytest.mark.parametrize("entry", ["collect", "control"])
def test_every_rig_takes_every_entry_points_plant_and_names_all_settings(entry, choice):
    config = compose(entry, [f"rig={choice}"])
    plant = instantiate(config.plant)
    built = instantiate(config.rig)(plant)
    assert isinstance(built, Plant) and (built is plant) == (choice == "ideal")
    settings = {key for key in config.rig if not key.startswith("_")}
    assert settings == set(inspect.signature(Rig).parameters) - {"plant"}


def test_a_rig_takes_one_limit_per_input():
    config = compose("control", ["rig=emulated_bench", "rig.rate_limit=[1,2,3,4]", "rig.saturation=1.0"])
    assert instantiate(config.rig)(instantiate(config.plant)).parameters["rate_limit"] == [1.0, 2.0, 3.0, 4.0]


@pytest.mark.parametrize("excitation", group("excitation"))
def test_every_excitation_collects(excitation):
    config = compose("collect", [f"excitation={excitation}", "excitation.decays=1", "excitation.validation_decays=0",
                                 "excitation.test_decays=0", "excitation.decay_duration=0.1",
                                 "excitation.controlled=[]", "excitation.progress=false"])
    dataset = instantiate(config.excitation)(instantiate(config.plant))
    assert isinstance(dataset, TrajectoryDataset) and len(dataset) == 1


@pytest.mark.parametrize("choice", group("model"))
def test_every_model_builds_on_any_number_of_outputs_and_inputs(choice):
    build = instantiate(compose("train", [f"model={choice}"]).model)
    built = build(input_dim=5, output_dim=4, timestep=0.01)
    assert built.input_dim == 5 and built.output_dim == 4 and built.timestep == 0.01


@pytest.mark.parametrize("derivative", group("derivative"))
def test_every_derivative_is_a_stencil(derivative):
    assert isinstance(instantiate(compose("train", [f"derivative={derivative}"]).derivative), Stencil)


def builds(*overrides):
    """The model of a configuration with every one of its fits built around it."""
    config = compose("train", list(overrides))
    built = instantiate(config.model)(input_dim=4, output_dim=9, timestep=0.01)
    for fit in config.fit.values():
        assert isinstance(instantiate(fit)(built), ModelFit)
    return config


@pytest.mark.parametrize("choice", group("model"))
def test_every_model_brings_a_fit_that_takes_it(choice):
    assert builds(f"model={choice}").fit


@pytest.mark.parametrize("derivative", group("derivative"))
def test_a_refinement_takes_the_closed_form_with_every_derivative(derivative):
    assert set(builds("model=ssmr", "fit=rollout", f"derivative={derivative}").fit) == {"closed_form", "refinement"}


@pytest.mark.parametrize(("robot", "model"), ROWS)
def test_a_row_of_found_settings_is_taken_when_it_is_asked_for_and_builds(robot, model):
    row = found_settings.read(CONF / "found" / f"{robot}.yaml")["models"][model]
    config = builds(f"robot={robot}", f"model={model}", "settings=found")
    for section, values in row["settings"].items():
        assert _within(values, OmegaConf.to_container(config[section]))
    assert config.found == {"table": f"conf/found/{robot}.yaml", "row": f"models.{model}"} | row["found"]


@pytest.mark.parametrize("controller", FOUND_CONTROLLERS)
def test_a_row_of_found_settings_of_a_controller_is_an_option_of_the_controller(controller):
    robot, _, model = controller.partition("/")
    row = found_settings.read(CONF / "found" / f"{robot}.yaml")["controllers"][model]
    config = compose("control", [f"controller={controller}"])
    assert _within(row["settings"], OmegaConf.to_container(config.controller))
    assert config.found.row == f"controllers.{model}" and config.found.model.startswith(f"model={model} ")


def test_every_row_says_when_and_how_it_was_found():
    for robot in ROBOTS:
        for rows in found_settings.read(CONF / "found" / f"{robot}.yaml").values():
            for row in rows.values():
                assert date.fromisoformat(row["found"]["date"])
                assert {"command", "budget", "trials", "seed", "metric", "score"} <= set(row["found"]) or \
                    row["found"]["note"].startswith(("Chosen by hand", "The closed form that search=ssmr found"))


def test_without_being_asked_for_no_found_settings_are_taken():
    assert "found" not in compose("train", ["robot=trunk", "model=ssmr"])
    assert compose("train", ["robot=trunk", "model=ssmr"]).model.state_dim == 6
    assert compose("train", ["robot=trunk", "model=ssmr", "settings=found"]).model.state_dim == 10


def has(config, key: str) -> bool:
    *sections, last = key.split(".")
    for section in sections:
        config = config.get(section, {})
    return last in config


@pytest.mark.parametrize("search", group("search"))
def test_every_search_varies_settings_that_its_model_has_by_validation_and_with_the_same_effort(search):
    config = compose("train", [f"search={search}"], return_hydra_config=True)
    sweeper = config.hydra.sweeper
    assert sweeper._target_ == "hydra_plugins.search_sweeper.SearchSweeper"
    assert config.metric.startswith("validation/") and not config.module.score_test
    assert sweeper.n_trials == 40 and sweeper.direction == "minimize"
    if search != "own":  # the common part, for ranges of the user's own
        assert config.hydra.runtime.choices.model == search
        assert len(sweeper.params) >= 4 and all(has(config, key) for key in sweeper.params)


def test_every_model_can_be_searched():
    assert set(group("search")) == {*group("model"), "own"} - {"auto"}  # which chooses for itself


@pytest.mark.parametrize("search", group("search/controller"))
def test_every_search_of_a_controller_varies_settings_that_it_has_on_a_task_of_its_own(search):
    config = compose("control", [f"search=controller/{search}"], return_hydra_config=True)
    assert config.hydra.runtime.choices.task == "rose" and not config.picture
    assert config.hydra.sweeper.params and all(has(config, key) for key in config.hydra.sweeper.params)


@pytest.mark.parametrize("study", group("study"))
def test_every_study_varies_a_setting_or_asks_for_test_runs(study):
    config = compose("train", [f"study={study}"], return_hydra_config=True)
    varied = dict(config.hydra.sweeper.params or {})
    if OmegaConf.is_missing(config.study, "runs"):
        assert config.study.axis in ("amplitude", "speed") and not varied
    else:
        assert list(varied) == [config.study.axis] and has(config, config.study.axis)


def _within(values, everything) -> bool:
    if isinstance(values, dict):
        return all(_within(value, everything[key]) for key, value in values.items())
    return values == everything


def test_the_data_module_takes_its_configuration():
    data = TrajectoryDataset([_run()], np.zeros(3), list("xyz"), list("abcd"))
    module = instantiate(compose("train").module)(dataset=data)
    assert module.transient == 0.1 and len(module.training) == len(module.validation) == 1


@pytest.mark.parametrize("data", group("data"))
def test_every_data_configuration_names_the_readers_arguments_and_no_others(data):
    config = compose("train", [f"data={data}"]).data
    reader = instantiate({"_target_": "hydra.utils.get_method", "path": config._target_})
    known = inspect.signature(reader).parameters
    assert set(config) - {"_target_", "_convert_"} <= set(known)


@pytest.mark.parametrize("choice", [name for name in group("trainer") if name == "cpu"])
def test_the_trainer_takes_its_configuration(choice):
    trainer = instantiate(compose("train", [f"trainer={choice}"]).trainer)(max_epochs=3, logger=False)
    assert trainer.max_epochs == 3


@pytest.mark.parametrize("choice", [name for name in group("trainer") if name != "cpu"])
def test_the_other_trainers_take_arguments_that_lightning_knows(choice):
    import lightning

    config = compose("train", [f"trainer={choice}"]).trainer
    known = inspect.signature(lightning.Trainer).parameters
    assert set(config) - {"_target_", "_partial_"} <= set(known)


@pytest.mark.parametrize("choice", group("logger"))
def test_every_logger_takes_arguments_that_it_knows(choice):
    for name, logger in compose("train", [f"logger={choice}"]).logger.items():
        target = instantiate({"_target_": "hydra.utils.get_class", "path": logger._target_})
        known = inspect.signature(target.__init__).parameters
        assert set(logger) - {"_target_"} <= set(known), name


@pytest.mark.parametrize("robot", group("robot"))
def test_every_robot_composes_and_its_model_and_fit_build(robot):
    config = builds(f"robot={robot}")
    assert config.fit and not OmegaConf.is_missing(config.data, "_target_")


@pytest.mark.parametrize("controller", [*group("controller"), *FOUND_CONTROLLERS])
@pytest.mark.parametrize("task", group("task"))
def test_every_controller_takes_every_task(controller, task):
    config = compose("control", [f"controller={controller}", f"task={task}"])
    plant, chosen = instantiate(config.plant), instantiate(config.task)
    assert isinstance(chosen, Task)
    build = instantiate(config.controller)
    assert isinstance(build, partial)
    if controller == "designed":
        with pytest.raises(ValueError, match="has no designed controller"):
            build(_tables(len(plant.output_names)), chosen, plant.input_bounds)
        return
    tables = _pregain(len(plant.output_names)) if "static_pregain" in controller else _tables(len(plant.output_names))
    control = build(tables, chosen, plant.input_bounds, timestep=plant.timestep,
                    output_names=plant.output_names)
    command = control(0.0, np.zeros(len(plant.output_names)))
    assert (command.input >= plant.input_bounds[0]).all() and (command.input <= plant.input_bounds[1]).all()


@pytest.mark.parametrize("view", group("view"))
def test_every_view_takes_task_and_plant(view, tmp_path):
    config = compose("control", [f"view={view}"])
    assert (config.view is None) == (view == "none")
    if view != "none":
        assert set(config.view) - {"_target_", "_partial_", "_convert_"} == set(VIEW_SETTINGS)
    if view == "recording":
        pytest.importorskip("rerun", reason="rerun is not installed: pip install 'ssmr_torch[view]'")
        with instantiate(config.view)(instantiate(config.task), instantiate(config.plant), tmp_path):
            pass
        assert (tmp_path / config.view.recording).is_file()


def _tables(outputs: int) -> PolynomialModel:
    built = SSSR(6, 4, outputs, 1)
    with torch.no_grad():
        frame = torch.eye(built.window_dim, 6, dtype=torch.float64)
        built.chart.copy_(frame.T)
        built.parametrization.copy_(frame)
        built.drift_table.copy_(-torch.eye(6))
        built.state_scale.fill_(0.05)
    return built.reduced.numpy()


def _pregain(outputs: int):
    built = Koopman(4, outputs, input_delays=0, constant=False, pregain=True)
    with torch.no_grad():
        built.A.copy_(0.9 * torch.eye(built.state_dim))
        built.B[:, :] = 0.01
        built.state_scale.fill_(0.05)
    return built.reduced.numpy()


def _run():
    from ssmr_torch.trajectory import Trajectory

    rng = np.random.default_rng(0)
    return Trajectory(0.01 * np.arange(500), 1e-2 * rng.normal(size=(500, 3)), rng.uniform(size=(500, 4)))
