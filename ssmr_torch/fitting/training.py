"""From a dataset to a fitted model: closed form, then refinement where it is asked for."""

from __future__ import annotations

import importlib
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from inspect import signature
from pathlib import Path

import lightning
import numpy as np
import torch
from lightning.pytorch.callbacks import ModelCheckpoint

from ssmr_torch.data.datamodule import TrajectoryDataModule
from ssmr_torch.data.derivatives import Stencil
from ssmr_torch.fitting.diagnosis import diagnose
from ssmr_torch.fitting.dimension import choose_dimension
from ssmr_torch.fitting.fit import LeastSquaresFit, ModelFit, description
from ssmr_torch.fitting.ssmr_least_squares import SSMRLeastSquares
from ssmr_torch.models.base import ReducedModel
from ssmr_torch.models.ssmr import SSMR
from ssmr_torch.trajectory import TrajectoryDataset


@dataclass(frozen=True)
class Training:
    """A fitted model, its checkpoint, the scores of validation and test (m), and the report of each fit."""

    model: ReducedModel
    checkpoint: Path
    scores: dict[str, float]
    report: dict[str, dict]

    def summary(self) -> str:
        """A few lines for the terminal: scores, what determined the fit, warnings, where the checkpoint is."""
        lines = [f"{name}: {1e3 * value:.4g} mm" if "rmse" in name else f"{name}: {value:.4g}"
                 for name, value in sorted(self.scores.items())]
        for fit, report in self.report.items():
            lines += [f"{fit}: {name} from {r['rows']} rows, {r['features']} features, condition {r['condition']:.3g}, "
                      f"ridge {r['ridge']:g}, residual {100 * r['relative_residual']:.3g} %"
                      for name, r in report["regressions"].items()]
            lines += [f"{fit}: diverged training rollouts: " + ", ".join(
                f"{kind} {100 * share:.3g} %" for kind, share in report["diverged"].items())]
            lines += [f"look here: {warning}" for warning in report["warnings"]]
        return "\n".join([*lines, f"checkpoint: {self.checkpoint}"])


def least_squares(model: SSMR, *, ridge=0.0, folds: int = 5, derivative: Stencil | None = None,
                  **options) -> LeastSquaresFit:
    """Closed-form fit of an SSMR; options as in `SSMRLeastSquares`, ridge and folds as in `LeastSquaresFit`."""
    return LeastSquaresFit(SSMRLeastSquares(model, derivative=derivative, **options), ridge, folds)


def train(dataset: TrajectoryDataset, *, model: Callable[..., ReducedModel],
          fits: Mapping[str, Callable[..., ModelFit]], module: Callable[..., TrajectoryDataModule],
          trainer: Callable[..., lightning.Trainer], directory: str | Path, name: str = "SSMR",
          loggers: list | bool = False, resume: bool = False) -> Training:
    """Fit one model by each of `fits` in turn, score it, and say what the fit found.

    name: of the model, in tables and figures. model: constructor that still misses input_dim, output_dim and
    timestep, which the data give; its state_dim is a number or a rule of `choose_dimension`.
    Checkpoints go to directory/checkpoints/FIT, of a refinement the best by validation error, of a closed form the
    last; a refinement that does not lower the validation error is undone. The fitted model goes to
    directory/model.ckpt. resume: continue from the checkpoints already there.
    Raises ValueError for data or options that cannot be fitted, before any work.
    """
    directory = Path(directory)
    prepared = module(dataset=dataset)
    decays = [run for run in prepared.training if run.kind == "decay"] or list(prepared.training)
    state_dim = choose_dimension(model.keywords["state_dim"], decays, signature(model).parameters["delays"].default,
                                 prepared.transient)
    reduced = model(state_dim=state_dim, input_dim=dataset.input_dim, output_dim=dataset.output_dim,
                    timestep=dataset.timestep)
    card = data_card(dataset, prepared.training) | {"name": name}
    scores, report = {}, {}
    for step, build in fits.items():
        fit = build(reduced)
        fit.card = card
        scores = _run(fit, prepared.prepare(fit), trainer, directory / "checkpoints" / step, loggers, resume)
        report[step] = diagnose(fit, prepared.training, prepared.transient)
    checkpoint = save_model(directory / "model.ckpt", reduced, card | {"scores": scores})
    return Training(reduced, checkpoint, scores, report)


def data_card(dataset: TrajectoryDataset, training: tuple) -> dict:
    """What a deployed model must know of its data: names, units, rest, range of inputs and outputs, provenance."""
    inputs = np.stack([_range(run, 1) for run in training])
    outputs = np.stack([_range(run, 0) for run in training])
    return {"output_names": list(dataset.output_names), "input_names": list(dataset.input_names),
            "input_unit": dataset.input_unit, "rest": dataset.rest.tolist(),
            "input_bounds": [inputs[:, 0].min(0).tolist(), inputs[:, 1].max(0).tolist()],
            "output_range": [outputs[:, 0].min(0).tolist(), outputs[:, 1].max(0).tolist()],
            "data": dataset.provenance}


def save_model(path: Path, model: ReducedModel, card: dict) -> Path:
    """The fitted model alone, as `load_model` reads it; written aside, then renamed."""
    # every process of a distributed run writes the same
    aside = path.with_name(f"{path.name}.{os.getpid()}.part")
    torch.save({"model": description(model), "card": card,
                "state_dict": {f"model.{name}": value for name, value in model.state_dict().items()}}, aside)
    os.replace(aside, path)
    return path


def load_model(checkpoint: str | Path) -> tuple[ReducedModel, dict]:
    """The model of a checkpoint and the card of its data; nothing is unpickled but plain values.

    Raises FileNotFoundError, or ValueError for a checkpoint of something else.
    """
    if not Path(checkpoint).is_file():
        raise FileNotFoundError(f"no checkpoint at {checkpoint}; train.py prints the path of the one it writes")
    try:
        stored = torch.load(checkpoint, map_location="cpu", weights_only=True)
    except Exception as error:  # torch raises what its unpickler meets, and advises to load unsafely
        raise ValueError(f"{checkpoint} is not a checkpoint of plain values; expected one written by "
                         "experiments/train.py") from error
    try:
        module, _, name = stored["model"]["class"].rpartition(".")
        if not module.startswith("ssmr_torch.models."):
            raise ValueError(f"its class is {stored['model']['class']!r}")
        model = getattr(importlib.import_module(module), name)(**stored["model"]["arguments"])
        model.load_state_dict({key.removeprefix("model."): value for key, value in stored["state_dict"].items()
                               if key.startswith("model.")})
        return model, stored["card"]
    except (LookupError, TypeError, ValueError, RuntimeError, ImportError, AttributeError) as error:
        raise ValueError(f"{checkpoint} holds no model of this package ({error}); expected one written by "
                         "experiments/train.py") from error


def _run(fit: ModelFit, module: TrajectoryDataModule, build_trainer: Callable, directory: Path, loggers,
         resume: bool) -> dict[str, float]:
    validated = bool(module.validation)
    closed_form = isinstance(fit, LeastSquaresFit)
    keep = ModelCheckpoint(dirpath=directory, filename="best", save_last=True, enable_version_counter=False,
                           monitor="validation/rmse" if validated and not closed_form else None,
                           save_on_train_epoch_end=closed_form or None)
    trainer = build_trainer(max_epochs=fit.epochs, callbacks=[keep], logger=loggers, num_sanity_val_steps=0,
                            check_val_every_n_epoch=fit.epochs if closed_form else 1)
    last = directory / "last.ckpt"
    before = {name: value.clone() for name, value in fit.model.state_dict().items()}
    bar = None if closed_form or not validated else trainer.validate(fit, module, verbose=False)[0]["validation/rmse"]
    trainer.fit(fit, module, ckpt_path=str(last) if resume and last.is_file() else None, weights_only=True)
    improved = bar is None or float(keep.best_model_score) <= bar
    fit.model.load_state_dict(load_model(keep.best_model_path or last)[0].state_dict() if improved else before)
    scores = {}
    for run, available in ((trainer.validate, validated), (trainer.test, bool(module.test))):
        if available:
            scores |= run(fit, module, verbose=False)[0]
    return {name: float(value) for name, value in scores.items()}


def _range(trajectory, which: int) -> np.ndarray:
    """(2, columns): lowest and highest value, read in stretches."""
    stretches = [trajectory.slice(start, min(start + 65536, trajectory.length))[which]
                 for start in range(0, trajectory.length, 65536)]
    return np.stack([np.min([s.min(0) for s in stretches], axis=0), np.max([s.max(0) for s in stretches], axis=0)])
