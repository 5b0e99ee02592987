"""A copy of a checkpoint's model beside it, as FILE.safetensors, which can be read without Torch."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np

from ssmr_torch import checksum
from ssmr_torch.deployment.tables import class_of, load_tables, save_tables
from ssmr_torch.models.base import Model

FORMAT = "ssmr_torch copy 2"
BEFORE = "ssmr_torch copy 1"  # of versions up to 0.11, without a checksum; they do not name it


def save_twin(checkpoint: str | Path, model: Model, card: dict) -> Path:
    """Write the model and its card beside the checkpoint, with the checkpoint's hash; read it with `load_twin`."""
    path = _twin(checkpoint)
    noted = {"format": FORMAT, "card": card, "checkpoint": _sha256(checkpoint)}
    save_tables(path, model, **noted, content=_content(model, noted))
    return path


def load_twin(checkpoint: str | Path) -> tuple[Model, dict] | None:
    """The model copy beside a checkpoint, and its card; None where there is no copy, where it is damaged, or where it
    belongs to another checkpoint.
    """
    path = _twin(checkpoint)
    if not (path.is_file() and Path(checkpoint).is_file()):
        return None
    try:
        model, noted = load_tables(path)
        noted = {name: each for name, each in noted.items() if name not in ("class", "plain")}
        given = noted.pop("content", None)
        checksum.refuse_unsealed(path, given is not None, noted.get("format", BEFORE), BEFORE)
        same = noted["checkpoint"] == _sha256(checkpoint) and given in (None, _content(model, noted))
        return (model, noted["card"]) if same else None
    except (ValueError, KeyError):
        return None


def _content(model: Model, noted: dict) -> str:
    """SHA-256 of everything that the copy holds."""
    text = json.dumps([class_of(model), model.plain(), noted], sort_keys=True)
    found = hashlib.sha256(text.encode())
    for name, array in sorted(model.arrays.items()):
        found.update(f"{name} {array.dtype} {array.shape}".encode() + np.ascontiguousarray(array).tobytes())
    return found.hexdigest()


def _twin(checkpoint: str | Path) -> Path:
    return Path(checkpoint).with_suffix(".safetensors")


def _sha256(path: str | Path) -> str:
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
