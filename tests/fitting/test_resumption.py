"""A training that was interrupted ends as one that was not, to the bit, and goes on with the same data only."""

from dataclasses import replace
from functools import partial

import lightning
import numpy as np
import pytest
import torch

from ssmr_torch.data.datamodule import TrajectoryDataModule
from ssmr_torch.fitting.gauss_newton import GaussNewtonFit
from ssmr_torch.fitting.gradient_fit import GradientFit
from ssmr_torch.fitting.stability import GuardFit
from ssmr_torch.fitting.training import least_squares, train
from ssmr_torch.models.ssmr import SSMR
from ssmr_torch.result_files import read_json, save_json

TRAINER = partial(lightning.Trainer, accelerator="cpu", devices=1, use_distributed_sampler=False,
                  enable_model_summary=False, enable_progress_bar=False)
MODEL = partial(SSMR, state_dim=2, delays=0, parametrization_degree=2, dynamics_degree=2)
MODULE = partial(TrajectoryDataModule, transient=0.0, validation_share=0.1, rows=64, validation_horizon=0.1,
                 rollout_horizon=0.1, starts=20, stride=12, batch_size=32)
CLOSED_FORM = {"closed_form": partial(least_squares, ridge=[0.0, 1e-8])}
REFINEMENTS = {
    "gradient": {"refinement": partial(GradientFit, epochs=4, learning_rate=3e-3, first_share=0.5)},
    "patience": {"refinement": partial(GradientFit, epochs=6, learning_rate=10.0, patience=2)},
    "gauss_newton": {"refinement": partial(GaussNewtonFit, epochs=4, starts=30, horizon=0.1, samples=4, tolerance=0.0),
                     "guard": GuardFit}}
ORIGIN = {"configuration": {"model": {"state_dim": 2}, "seed": 0}}

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning:lightning", "ignore:.*LeafSpec")


class Killed(BaseException):
    """As a process that ends at once would."""


class Kill(lightning.Callback):
    def __init__(self, step, epoch):
        self.step, self.epoch = step, epoch

    def on_train_epoch_start(self, trainer, fit):
        if trainer.checkpoint_callback.dirpath.endswith(self.step) and trainer.current_epoch == self.epoch:
            raise Killed


@pytest.fixture(scope="module")
def dataset(known):
    return known.dataset()


def fitted(dataset, directory, fits, *, seed=3, kill=None, **options):
    lightning.seed_everything(seed, verbose=False)

    def trainer(callbacks, **settings):
        return TRAINER(callbacks=[*callbacks, *([Kill(*kill)] if kill else [])], **settings)

    return train(dataset, directory=directory, model=MODEL, module=MODULE, fits=CLOSED_FORM | fits, trainer=trainer,
                 **{"origin": ORIGIN} | options)


@pytest.mark.parametrize("kind", REFINEMENTS)
@pytest.mark.parametrize("moments", [
    [("closed_form", 1), ("refinement", 2)], pytest.param([("refinement", 0)], marks=pytest.mark.slow),
    pytest.param([("refinement", 1), ("refinement", 3)], marks=pytest.mark.slow)], ids=str)
def test_killed_and_resumed_a_training_gives_the_same_bits(dataset, tmp_path, kind, moments):
    whole = fitted(dataset, tmp_path / "whole", REFINEMENTS[kind])
    for number, moment in enumerate(moments):
        try:
            fitted(dataset, tmp_path / "parts", REFINEMENTS[kind], kill=moment, resume=number > 0)
        except Killed:
            pass
    parts = fitted(dataset, tmp_path / "parts", REFINEMENTS[kind], resume=True)
    for name, value in whole.model.state_dict().items():
        assert torch.equal(parts.model.state_dict()[name], value), name
    assert parts.scores == whole.scores and parts.report == whole.report


def test_a_fit_that_ended_early_is_not_continued(dataset, tmp_path):
    first = fitted(dataset, tmp_path, REFINEMENTS["patience"])
    again = fitted(dataset, tmp_path, REFINEMENTS["patience"], resume=True, kill=("refinement", 3))
    assert again.scores == first.scores


@pytest.fixture(scope="module")
def begun(dataset, tmp_path_factory):
    directory = tmp_path_factory.mktemp("begun")
    fitted(dataset, directory, {})
    return directory


def tripled(dataset, name):
    return replace(dataset, trajectories=tuple(
        replace(run, observation=3 * run.observation) if run.name == name else run for run in dataset))


def test_other_data_are_refused_with_what_differs(dataset, begun):
    read = dataset.provenance | {"sources": {"c1.csv": "0", "c2.csv": "1"}}
    cases = {
        "data differ: the samples of controlled-1": tripled(dataset, "controlled-1"),
        "data differ: c1.csv and .*|data differ: c1.csv, c2.csv": replace(tripled(dataset, "controlled-1"),
                                                                            provenance=read),
        r"data differ: rest was \[.* mm, now it is \[1.0, 2.0, 3.0, 100.0\] mm": replace(
            dataset, rest=np.array([1e-3, 2e-3, 3e-3, 0.1])),
        "data differ: they are now without the run decay-0": replace(dataset, trajectories=tuple(dataset)[1:]),
        "data differ: the split of decay-0 was train, now it is test": replace(dataset, trajectories=tuple(
            replace(run, split="test") if run.name == "decay-0" else run for run in dataset))}
    before = {path: path.read_bytes() for path in begun.rglob("*") if path.is_file()}
    for words, other in cases.items():
        with pytest.raises(ValueError, match=f"{begun} cannot be resumed: ({words}); resume it as it was"):
            fitted(other, begun, {}, resume=True)
    assert before == {path: path.read_bytes() for path in begun.rglob("*") if path.is_file()}


def test_another_configuration_or_version_is_refused_and_another_bar_is_not(dataset, begun):
    changed = {"configuration": {"model": {"state_dim": 4}, "seed": 0}}
    with pytest.raises(ValueError, match="it was started with model.state_dim=2, but now it is 4"):
        fitted(dataset, begun, {}, resume=True, origin=changed)
    harmless = {"configuration": ORIGIN["configuration"] | {"trainer": {"enable_progress_bar": True}}}
    fitted(dataset, begun, {}, resume=True, origin=harmless)
    path = begun / "checkpoints" / "training.json"
    now = path.read_text()
    save_json(path, read_json(path) | {"version": "0.0.1"})
    with pytest.raises(ValueError, match="started by version 0.0.1, but this is version"):
        fitted(dataset, begun, {}, resume=True)
    path.write_text("{")
    with pytest.raises(ValueError, match="with what data a run was started, is missing or damaged"):
        fitted(dataset, begun, {}, resume=True)
    path.write_text(now)


def test_a_training_from_its_start_leaves_nothing_of_an_earlier_one(dataset, tmp_path):
    fitted(dataset, tmp_path, REFINEMENTS["gradient"])
    (tmp_path / "report.json").write_text("{}")
    with pytest.raises(Killed):
        fitted(dataset, tmp_path, {}, kill=("closed_form", 0))
    assert [path.name for path in tmp_path.rglob("*") if path.is_file()] == ["training.json"]
    with pytest.raises(ValueError, match="fits"):
        fitted(dataset, tmp_path, {"refinement": None})
