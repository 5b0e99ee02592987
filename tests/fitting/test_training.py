"""Training with Lightning: its results, resuming, files and refusals."""

import subprocess
import sys
from copy import deepcopy
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import lightning
import numpy as np
import pytest
import torch

from ssmr_torch.data.datamodule import TrajectoryDataModule
from ssmr_torch.fitting import constructor_checks as constructors
from ssmr_torch.fitting.gradient_fit import GradientFit
from ssmr_torch.fitting.ssmr_least_squares import SSMRLeastSquares
from ssmr_torch.fitting.training import least_squares, load_model, save_model, train
from ssmr_torch.models.ssmr import SSMR
from ssmr_torch.trajectory import TrajectoryDataset

TRAINER = partial(lightning.Trainer, accelerator="cpu", devices=1, use_distributed_sampler=False,
                  enable_model_summary=False, enable_progress_bar=False)
MODEL = partial(SSMR, state_dim=2, delays=0, parametrization_degree=2, dynamics_degree=3)
MODULE = partial(TrajectoryDataModule, transient=0.0, validation_share=0.1, rows=64, validation_horizon=0.1,
                 rollout_horizon=0.1, starts=20, stride=2)
CLOSED_FORM = {"closed_form": partial(least_squares, ridge=[0.0, 1e-8])}
TABLES = ("chart", "parametrization", "drift_table", "control_table", "state_scale")

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning:lightning", "ignore:.*LeafSpec")


@pytest.fixture(scope="module")
def dataset(known):
    return known.dataset()


def fitted(dataset, directory, **changes):
    options = {"model": MODEL, "fits": CLOSED_FORM, "module": MODULE, "trainer": TRAINER} | changes
    return train(dataset, directory=directory, **options)


@pytest.fixture(scope="module")
def whole(dataset, tmp_path_factory):
    return fitted(dataset, tmp_path_factory.mktemp("whole"))


def assert_same_model(found, expected, tolerance=0.0):
    for name in TABLES:
        ours, theirs = getattr(found, name), getattr(expected, name)
        assert (ours - theirs).norm() <= tolerance * theirs.norm(), name


def test_a_known_model_is_found_scored_and_reported(known, dataset, whole):
    errors = known.errors(whole.model)
    assert max(errors.values()) < 1e-3
    assert whole.scores["validation/rmse"] < 1e-5 and whole.scores["test/rmse"] < 1e-5
    assert whole.scores["validation/diverged"] == whole.scores["test/diverged"] == 0
    report = whole.report["closed_form"]
    assert set(report["regressions"]) == {"parametrization", "dynamics"}
    assert report["diverged"] == {"decay": 0.0, "controlled": 0.0}
    assert report["trajectories"] == {"decay": 8, "controlled": 3}
    assert report["regressions"]["dynamics"]["features"] == 9 + 6
    assert report["captured_variance"] > 0.95 and len(report["singular_values"]) == 4
    upper = max(value[1] for value in report["eigenvalues"])
    assert upper == pytest.approx(np.linalg.eigvals(known.A).imag.max(), rel=1e-3)
    assert "validation/rmse: " in whole.summary() and f"checkpoint: {whole.checkpoint}" in whole.summary()


def test_lightning_finds_what_the_stages_find_without_it(dataset, whole, solve_stages):
    data = MODULE(dataset=dataset)
    model = SSMR(2, 2, 4, 0, parametrization_degree=2, dynamics_degree=3, timestep=dataset.timestep)
    solve_stages(SSMRLeastSquares(model), data.training, rows=64, ridge=(0.0, 1e-8))
    model.state_scale.copy_(whole.model.state_scale)
    assert_same_model(whole.model, model, 1e-12)


def test_the_training_range_is_the_largest_coordinate_of_the_training_data(dataset, whole):
    largest = [whole.model.encode(torch.tensor(run.read().observation)[:, None]).abs().amax(0)
               for run in MODULE(dataset=dataset).training]
    torch.testing.assert_close(whole.model.state_scale, torch.stack(largest).amax(0).detach(), rtol=1e-14, atol=0)


def test_the_card_describes_the_training_data_and_not_the_test_data(dataset, whole):
    _, card = load_model(whole.checkpoint)
    runs = MODULE(dataset=dataset).training
    inputs = np.concatenate([run.input for run in runs])
    assert card["input_range"] == [inputs.min(0).tolist(), inputs.max(0).tolist()]
    assert card["output_names"] == ["a", "b", "c", "d"] and card["input_unit"] == "N" and card["name"] == "SSMR"
    assert card["data"] == {"source": "known"} and card["scores"] == whole.scores


def test_the_checkpoint_gives_back_the_model_to_the_bit_from_plain_values_only(whole):
    stored = torch.load(whole.checkpoint, weights_only=True)
    assert stored["model"]["class"] == "ssmr_torch.models.ssmr.SSMR"
    assert_same_model(load_model(whole.checkpoint)[0], whole.model)
    last, card = load_model(whole.checkpoint.parent / "checkpoints" / "closed_form" / "last.ckpt")
    assert_same_model(last, whole.model)
    assert card["output_names"] == ["a", "b", "c", "d"]
    assert sorted(path.name for path in whole.checkpoint.parent.iterdir()) == ["checkpoints", "model.ckpt",
                                                                           "model.safetensors"]


def test_a_save_that_is_interrupted_leaves_the_old_checkpoint_as_it_was(whole, tmp_path, monkeypatch):
    path = save_model(tmp_path / "model.ckpt", whole.model, {"name": "old"})
    before = path.read_bytes()

    def interrupted(aside, content):
        with open(aside, "wb") as file:
            file.write(content[:100])
        raise KeyboardInterrupt

    monkeypatch.setattr(Path, "write_bytes", interrupted)
    with pytest.raises(KeyboardInterrupt):
        save_model(path, whole.model, {"name": "new"})
    monkeypatch.undo()
    assert path.read_bytes() == before and {each.name for each in tmp_path.iterdir()} == {
        "model.ckpt", "model.safetensors"}


class Owned:
    """Something that only unpickling could bring back."""


@pytest.mark.parametrize("content", [
    {"state_dict": {}}, torch.zeros(3), [1, 2], {"model": "SSMR"}, {"model": {"class": "os.system", "arguments": {}}},
    {"model": {"class": "ssmr_torch.models.ssmr.Absent", "arguments": {}}, "state_dict": {}, "card": {}},
    {"model": {"class": "ssmr_torch.models.ssmr.SSMR", "arguments": {"state_dim": 1, "input_dim": 1, "output_dim": 1}},
     "state_dict": {}, "card": {}}, Owned()], ids=lambda content: type(content).__name__)
def test_checkpoints_of_another_kind_are_refused(tmp_path, content):
    torch.save(content, tmp_path / "other.ckpt")
    with pytest.raises(ValueError, match="other.ckpt (holds|cannot be read as a checkpoint)"):
        load_model(tmp_path / "other.ckpt")


def test_files_that_are_no_checkpoints_are_refused(tmp_path, whole):
    with pytest.raises(FileNotFoundError, match="no checkpoint at .*absent.ckpt"):
        load_model(tmp_path / "absent.ckpt")
    for content in (b"", b"hello", whole.checkpoint.read_bytes()[:-300]):
        (tmp_path / "bad.ckpt").write_bytes(content)
        with pytest.raises(ValueError, match="bad.ckpt cannot be read as a checkpoint of plain values"):
            load_model(tmp_path / "bad.ckpt")


class Interruption(lightning.Callback):
    def __init__(self, stage):
        self.stage = stage

    def on_train_batch_start(self, trainer, fit, batch, index):
        if fit.stage == self.stage and index == 3:
            raise KeyboardInterrupt


def interrupted_trainer(callbacks, *, stage, **options):
    return TRAINER(callbacks=[*callbacks, Interruption(stage)], **options)


@pytest.mark.parametrize("stage", ["manifold", "control"])
def test_a_fit_that_was_interrupted_in_a_stage_goes_on_from_the_stage_before(dataset, whole, tmp_path, stage,
                                                                              monkeypatch):
    monkeypatch.setattr("signal.signal", lambda *arguments: None)
    with pytest.raises(SystemExit):
        fitted(dataset, tmp_path, trainer=partial(interrupted_trainer, stage=stage))
    visited = []

    class Watch(lightning.Callback):
        def on_train_epoch_start(self, trainer, fit):
            visited.append(fit.stage)

    resumed = fitted(dataset, tmp_path, resume=True,
                     trainer=lambda callbacks, **options: TRAINER(callbacks=[*callbacks, Watch()], **options))
    assert visited == (["manifold", "control"] if stage == "manifold" else ["control"])
    assert_same_model(resumed.model, whole.model, 1e-12)
    assert resumed.report["closed_form"]["regressions"].keys() == whole.report["closed_form"]["regressions"].keys()
    assert resumed.scores == pytest.approx(whole.scores, rel=1e-9)


def test_a_finished_fit_does_not_change_when_it_is_resumed(dataset, whole):
    again = fitted(dataset, whole.checkpoint.parent, resume=True)
    assert_same_model(again.model, whole.model)
    assert again.report == whole.report


def test_a_fit_without_validation_and_test_runs_is_kept(known, dataset, tmp_path):
    runs = [run for run in dataset if run.split == "train"]
    bare = TrajectoryDataset(runs, dataset.rest, dataset.output_names, dataset.input_names)
    result = fitted(bare, tmp_path, module=partial(MODULE, validation_share=0))
    assert result.scores == {} and known.errors(result.model)["drift"] < 1e-3
    assert_same_model(load_model(result.checkpoint)[0], result.model)


@pytest.mark.parametrize("rule", ["gap", "variance:0.9"])
def test_the_dimension_follows_from_the_windows_that_the_model_sees(dataset, tmp_path, rule, monkeypatch):
    seen = []
    monkeypatch.setattr(constructors, "choose_dimension", lambda *arguments: seen.append(arguments) or 2)
    fitted(dataset, tmp_path, model=partial(SSMR, state_dim=rule, dynamics_degree=1))
    ((given, runs, delays, transient),) = seen
    assert (given, delays, transient) == (rule, 1, 0.0) and {run.kind for run in runs} == {"decay"}


def test_data_that_are_too_short_are_refused_before_any_fit(dataset, tmp_path):
    with pytest.raises(ValueError, match="a start needs 1 before and 10000 after it, 10002 in all"):
        fitted(dataset, tmp_path, module=partial(MODULE, validation_horizon=100.0))
    with pytest.raises(ValueError, match="'decay-0' has 101 samples; a transient of 200 samples"):
        fitted(dataset, tmp_path, module=partial(MODULE, transient=2.0))
    assert not list(tmp_path.iterdir())


def test_a_sampler_that_would_repeat_segments_is_refused():
    fit = least_squares(SSMR(2, 2, 4, 0))
    sampler = torch.utils.data.DistributedSampler(range(9), num_replicas=2, rank=0)
    fit._trainer = SimpleNamespace(train_dataloader=SimpleNamespace(sampler=sampler))
    with pytest.raises(ValueError, match="set trainer.use_distributed_sampler=false"):
        fit.on_train_start()


def perturbed(model, share=0.03):
    """The model with every coefficient of its dynamics off by up to this share."""
    other = deepcopy(model)
    generator = torch.Generator().manual_seed(4)
    with torch.no_grad():
        for table in (other.drift_table, other.control_table):
            table *= 1 + share * (2 * torch.rand(table.shape, generator=generator, dtype=torch.float64) - 1)
    return other


@pytest.mark.slow
def test_a_gradient_fit_recovers_the_predictions_that_a_perturbation_spoiled(dataset, whole, tmp_path):
    model = perturbed(whole.model)
    chart, parametrization = model.chart.clone(), model.parametrization.clone()
    fit = GradientFit(model, epochs=12, learning_rate=2e-3)
    data = MODULE(dataset=dataset, rollout_horizon=0.2, batch_size=32, stride=4).prepare(fit)
    trainer = TRAINER(max_epochs=fit.epochs, logger=False, enable_checkpointing=False, default_root_dir=tmp_path)
    (before,) = trainer.test(fit, data, verbose=False)
    trainer.fit(fit, data)
    (after,) = trainer.test(fit, data, verbose=False)
    assert after["test/rmse"] < 0.05 * before["test/rmse"]
    # the differences of the closed form see changing inputs to second order only; rollouts see them as they are
    assert after["test/rmse"] < 0.5 * whole.scores["test/rmse"]
    torch.testing.assert_close(model.chart, chart, rtol=0, atol=0)
    torch.testing.assert_close(model.parametrization, parametrization, rtol=0, atol=0)


def test_a_refinement_of_no_epochs_is_left_out(dataset, whole, tmp_path):
    result = fitted(dataset, tmp_path, fits=CLOSED_FORM | {"refinement": partial(GradientFit, epochs=0)})
    assert set(result.report) == {"closed_form"}
    assert_same_model(result.model, whole.model)


def test_a_refinement_follows_the_closed_form_and_keeps_its_best_epoch(dataset, whole, tmp_path):
    result = fitted(dataset, tmp_path, fits=CLOSED_FORM | {"refinement": partial(GradientFit, epochs=2)})
    assert set(result.report) == {"closed_form", "refinement"}
    best = load_model(tmp_path / "checkpoints" / "refinement" / "best.ckpt")[0]
    assert_same_model(result.model, best)
    torch.testing.assert_close(result.model.chart, whole.model.chart, rtol=0, atol=0)
    assert not torch.equal(result.model.drift_table, whole.model.drift_table)


@pytest.mark.parametrize(("options", "message"), [
    ({"epochs": 0}, "epochs is 0"), ({"learning_rate": 0.0}, "learning_rate is 0.0"),
    ({"frozen": ["charts"]}, r"frozen names \['charts'\], but the model's parameters are \['chart', ")])
def test_invalid_options_of_a_gradient_fit_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        GradientFit(SSMR(2, 2, 4, 0), **options)


PROGRAM = """
import sys
from functools import partial
import lightning
from ssmr_torch.data.datamodule import TrajectoryDataModule
from ssmr_torch.fitting.gradient_fit import GradientFit
from ssmr_torch.fitting.training import least_squares, train
from ssmr_torch.models.ssmr import SSMR
from ssmr_torch.trajectory import TrajectoryDataset

train(TrajectoryDataset.load(sys.argv[1]), directory=sys.argv[2],
      fits={"closed_form": partial(least_squares, ridge=[0.0, 1e-8]), "refinement": partial(GradientFit, epochs=1)},
      model=partial(SSMR, state_dim=2, delays=0, parametrization_degree=2, dynamics_degree=3),
      module=partial(TrajectoryDataModule, transient=0.0, validation_share=0.1, rows=int(sys.argv[3]),
                     validation_horizon=0.1, rollout_horizon=0.1, starts=20, stride=2),
      trainer=partial(lightning.Trainer, accelerator="cpu", devices=2, strategy="ddp",
                      use_distributed_sampler=sys.argv[4] == "sampler", enable_model_summary=False,
                      enable_progress_bar=False))
"""


def in_two_processes(dataset, directory, rows, sampler):
    (directory / "program.py").write_text(PROGRAM)
    path = dataset.save(directory / "runs.h5")
    return subprocess.run([sys.executable, "program.py", path, directory / "run", str(rows), sampler], cwd=directory,
                          capture_output=True, text=True, timeout=300)


@pytest.mark.slow
@pytest.mark.parametrize("rows", [40, 36])
def test_two_processes_find_what_one_finds(dataset, tmp_path, rows):
    """From 39 and from 42 segments: also where the processes cannot share them evenly."""
    alone = fitted(dataset, tmp_path / "alone", module=partial(MODULE, rows=rows)).model
    ended = in_two_processes(dataset, tmp_path, rows, "")
    assert ended.returncode == 0, ended.stderr
    closed_form = load_model(tmp_path / "run" / "checkpoints" / "closed_form" / "last.ckpt")[0]
    assert_same_model(closed_form, alone, 1e-9)
    refined = load_model(tmp_path / "run" / "checkpoints" / "refinement" / "last.ckpt")[0]
    assert not torch.equal(refined.drift_table, closed_form.drift_table)


@pytest.mark.slow
def test_two_processes_with_a_sampler_that_repeats_segments_are_refused(dataset, tmp_path):
    ended = in_two_processes(dataset, tmp_path, 64, "sampler")
    assert ended.returncode != 0 and "set trainer.use_distributed_sampler=false" in ended.stderr
