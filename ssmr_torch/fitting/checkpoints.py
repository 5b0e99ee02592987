"""Fitted models as checkpoint files: save and load."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path

import torch
from lightning.fabric.plugins import CheckpointIO

from ssmr_torch import checksum
from ssmr_torch.deployment.checkpoint_copy import save_twin
from ssmr_torch.fitting.lightning_fit import description
from ssmr_torch.models.base import Model
from ssmr_torch.models.torch_model import TorchModel
from ssmr_torch.named_classes import class_named
from ssmr_torch.result_files import save_bytes

FORMAT = "ssmr_torch checkpoint 2"
BEFORE = "ssmr_torch checkpoint 1"  # of versions up to 0.11, without a checksum; they do not name it


class Checkpoints(CheckpointIO):
    """How Lightning writes and reads the checkpoints of a fit: aside, with a checksum, then renamed; of plain values
    only.
    """

    def save_checkpoint(self, checkpoint: dict, path, storage_options=None) -> None:
        save_bytes(Path(path), packed(checkpoint), sealed=True)

    def load_checkpoint(self, path, map_location=None, weights_only: bool | None = True) -> dict:
        return load_plain(path)

    def remove_checkpoint(self, path) -> None:
        Path(path).unlink(missing_ok=True)


def packed(content: dict) -> bytes:
    """The bytes of a checkpoint file. They are made in memory: Torch ends the process where a disk is full."""
    torch.save({"format": FORMAT, **content}, memory := io.BytesIO())
    return memory.getvalue()


def save_model(path: Path, model: TorchModel, card: dict) -> Path:
    """Write the fitted model in the form that `load_model` reads, and next to it a copy that needs no Torch, see
    `save_twin`.
    """
    # every process of a distributed run writes the same content
    save_bytes(path, packed({"model": description(model), "card": card, "state_dict": {
        f"model.{name}": value for name, value in model.state_dict().items()}}), sealed=True)
    save_twin(path, model.reduced.numpy(), card)
    return path


def load_model(checkpoint: str | Path) -> tuple[TorchModel, dict]:
    """The model of a checkpoint, and the card of its data. Only plain values are unpickled.

    Raises FileNotFoundError, or ValueError for a checkpoint that holds no model of this package.
    """
    if not Path(checkpoint).is_file():
        raise FileNotFoundError(f"there is no checkpoint at {checkpoint}; ssmr train prints the path of its checkpoint")
    stored = load_plain(checkpoint)
    try:
        module, _, name = stored["model"]["class"].rpartition(".")
        kind = class_named(f"{module}:{name}", TorchModel)
        model = kind(**stored["model"]["arguments"])
        model.load_state_dict({key.removeprefix("model."): value for key, value in stored["state_dict"].items()
                               if key.startswith("model.")})
        return model, stored["card"]
    except (LookupError, TypeError, ValueError, RuntimeError, ImportError, AttributeError, ArithmeticError,
            MemoryError) as error:
        raise ValueError(f"{checkpoint} holds no model of this package ({error}); expected one written by "
                         "ssmr train") from error


def load_plain(checkpoint: str | Path) -> dict:
    """What a checkpoint file holds. Raises ValueError where that is not plain values alone, and `checksum.Damaged`,
    which is one, for a damaged file.
    """
    sealed = checksum.check(checkpoint) is not None
    try:
        _refuse_compressed(checkpoint)
        content = torch.load(checkpoint, map_location="cpu", weights_only=True)
    except Exception as error:  # torch raises many types of errors here, and its message advises unsafe loading
        raise ValueError(f"{checkpoint} cannot be read as a checkpoint of plain values; expected one written by "
                         "ssmr train") from error
    if not isinstance(content, dict):
        raise ValueError(f"{checkpoint} holds a {type(content).__name__}; expected one written by ssmr train")
    checksum.refuse_unsealed(checkpoint, sealed, content.get("format", BEFORE), BEFORE)
    return content


def _refuse_compressed(checkpoint: str | Path) -> None:
    """Raises ValueError for an archive that would be larger in memory than it is; Torch writes none."""
    with zipfile.ZipFile(checkpoint) as archive:
        size = sum(record.file_size for record in archive.infolist())
    if size > Path(checkpoint).stat().st_size:
        raise ValueError(f"{checkpoint} holds {size} bytes in {Path(checkpoint).stat().st_size}")


def load_arrays(checkpoint: str | Path) -> tuple[Model, dict]:
    """The model of a checkpoint as arrays, as an artifact holds it, and the card; errors as of `load_model`."""
    model, card = load_model(checkpoint)
    return model.reduced.numpy(), card
