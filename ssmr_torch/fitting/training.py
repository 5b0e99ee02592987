"""`train`: fits a model to a dataset by a closed-form fit and further fits, with checkpoints and scores."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from types import MappingProxyType

import lightning
import numpy as np
import torch
from lightning.pytorch.callbacks import ModelCheckpoint
from lightning.pytorch.utilities import rank_zero_only

from ssmr_torch.checked_arguments import checked
from ssmr_torch.data.datamodule import TrajectoryDataModule
from ssmr_torch.data.derivatives import Stencil
from ssmr_torch.data.refusals import refuse_still_inputs
from ssmr_torch.fitting import resumption
from ssmr_torch.fitting.checkpoints import Checkpoints, load_model, load_plain, save_model
from ssmr_torch.fitting.constructor_checks import check_call, default_of, sized_model
from ssmr_torch.fitting.fit_warnings import diagnose
from ssmr_torch.fitting.koopman_least_squares import KoopmanLeastSquares
from ssmr_torch.fitting.lightning_fit import LeastSquaresFit, ModelFit
from ssmr_torch.fitting.linear_start import LinearStart
from ssmr_torch.fitting.neural_ode_start import NeuralODEStart
from ssmr_torch.fitting.polynomial_least_squares import PolynomialLeastSquares
from ssmr_torch.fitting.ssmr_least_squares import SSMRLeastSquares
from ssmr_torch.fitting.streamed_least_squares import PENALTIES
from ssmr_torch.keywords import configurable
from ssmr_torch.models.koopman import Koopman
from ssmr_torch.models.neural_ode import NeuralODE
from ssmr_torch.models.ssmr import SSMR
from ssmr_torch.models.torch_model import PolynomialTorchModel, TorchModel
from ssmr_torch.quantities import RIDGE
from ssmr_torch.ranges import OneOf, Whole
from ssmr_torch.trajectory import TrajectoryDataset

# The λ from which cross-validation chooses, by regression name; "default" is for regressions that are not named.
RIDGES = MappingProxyType({"default": (0.0, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3)})
FINE_RIDGES = MappingProxyType({"default": (0.0, 1e-10, 1e-9, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3)})

TRAINER = ("max_epochs", "callbacks", "logger", "num_sanity_val_steps", "check_val_every_n_epoch")
SCALES = ("state_scale", "scale")  # buffers that hold the range of the data; they do not count as parameters


@dataclass(frozen=True)
class Training:
    """A fitted model, its checkpoint, the scores of validation and test (m), its cost, and the report of each fit.

    cost: see `cost_of`; also fit_time, the CPU seconds for the fits, without the scores after them.
    """

    model: TorchModel
    checkpoint: Path
    scores: dict[str, float]
    cost: dict[str, float]
    report: dict[str, dict]

    def summary(self) -> str:
        """A few lines for the terminal: scores, regressions, warnings, and the path of the checkpoint."""
        lines = [f"{name}: {1e3 * value:.4g} mm" if "rmse" in name else f"{name}: {value:.4g}"
                 for name, value in sorted(self.scores.items())]
        for fit, report in self.report.items():
            lines += [f"{fit}: {name} from {r['rows']} rows, {r['features']} features, condition {r['condition']:.3g}, "
                      f"ridge {r['ridge']:g}, residual {100 * r['relative_residual']:.3g} %"
                      for name, r in report["regressions"].items()]
            lines += [f"{fit}: diverged training rollouts: " + ", ".join(
                f"{kind} {100 * share:.3g} %" for kind, share in report["diverged"].items())]
            lines += report.get("found", [])
            lines += [f"warning: {warning}" for warning in report["warnings"]]
        lines.append("cost: " + ", ".join(f"{name} {value:.4g}" for name, value in self.cost.items()))
        return "\n".join([*lines, f"checkpoint: {self.checkpoint}"])


@configurable(SSMRLeastSquares)
@checked(ridge=RIDGE, folds=Whole(2, 1000))
def least_squares(model: SSMR, *, ridge: float | Sequence | Mapping = FINE_RIDGES, folds: int = 5,
                  derivative: Stencil | None = None, **options) -> LeastSquaresFit:
    """Closed-form fit of an SSMR; options as in `SSMRLeastSquares`, ridge and folds as in `LeastSquaresFit`."""
    return LeastSquaresFit(SSMRLeastSquares(model, derivative=derivative, **options), ridge, folds)


@configurable(PolynomialLeastSquares)
@checked(ridge=RIDGE, folds=Whole(2, 1000))
def polynomial_least_squares(model: PolynomialTorchModel, *, ridge: float | Sequence | Mapping = RIDGES,
                             folds: int = 5, derivative: Stencil | None = None, **options) -> LeastSquaresFit:
    """Closed-form fit of any polynomial model; options as in `PolynomialLeastSquares`."""
    return LeastSquaresFit(PolynomialLeastSquares(model, derivative=derivative, **options), ridge, folds)


@configurable(PolynomialLeastSquares)
@checked(ridge=RIDGE, folds=Whole(2, 1000))
def linear_start(model: TorchModel, *, ridge: float | Sequence | Mapping = RIDGES, folds: int = 5,
                 **options) -> LeastSquaresFit:
    """Closed-form fit of a linear model, from which any other model starts; options as in `PolynomialLeastSquares`."""
    return LeastSquaresFit(LinearStart(model, **options), ridge, folds)


@configurable(KoopmanLeastSquares)
@checked(ridge=RIDGE, folds=Whole(2, 1000), penalty=OneOf(*sorted(PENALTIES)))
def koopman_least_squares(model: Koopman, *, ridge: float | Sequence | Mapping = FINE_RIDGES, folds: int = 5,
                          penalty: str = "ridge", **options) -> LeastSquaresFit:
    """Closed-form fit of a Koopman model; options as in `KoopmanLeastSquares`, others as in `LeastSquaresFit`."""
    return LeastSquaresFit(KoopmanLeastSquares(model, **options), ridge, folds, penalty)


@configurable(SSMRLeastSquares)
@checked(ridge=RIDGE, folds=Whole(2, 1000))
def neural_ode_start(model: NeuralODE, *, ridge: float | Sequence | Mapping = RIDGES, folds: int = 5,
                     derivative: Stencil | None = None, **options) -> LeastSquaresFit:
    """Closed-form start of a neural ODE; options as in `SSMRLeastSquares`."""
    return LeastSquaresFit(NeuralODEStart(model, derivative=derivative, **options), ridge, folds)


def train(dataset: TrajectoryDataset, *, model: Callable[..., TorchModel],
          fits: Mapping[str, Callable[..., ModelFit]], module: Callable[..., TrajectoryDataModule],
          trainer: Callable[..., lightning.Trainer], directory: str | Path, name: str = "SSMR",
          loggers: list | bool = False, resume: bool = False, origin: dict | None = None,
          starting: Callable[[], object] = lambda: None) -> Training:
    """Fit one model by each of `fits` in turn, score it, and report on the fits.

    name: name of the model in tables and figures. model, fits, module, trainer: callables, each a class, a function or
    a functools.partial of one. model takes input_dim, output_dim and timestep by keyword, see `sized_model`. If it
    takes state_dim, this has a default: a number or a rule of `choose_dimension`. fits take the model. module takes the
    dataset by keyword. trainer takes the settings `TRAINER` of Lightning's trainer.
    Checkpoints go to directory/checkpoints/FIT: the one with the best validation error for a refinement, the last one
    for a closed-form fit. A refinement that does not lower the validation error is undone. A fit with 0 epochs is left
    out. The fitted model goes to directory/model.ckpt. origin: provenance of this training with its configuration; it
    is stored in the checkpoints. resume: continue from existing checkpoints, with the result of a training that was not
    interrupted; other data, another configuration and another version are refused, see `resumption`. starting: called
    once, before the first fit, when nothing is refused any more.
    Raises ValueError for data or options that cannot be fitted, before any work.
    """
    directory = Path(directory)
    for step, build in fits.items():
        check_call(f"fits[{step!r}]", build, "the model")
    check_call("module", module, dataset=dataset)
    check_call("trainer", trainer, **dict.fromkeys(TRAINER))
    fits = {step: build for step, build in fits.items() if default_of(step, build, "epochs") != 0}
    prepared = module(dataset=dataset)
    reduced = sized_model(model, dataset, prepared)
    card = data_card(dataset, prepared.training) | {"name": name, "training": origin or {}}
    folder, begun = directory / "checkpoints", False
    decisive = resumption.fingerprint(dataset, card["training"].get("configuration", {}))
    if resume:
        resumption.go_on(folder, tuple(fits), decisive)
    scores, report, fit_time = {}, {}, 0.0
    for step, build in fits.items():
        fit = build(reduced)
        if fit.epochs == 0:
            continue
        fit.card, fit.overdrive, fit.overspeed = card, prepared.overdrive, prepared.overspeed
        prepared.prepare(fit)
        if not (begun or resume) and rank_zero_only.rank == 0:
            resumption.begin(folder, decisive)  # here, as a refusal leaves what an earlier run has made
        if not begun:
            starting()
        begun = True
        scores, undone = _run(fit, prepared, trainer, folder / step, loggers, resume)
        fit_time += fit.spent
        report[step] = diagnose(fit, prepared.training, prepared.transient)
        report[step]["warnings"] += [undone] if undone else []
    cost = cost_of(reduced, prepared) | {"fit_time": fit_time}
    checkpoint = save_model(directory / "model.ckpt", reduced, card | {"scores": scores, "cost": cost})
    return Training(reduced, checkpoint, scores, cost, report)


def cost_of(model: TorchModel, module: TrajectoryDataModule) -> dict[str, float]:
    """Cost of a model: state_dim, parameters (stored nonzero numbers without `SCALES`), decays and controlled_samples
    of the training, and step_time, s, the median time of a linearized step in NumPy.
    """
    reduced, z, u = model.reduced.numpy(), np.zeros(model.state_dim), np.zeros(model.input_dim)
    times = []
    for _ in range(30):
        start = perf_counter()
        reduced.linearize(z, u)
        times.append(perf_counter() - start)
    stored = [table for name, table in model.state_dict().items() if name not in SCALES]
    return {"state_dim": float(model.state_dim), "parameters": float(sum(map(torch.count_nonzero, stored))),
            "decays": float(sum(run.kind == "decay" for run in module.training)),
            "controlled_samples": float(sum(run.length for run in module.training if run.kind == "controlled")),
            "step_time": float(np.median(times))}


def data_card(dataset: TrajectoryDataset, training: tuple) -> dict:
    """Information on the data for a deployed model: names, units, rest, range of inputs and outputs, provenance.

    Raises ValueError if an input never changes, or nothing is left to train with.
    """
    if not training:
        raise ValueError("no training run is left; record some, or use more decays or a longer controlled_duration of "
                         "the data module")
    extremes = [run.extremes() for run in training]
    refuse_still_inputs(dataset, extremes)
    outputs, inputs = (np.stack(ranges) for ranges in zip(*extremes))
    lowest, highest = inputs[:, 0].min(0), inputs[:, 1].max(0)
    return {"output_names": list(dataset.output_names), "input_names": list(dataset.input_names),
            "input_unit": dataset.input_unit, "sampling_time": dataset.timestep, "rest": dataset.rest.tolist(),
            "input_range": [lowest.tolist(), highest.tolist()],
            "output_range": [outputs[:, 0].min(0).tolist(), outputs[:, 1].max(0).tolist()],
            "data": dataset.provenance}


def _run(fit: ModelFit, module: TrajectoryDataModule, build_trainer: Callable, directory: Path, loggers,
         resume: bool) -> tuple[dict[str, float], str]:
    """Scores of the fitted model, and a sentence if the fit was undone."""
    validated = bool(module.validation)
    keep = ModelCheckpoint(dirpath=directory, filename="best", save_last=True, enable_version_counter=False,
                           monitor=fit.monitor if validated and fit.selects else None,
                           save_on_train_epoch_end=not fit.selects or None)
    try:
        trainer = build_trainer(max_epochs=fit.epochs, callbacks=[keep], logger=loggers, num_sanity_val_steps=0,
                                check_val_every_n_epoch=1 if fit.selects else fit.epochs + 1)  # it is scored below
    except TypeError as error:
        raise ValueError(f"the trainer cannot be built: {error}") from error
    trainer.strategy.checkpoint_io = Checkpoints()
    last = directory / resumption.LAST
    before = {name: value.clone() for name, value in fit.model.state_dict().items()}
    bar = None
    if fit.selects and validated:
        bar = trainer.validate(fit, module, verbose=False)[0][fit.monitor]
    kept = load_plain(last) if resume and last.is_file() else None
    if kept is not None and kept["fit"]["finished"]:
        fit.take(kept)
        keep.load_state_dict(kept["callbacks"][keep.state_key])
    else:
        trainer.fit(fit, module, ckpt_path=None if kept is None else str(last), weights_only=True)
        fit.pause()
    best = float("nan") if bar is None else float(keep.best_model_score)
    improved = bar is None or best <= bar
    fit.model.load_state_dict(load_model(keep.best_model_path or last)[0].state_dict() if improved else before)
    scores = {}
    for run, available in ((trainer.validate, validated), (trainer.test, bool(module.test))):
        if available:
            scores |= run(fit, module, verbose=False)[0]
    undone = "" if improved else (f"The refinement was undone: its best validation error, {1e3 * best:.4g} mm, is not "
                                  f"below that of the model before it, {1e3 * bar:.4g} mm.")
    return {name: float(value) for name, value in scores.items()}, undone
