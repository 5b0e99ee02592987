"""A copy of a checkpoint's model beside it, as FILE.safetensors, which can be read without Torch."""

from __future__ import annotations

import hashlib
from pathlib import Path

from ssmr_torch.deployment.tables import load_tables, save_tables
from ssmr_torch.models.base import Model


def save_twin(checkpoint: str | Path, model: Model, card: dict) -> Path:
    """Write the model and its card beside the checkpoint, with the checkpoint's hash; read it with `load_twin`."""
    path = _twin(checkpoint)
    save_tables(path, model, card=card, checkpoint=_sha256(checkpoint))
    return path


def load_twin(checkpoint: str | Path) -> tuple[Model, dict] | None:
    """The model copy beside a checkpoint, and its card; None where there is no copy, or where the hash differs."""
    path = _twin(checkpoint)
    if not (path.is_file() and Path(checkpoint).is_file()):
        return None
    try:
        model, noted = load_tables(path)
        return (model, noted["card"]) if noted["checkpoint"] == _sha256(checkpoint) else None
    except (ValueError, KeyError):
        return None


def _twin(checkpoint: str | Path) -> Path:
    return Path(checkpoint).with_suffix(".safetensors")


def _sha256(path: str | Path) -> str:
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
