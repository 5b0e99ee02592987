"""`fit`: fits a model of a given kind as `ssmr train model=KIND` does, on a dataset in memory and without files."""

from __future__ import annotations

import logging
import random
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from difflib import get_close_matches
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import lightning
import numpy as np
import torch

from ssmr_torch import configuration
from ssmr_torch.fitting.checkpoints import load_model
from ssmr_torch.fitting.options import dotted
from ssmr_torch.fitting.training import Training, train
from ssmr_torch.provenance import provenance
from ssmr_torch.quiet_libraries import LIGHTNING, quiet
from ssmr_torch.renamed import refuse_old_names
from ssmr_torch.trained_model import TrainedModel
from ssmr_torch.trajectory import TrajectoryDataset, refuse_other_data

GROUPS = ("fit", "derivative", "plant", "trainer", "robot", "settings")  # options that choose a file of conf/


def fit(data: TrajectoryDataset, kind: str | None = None, *, seed: int = 0, name: str | None = None,
        directory: str | Path | None = None, config_dir: str | Path | None = None, progress: bool | None = None,
        **options: Any) -> TrainedModel:
    """Fit a model to the training runs of a dataset, exactly as `ssmr train model=KIND` does, and score it.

    kind: a name of conf/model: "auto", a slow-fast model whose form is chosen from the training runs only (its options:
    `SelectionSettings`); "ssmr" (spectral submanifold), "sssr" (its linear counterpart), "dmd", "edmd",
    "edmd_bilinear", "ssmr_control_augmented", "neural_ode", "tpwl", …; None: "auto".
    options: keys of the configuration with their values. A key is named by its last part if only one key ends so
    (state_dim=8, transient=0.2 s, ridge=1e-6), or by its full name, **{"fit.refinement.epochs": 0}. fit, derivative,
    plant, robot and settings choose an option of conf/; settings="found": what a search found for the robot.
    seed: for all random numbers. name: shown in tables; default: the kind.
    directory: where the checkpoints and model.ckpt are written, as by the command; None: no file is written.
    config_dir: folder of your own configurations, like the command's --config-dir; its model/*.yaml are kinds as well.
    progress: True: progress bars and a summary; None: a summary, and bars only for a refinement; False: no output.

    Returns a `TrainedModel`. Raises TypeError for an option that does not exist and names the nearest one. Raises
    ValueError for data or values that cannot be fitted, before any work.

    >>> model = fit(data, "dmd", delays=1, progress=False)                             # data of an oscillator
    >>> window, inputs = data[-1].observation[:2], data[-1].input[1:4]
    >>> model.predict(window, inputs, past_inputs=data[-1].input[:1]).shape
    (3, 2)
    """
    refuse_other_data(data)
    chosen = _kind(kind, config_dir)
    refuse_old_names(f"{key}={value}" for key, value in options.items())
    groups = {group: options.pop(group) for group in GROUPS if isinstance(options.get(group), str)}
    for group, choice in groups.items():
        _check_choice(group, choice, group, config_dir)
    config = configuration.composed("train", [f"model={chosen}", "logger=csv", f"seed={seed}", *(
        f"{group}={choice}" for group, choice in groups.items())], config_dir=config_dir)
    plain = configuration.plain(config, without=("data", "logger", "name", "found"))
    given = {"name": name or chosen.upper()} | {f"fit.{step}.progress": False for step, node in plain["fit"].items()
                                                if progress is False and "progress" in node}
    given |= {key: _plain(value) for key, value in dotted(options, plain).items()}
    config = configuration.changed(config, given)
    choices = {"model": chosen, "robot": groups.get("robot"), "settings": groups.get("settings")}
    lines = configuration.settings_lines(config, choices)
    if progress is not False and (groups.keys() & {"robot", "settings"}):
        print(*lines, sep="\n")
    with TemporaryDirectory() as aside, _as_found():
        quiet()
        lightning.seed_everything(config.seed, workers=True, verbose=False)
        training, card = _trained(chosen, config, data, Path(directory or aside), progress)
    if progress is not False:
        print(_sentence(training, card))
    return TrainedModel(training.model.reduced.numpy(), card, training.model, training.report)


def _trained(kind: str, config, data: TrajectoryDataset, directory: Path,
             progress: bool | None) -> tuple[Training, dict]:
    """The training, and its entries for the model card of an artifact."""
    dataset = data.observing(config.outputs)
    plain = configuration.plain(config, without=("data", "logger"))
    made = provenance(plain) | {"name": config.name, "kind": kind}
    build = configuration.built(config.trainer)

    def trainer(**settings):
        # a closed-form fit takes a moment and needs no bar; a refinement validates after every epoch
        refines = settings["check_val_every_n_epoch"] == 1
        return build(**settings, enable_progress_bar=bool(progress) or progress is None and refines)

    training = train(dataset, model=configuration.built(config.model), module=configuration.built(config.module),
                     fits={step: configuration.built(node) for step, node in config.fit.items()}, trainer=trainer,
                     directory=directory, name=config.name, origin=made)
    _, card = load_model(training.checkpoint)
    return training, card | {"provenance": provenance() | {"training": made, "data": dataset.provenance}}


def _kind(kind: str | None, config_dir: str | Path | None) -> str:
    """The kind, "auto" for None. Raises ValueError for a kind that no folder has."""
    if kind is None:
        return "auto"
    refuse_unknown_kind(kind, config_dir)
    return kind


def refuse_unknown_kind(kind: str, config_dir: str | Path | None = None) -> None:
    """Raises ValueError for a kind of model that no configuration folder has, and names the nearest one."""
    _check_choice("kind of model", kind, "model", config_dir)


def _check_choice(what: str, choice, group: str, config_dir: str | Path | None) -> None:
    """Raises ValueError for an option that its group does not have, with the nearest one, and for an earlier name."""
    refuse_old_names([f"{group}={choice}"])
    known = configuration.options(group, config_dir)
    if choice not in known:
        near = get_close_matches(str(choice).lower(), known, n=1, cutoff=0.0)[0]
        raise ValueError(f"no {what} {choice!r}; did you mean {near!r}? There are {', '.join(known)}")


def _plain(value):
    """A value with the types of YAML: NumPy values and tuples are converted."""
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    if isinstance(value, (tuple, list)):
        return [_plain(each) for each in value]
    return {key: _plain(each) for key, each in value.items()} if isinstance(value, dict) else value


def _sentence(training: Training, card: dict) -> str:
    """One line about the fitted model, and one for each warning of the fit."""
    part = "test" if "test/rmse" in training.scores else "validation"
    score = training.scores.get(f"{part}/rmse")
    error = "" if score is None else f", {part} RMSE {1e3 * score:.3g} mm"
    cost = training.cost
    lines = [f"{card['name']}: {cost['state_dim']:.0f} states, {cost['parameters']:.0f} parameters from "
             f"{cost['decays']:.0f} decays and {cost['controlled_samples']:.0f} samples of controlled runs{error}"]
    lines += list(dict.fromkeys(line for report in training.report.values() for line in report.get("found", ())))
    lines += [f"warning: {warning}" for warning in dict.fromkeys(
        warning for report in training.report.values() for warning in report["warnings"])]
    return "\n".join(lines)


@contextmanager
def _as_found() -> Iterator[None]:
    """Restore the random number generators, warnings and log level afterwards, as a notebook expects."""
    log = logging.getLogger(LIGHTNING)
    states, level = (random.getstate(), np.random.get_state(), torch.get_rng_state()), log.level
    try:
        with warnings.catch_warnings():
            yield
    finally:
        random.setstate(states[0])
        np.random.set_state(states[1])
        torch.set_rng_state(states[2])
        log.setLevel(level)
