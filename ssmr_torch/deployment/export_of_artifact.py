"""A model and what is known of it → an artifact with its deployable forms, which appear together or not at all."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path

from ssmr_torch.deployment import artifact
from ssmr_torch.deployment.exported_programs import Form, deploy
from ssmr_torch.models.base import Model
from ssmr_torch.provenance import fingerprint, provenance


def source_of(directory: str | Path, checkpoint: str | None, mat: str | None) -> str | None:
    """The file that the model is read from; None where the directory is an artifact whose forms are to be written.

    Raises ValueError where both files are given, or neither a file nor an artifact.
    """
    given = [source for source in (checkpoint, mat) if source is not None]
    if len(given) > 1 or not given and not (Path(directory) / "card.json").is_file():
        raise ValueError("give either checkpoint=FILE.ckpt or mat=FILE.mat, or artifact=DIR of an existing artifact, "
                         "to write its deployable forms")
    if mat is not None and find_spec("ssmr_torch.paper") is None:
        raise ValueError(f"mat={mat} is a model that the paper's authors published; ssmr_torch/paper reads it, "
                         "which is not installed here")
    return given[0] if given else None


def save_with_forms(directory: str | Path, model: Model, card: Mapping, formats: Sequence[str], *, source: str,
                    name: str | None = None) -> list[Form]:
    """Save an artifact with these forms (see `deploy`), and load it again, which replays its reference batch.

    card: what a checkpoint or a published file says of the model: name, output_names, input_names, rest (m),
    input_range, input_unit, and where known scores, cost, sampling_time (s), output_range, training, data.
    source: the file of the model, whose hash the artifact keeps.   name: None takes the card's.
    Raises ValueError as `artifact.save` and `deploy` do.
    """
    forms: list[Form] = []
    artifact.save(directory, model, name=name or card["name"], output_names=card["output_names"],
                  input_names=card["input_names"], rest=card["rest"], input_range=card["input_range"],
                  input_unit=card["input_unit"], scores=card.get("scores"), cost=card.get("cost"),
                  sampling_time=card.get("sampling_time"), output_range=card.get("output_range"),
                  provenance=provenance() | {"source": fingerprint(source), "training": card.get("training"),
                                             "data": card.get("data")},
                  complete=lambda aside: forms.extend(deploy(aside, formats)))
    artifact.load(directory)
    return forms
