"""Fitted models as checkpoint files: save, load, and check whether a run can be resumed."""

from __future__ import annotations

import os
from pathlib import Path

import torch

from ssmr_torch.deployment.checkpoint_copy import save_twin
from ssmr_torch.fitting.lightning_fit import description
from ssmr_torch.models.base import Model
from ssmr_torch.models.torch_model import TorchModel
from ssmr_torch.named_classes import class_named

DECISIVE = ("data", "outputs", "model", "module", "seed")


def save_model(path: Path, model: TorchModel, card: dict) -> Path:
    """Write the fitted model in the form that `load_model` reads, and next to it a copy that needs no Torch, see
    `save_twin`.
    """
    # every process of a distributed run writes the same content
    aside = path.with_name(f"{path.name}.{os.getpid()}.part")
    torch.save({"model": description(model), "card": card,
                "state_dict": {f"model.{name}": value for name, value in model.state_dict().items()}}, aside)
    os.replace(aside, path)
    save_twin(path, model.reduced.numpy(), card)
    return path


def load_model(checkpoint: str | Path) -> tuple[TorchModel, dict]:
    """The model of a checkpoint, and the card of its data. Only plain values are unpickled.

    Raises FileNotFoundError, or ValueError for a checkpoint that holds no model of this package.
    """
    if not Path(checkpoint).is_file():
        raise FileNotFoundError(f"there is no checkpoint at {checkpoint}; ssmr train prints the path of its checkpoint")
    try:
        stored = torch.load(checkpoint, map_location="cpu", weights_only=True)
    except Exception as error:  # torch raises many types of errors here, and its message advises unsafe loading
        raise ValueError(f"{checkpoint} cannot be read as a checkpoint of plain values; expected one written by "
                         "ssmr train") from error
    try:
        module, _, name = stored["model"]["class"].rpartition(".")
        kind = class_named(f"{module}:{name}", TorchModel)
        model = kind(**stored["model"]["arguments"])
        model.load_state_dict({key.removeprefix("model."): value for key, value in stored["state_dict"].items()
                               if key.startswith("model.")})
        return model, stored["card"]
    except (LookupError, TypeError, ValueError, RuntimeError, ImportError, AttributeError) as error:
        raise ValueError(f"{checkpoint} holds no model of this package ({error}); expected one written by "
                         "ssmr train") from error


def load_arrays(checkpoint: str | Path) -> tuple[Model, dict]:
    """The model of a checkpoint as arrays, as an artifact holds it, and the card; errors as of `load_model`."""
    model, card = load_model(checkpoint)
    return model.reduced.numpy(), card


def check_resumable(directory: Path, steps: tuple[str, ...], origin: dict) -> None:
    """Check that the fits `steps` can continue from the checkpoints below `directory` with this configuration.

    Raises ValueError if there are no checkpoints, or if data, model, module, seed or the fit were configured
    differently. The message names the first difference with both values.
    """
    begun = [step for step in steps if (directory / step / "last.ckpt").is_file()]
    if not begun:
        raise ValueError(f"resume=true, but there are no checkpoints below {directory}; give the directory of the run "
                         "to continue as hydra.run.dir")
    now = origin.get("configuration", {})
    for step in begun:
        then = load_model(directory / step / "last.ckpt")[1].get("training", {}).get("configuration", {})
        pairs = [(name, then.get(name), now.get(name)) for name in DECISIVE]
        pairs.append((f"fit.{step}", then.get("fit", {}).get(step), now.get("fit", {}).get(step)))
        for name, old, new in pairs:
            if old != new:
                key, old, new = _difference(name, old, new)
                raise ValueError(f"the run in {directory.parent} was started with {key}={old}, but now it is {new}; "
                                 "resume it with the old value, or start a new run")


def _difference(name: str, old, new) -> tuple:
    """The first key in which two configurations differ, and both values."""
    if isinstance(old, dict) and isinstance(new, dict):
        for key in sorted(old.keys() | new.keys()):
            if old.get(key) != new.get(key):
                return _difference(f"{name}.{key}", old.get(key), new.get(key))
    return name, old, new
