"""A package of one's own, which ssmr_torch never heard of: what it brings works as what is ours does."""

import ast
import json
import subprocess
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from omegaconf import OmegaConf
from robot_of_mine.blended_observer import BlendedObserver
from robot_of_mine.bounded_least_squares import BoundedLeastSquares
from robot_of_mine.integral_control import IntegralController
from robot_of_mine.spiral import spiral
from robot_of_mine.sprung_mass import SprungMass
from robot_of_mine.squares_and_products import SquaresAndProducts
from robot_of_mine.tanh_units import TanhUnits
from robot_of_mine.text_logs import text_logs

import ssmr_torch as ssmr
from ssmr_torch import configuration
from ssmr_torch.collection.collect import ControlledRun, collect
from ssmr_torch.collection.excitation import SmoothRandom
from ssmr_torch.control.horizon import CompiledHorizon, LinearizedHorizon
from ssmr_torch.control.quadratic_program import QuadraticProgram
from ssmr_torch.control.solvers import solver_named
from ssmr_torch.fitting.checkpoints import load_model
from ssmr_torch.wire import runner

PACKAGE = Path(__file__).resolve().parent / "robot_of_mine"
SSMR = Path(sys.executable).with_name("ssmr")
SOLVER = "robot_of_mine.bounded_least_squares:BoundedLeastSquares"
# What a user writes for each kind of thing; a test comes to a model's.
FILES = {
    "polynomial model": ("squares_and_products.py", "conf/model/squares_and_products.yaml"),
    "any other model": ("tanh_units.py", "tanh_module.py", "conf/model/tanh_units.yaml"),
    "plant": ("sprung_mass.py", "conf/plant/sprung_mass.yaml"),
    "task": ("spiral.py", "conf/task/spiral.yaml"),
    "controller": ("integral_control.py", "conf/controller/integral.yaml"),
    "observer": ("blended_observer.py", "conf/observer/blended.yaml"),
    "reader": ("text_logs.py", "conf/data/text_logs.yaml"),
    "QP solver": ("bounded_least_squares.py",)}
MOST = {"polynomial model": 2, "any other model": 4}  # beside the test; 2 for all else
SMALL = {"module.starts": 40, "module.transient": 0.05}
SHORT, SLOW = spiral(duration=1.0, turns=1.0), spiral(duration=4.0, turns=1.0)


def test_every_kind_of_thing_takes_the_files_that_are_named_here_and_no_others():
    written = sorted(path.relative_to(PACKAGE).as_posix() for suffix in ("*.py", "*.yaml")
                     for path in PACKAGE.rglob(suffix) if path.name != "__init__.py")
    assert written == sorted(file for files in FILES.values() for file in files)
    assert all(len(files) <= MOST.get(kind, 2) for kind, files in FILES.items())
    assert len((PACKAGE / "squares_and_products.py").read_text().splitlines()) <= 40


def test_ssmr_torch_names_nothing_of_it_and_no_file_of_it_names_another_but_the_module_its_arrays():
    root = PACKAGE.parents[2]
    assert not [path for room in ("ssmr_torch", "conf", "experiments") for path in (root / room).rglob("*")
                if path.suffix in (".py", ".yaml") and "robot_of_mine" in path.read_text()]
    imports = {path.name: {node.module for node in ast.walk(ast.parse(path.read_text()))
                           if isinstance(node, ast.ImportFrom) and node.module.startswith("robot_of_mine")}
               for path in PACKAGE.glob("*.py")}
    assert {name: found for name, found in imports.items() if found} == {"tanh_module.py": {"robot_of_mine.tanh_units"}}


@pytest.fixture(scope="module")
def data():
    """Decays and controlled runs of the plant, a few seconds each."""
    runs = [ControlledRun(name, SmoothRandom(share=0.4), duration, split) for name, duration, split in
            (("train", 12.0, "train"), ("validation", 4.0, "validation"), ("test", 2.0, "test"))]
    return collect(SprungMass(), decays=6, validation_decays=0, test_decays=0, decay_duration=1.5, controlled=runs,
                   progress=False)


@pytest.fixture(scope="module")
def polynomial(data, config_dir, tmp_path_factory):
    """The foreign polynomial model, fitted, refined and guarded by its configuration, and its checkpoint."""
    at = tmp_path_factory.mktemp("polynomial")
    return ssmr.fit(data, "squares_and_products", config_dir=config_dir, directory=at, progress=False, **SMALL, **{
        "fit.refinement.epochs": 2, "fit.refinement.starts": 60, "fit.refinement.horizon": 0.3}), at / "model.ckpt"


@pytest.fixture(scope="module")
def other(data, config_dir):
    """The foreign model that is not polynomial, begun as a linear one and trained by gradients."""
    return ssmr.fit(data, "tanh_units", config_dir=config_dir, progress=False, **SMALL, **{
        "fit.training.epochs": 5, "fit.training.horizon": 0.3, "module.batch_size": 64})


def test_a_polynomial_model_is_fitted_refined_and_guarded(polynomial):
    model, _ = polynomial
    assert isinstance(model.module, SquaresAndProducts) and model.name == "SQUARES_AND_PRODUCTS"
    assert set(model.report) == {"closed_form", "refinement", "guard"}
    assert set(model.report["closed_form"]["regressions"]) == {"coordinates", "dynamics", "parametrization"}
    assert not any(share for report in model.report.values() for share in report["diverged"].values())
    assert model.reduced.rates.real.max() < 0
    assert model.scores["test/rmse_50ms"] < 1e-3 < model.card["output_range"][1][0]


def test_its_checkpoint_and_its_artifact_are_read_back(polynomial, tmp_path):
    model, checkpoint = polynomial
    again, _ = load_model(checkpoint)
    assert isinstance(again, SquaresAndProducts) and again.arguments == model.module.arguments
    loaded = ssmr.load(model.save(tmp_path / "artifact"))
    z, u = np.full(4, 1e-3), np.full(3, 0.1)
    np.testing.assert_array_equal(loaded.reduced.step(z, u), model.reduced.step(z, u))


def test_it_is_exported_in_c_and_for_casadi_equal_to_rounding(polynomial, tmp_path):
    model, _ = polynomial
    forms = model.export(tmp_path / "artifact", "c", "casadi")
    assert [form.format for form in forms] == ["c", "casadi"] and all(form.error < 1e-12 for form in forms)


@pytest.mark.slow
def test_it_is_exported_for_torch_and_onnx_equal_to_rounding(polynomial, tmp_path):
    model, _ = polynomial
    assert all(form.error < 1e-12 for form in model.export(tmp_path / "artifact", "torch", "onnx"))


def tracking_error(controller, task=SHORT) -> float:
    """Root mean square, as a share of the task's radius."""
    record = ssmr.simulate(SprungMass(), controller, task, progress=False)
    assert not record.fallback.any()
    return float(np.sqrt((record.error ** 2).sum(1).mean()) / np.abs(record.reference).max())


def controller_of(model, **changes):
    plant = SprungMass()
    return ssmr.ModelPredictiveController(model.reduced, SHORT, plant.input_bounds, output_names=plant.output_names,
                                          input_weight=1.0, **changes)


def test_it_controls_by_the_compiled_kernel_with_a_solver_and_an_observer_of_ones_own(polynomial):
    plain = controller_of(polynomial[0])
    mine = controller_of(polynomial[0], qp=SOLVER, observer=partial(BlendedObserver, share=0.6))
    assert isinstance(plain.horizon, CompiledHorizon)
    assert isinstance(mine.solver, BoundedLeastSquares) and isinstance(mine.estimator, BlendedObserver)
    assert tracking_error(plain) < 0.3 and tracking_error(mine) < 0.3


def test_the_solver_finds_what_proxqp_finds_and_refuses_what_it_does_not_know():
    rng = np.random.default_rng(0)
    L = rng.normal(size=(6, 6))
    program = QuadraticProgram(L @ L.T + np.eye(6), 5 * rng.normal(size=6), -np.ones(6), np.ones(6))
    found, expected = BoundedLeastSquares(6).solve(program), solver_named("proxqp", 6, 0).solve(program)
    assert found.status.success and np.abs(expected.x).max() == pytest.approx(1)  # some bounds are active
    np.testing.assert_allclose(found.x, expected.x, atol=1e-6)
    with pytest.raises(ValueError, match="2 rows of constraints"):
        BoundedLeastSquares(6, 2)


def test_a_controller_of_ones_own_follows_a_task_of_ones_own(polynomial):
    plant = SprungMass()
    controller = IntegralController(polynomial[0].reduced, SLOW, plant.input_bounds, timestep=plant.timestep,
                                    output_names=plant.output_names)
    assert tracking_error(controller, SLOW) < 0.2


def test_a_model_that_is_not_polynomial_trains_from_its_linear_beginning(other):
    assert isinstance(other.reduced, TanhUnits) and set(other.report) == {"start", "training"}
    assert np.abs(other.reduced.K).max() > 0  # the gradients have moved what the linear model does not have
    assert other.scores["validation/rmse_50ms"] < 1e-3


def test_it_controls_through_its_linearization(other):
    controller = controller_of(other)
    assert type(controller.horizon) is LinearizedHorizon
    assert tracking_error(controller) < 0.3


WITHOUT_TORCH = """
import sys
sys.modules.update(dict.fromkeys(("torch", "lightning", "hydra", "omegaconf", "scipy")))
from ssmr_torch.deployment import artifact
model = artifact.load(sys.argv[1]).model
print(type(model).__module__, model.state_dim)
"""


def test_its_artifact_is_loaded_without_torch_and_has_no_c(other, tmp_path, environment):
    other.save(tmp_path / "artifact")
    done = subprocess.run([sys.executable, "-c", WITHOUT_TORCH, tmp_path / "artifact"], capture_output=True, text=True,
                          env=environment)
    assert done.stdout.split() == ["robot_of_mine.tanh_units", "4"], done.stderr
    with pytest.raises(ValueError, match="a TanhUnits cannot be written in C, because its class names no writer"):
        other.export(tmp_path / "artifact", "c")


def test_an_artifact_of_a_package_that_is_not_there_says_so(other, tmp_path):
    other.save(tmp_path / "artifact")
    done = subprocess.run([sys.executable, "-c", WITHOUT_TORCH, tmp_path / "artifact"], capture_output=True, text=True)
    assert "which is not installed here (No module named 'robot_of_mine'); install its package" in done.stderr


@pytest.mark.slow
def test_it_is_exported_for_torch_equal_to_rounding(other, tmp_path):
    assert all(form.error < 1e-12 for form in other.export(tmp_path / "artifact", "torch", "onnx"))


def test_a_kind_that_no_folder_has_is_refused_with_those_that_there_are(data, config_dir, tmp_path):
    with pytest.raises(ValueError, match="did you mean 'squares_and_products'"):
        ssmr.fit(data, "squares_and_product", config_dir=config_dir)
    with pytest.raises(ValueError, match="no kind of model 'squares_and_products'"):
        ssmr.fit(data, "squares_and_products")
    with pytest.raises(ValueError, match="which is no folder"):
        ssmr.fit(data, "ssmr", config_dir=tmp_path / "nowhere")


def write_logs(folder, data):
    """The runs as text files, as the reader expects them."""
    folder.mkdir()
    for run in data:
        name = {"decay": "decay", "controlled": "run"}[run.kind] if run.split != "test" else "test"
        rows = [f"{1e3 * t:.9g} | {1e3 * y[0]:.12g} {1e3 * y[1]:.12g} | {u[0]:.12g} {u[1]:.12g} {u[2]:.12g}"
                for t, y, u in zip(run.time, run.observation, run.input)]
        (folder / f"{name}_{run.name}.txt").write_text("\n".join(rows) + "\n")
    return folder


def test_a_reader_of_ones_own_gives_what_was_recorded(data, tmp_path):
    read = text_logs(write_logs(tmp_path / "logs", data))
    assert len(read) == len(data) and read.input_names == data.input_names
    longest, same = max(data, key=lambda run: run.length), max(read, key=lambda run: run.length)
    np.testing.assert_allclose(same.observation, longest.observation, rtol=0, atol=1e-12)


@pytest.mark.parametrize("fit", ["least_squares", "stability_guard", "gauss_newton", "rollout"])
def test_every_fit_takes_the_closed_form_that_the_model_names(config_dir, fit):
    config = configuration.composed("train", ["model=squares_and_products", f"fit={fit}"], config_dir=config_dir)
    assert config.fit.closed_form._target_ == "ssmr_torch.fitting.training.polynomial_least_squares"
    assert config.model.delays == 1 and "input_dim" not in config.model and "calibration" not in config.fit.closed_form


def test_a_served_controller_of_ones_own_must_be_permitted_by_the_operator():
    settings = {"_target_": "robot_of_mine.spiral.spiral", "turns": 1.0}
    with pytest.raises(ValueError, match="'robot_of_mine.spiral.spiral' as _target_.*--package"):
        runner.build(settings)
    assert runner.build(settings, packages=["robot_of_mine"]).name == "spiral"
    controller = {"_target_": "ssmr_torch.control.mpc.ModelPredictiveController", "qp": SOLVER}
    with pytest.raises(ValueError, match="as qp"):
        runner.build(controller)


@pytest.fixture(scope="module")
def line(tmp_path_factory, config_dir, environment):
    """Commands that know the package by --config-dir and PYTHONPATH alone; trajectories are collected."""
    at = tmp_path_factory.mktemp("line")

    def run(name, *arguments, directory=None):
        done = subprocess.run([SSMR, name, "--config-dir", config_dir, *arguments,
                               f"hydra.run.dir={directory or name}"], cwd=at, env=environment, capture_output=True,
                              text=True)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    run("collect", "plant=sprung_mass", "excitation.decays=8", "excitation.validation_decays=0",
        "excitation.test_decays=0", "excitation.decay_duration=1.5", "excitation.progress=false", "workers=2")
    run.at = at
    return run


QUIET = ["trainer.enable_progress_bar=false", "figures=false", "module.starts=50"]
FEW = ["fit.refinement.epochs=3", "fit.refinement.starts=100", "fit.refinement.horizon=0.5"]


@pytest.mark.slow
def test_the_whole_line_works_by_config_dir_alone(line):
    line("train", "model=squares_and_products", "data.path=collect/trajectories.h5", *QUIET, *FEW)
    line("export", "checkpoint=train/model.ckpt", "artifact=artifact", "formats=[c,torch,onnx,casadi]")
    shared = ["artifact=artifact", "plant=sprung_mass", "task=spiral", "progress=false"]
    line("control", *shared, "controller.input_weight=1.0", f"qp={SOLVER}", "observer@controller.observer=blended",
         directory="predictive")
    line("control", *shared, "controller=integral", directory="integral")
    for name in ("predictive", "integral"):
        metrics = json.loads((line.at / name / "metrics.json").read_text())
        assert metrics["fallbacks"] == 0 and metrics["rmse"] < 2e-3
    composed = OmegaConf.load(line.at / "integral" / ".hydra" / "config.yaml")
    assert composed.controller.reach == 0.01 and composed.plant.stiffness == 15.0  # the defaults of the classes
    line("serve_controller", *shared[:1], "task=spiral", "controller=integral", "runs=0", directory="serve")
    assert json.loads((line.at / "serve" / "settings.json").read_text())["task"]["turns"] == 2.0


@pytest.mark.slow
def test_a_reader_and_another_family_of_models_train_by_config_dir_alone(line, data):
    write_logs(line.at / "logs", data)
    line("train", "model=tanh_units", "data=text_logs", "data.path=logs", "fit.training.epochs=2", *QUIET,
         directory="tanh")
    line("export", "checkpoint=tanh/model.ckpt", "artifact=tanh_artifact", "formats=[torch]", directory="tanh_export")
    line("evaluate", "artifact=tanh_artifact", "data=text_logs", "data.path=logs", "starts=50")
    scores = json.loads((line.at / "evaluate" / "scores.json").read_text())["scores"]
    assert scores["TANH_UNITS"]["horizons"][0]["mean"] < 0.5 * scores["persistence"]["horizons"][0]["mean"]
