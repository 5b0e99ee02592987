"""A deployable model: a directory with tables, a card, and a reference prediction that loading replays.

    tables.safetensors     the coefficient tables, float64
    reference.safetensors  seeded windows, states and inputs, and what the model made of them
    card.json              kind, shapes, units, sampling time, provenance, scores
    deployed/              where asked for: the model in C, as Torch programs, as ONNX graphs; see docs/deployment.md

Loading needs NumPy and safetensors only, and never unpickles anything.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from safetensors.numpy import load_file, save_file

from ssmr_torch.models.control_augmented_tables import ControlAugmentedTables
from ssmr_torch.models.koopman_tables import KoopmanTables
from ssmr_torch.models.neural_tables import NeuralTables
from ssmr_torch.models.polynomial_tables import PolynomialTables
from ssmr_torch.models.tables import ModelTables
from ssmr_torch.models.tpwl_tables import TPWLTables

KINDS: dict[str, type[ModelTables]] = {"polynomial": PolynomialTables, "control-augmented": ControlAugmentedTables,
                                     "koopman": KoopmanTables, "neural ODE": NeuralTables, "TPWL": TPWLTables}
FORMAT = "ssmr_torch artifact 2"
REPLAY_TOLERANCE = 1e-9
DEPLOYED = "deployed"
_HASHED = ("tables.safetensors", "reference.safetensors")


@dataclass(frozen=True)
class Artifact:
    """A loaded model and its card."""

    model: ModelTables
    card: dict


def save(directory: str | Path, model: ModelTables, *, output_names, input_names, rest, input_range,
         input_unit: str = "N", name: str = "SSMR", provenance: dict | None = None,
         scores: dict | None = None, cost: dict | None = None,
         complete: Callable[[Path], object] | None = None) -> Path:
    """Write the artifact aside and move it into place; an artifact already there is replaced whole.

    output_names (p,), input_names (m,), rest (p,) m, input_range (2, m): what the model was trained on.
    scores, cost: plain numbers; one that is not finite, of rollouts that diverge, is stored as null.
    complete: called with the directory while it is still aside, to add to it; what it raises leaves all as it was.
    Raises ValueError when these disagree with the model, a table is not finite, or the directory holds other files.
    """
    directory = Path(directory)
    rest, bounds = np.asarray(rest, dtype=np.float64), np.asarray(input_range, dtype=np.float64)
    _validate(model, output_names, input_names, rest, bounds)
    _refuse_foreign(directory)
    card = {"format": FORMAT, "kind": _kind_of(model), "name": name,
            "model": {scalar: getattr(model, scalar) for scalar in model.scalar_names()}
            | {"state_dim": model.state_dim},
            "geometry": model.geometry, "units": {"length": "m", "time": "s", "input": input_unit},
            "output_names": list(output_names), "input_names": list(input_names), "rest": rest.tolist(),
            "input_range": bounds.tolist(), "provenance": provenance or {},
            "scores": {key: value if np.isfinite(value) else None for key, value in (scores or {}).items()},
            "cost": cost or {}}
    aside = directory.with_name(directory.name + ".part")
    shutil.rmtree(aside, ignore_errors=True)
    aside.mkdir(parents=True)
    save_file({table: np.ascontiguousarray(getattr(model, table)) for table in model.array_names()},
              aside / "tables.safetensors")
    reference = _reference_inputs(model, bounds)
    save_file(reference | _predict(model, reference), aside / "reference.safetensors")
    card["sha256"] = {name: hashlib.sha256((aside / name).read_bytes()).hexdigest() for name in _HASHED}
    (aside / "card.json").write_text(json.dumps(card, indent=2, allow_nan=False) + "\n")
    if complete is not None:
        complete(aside)
    _replace(aside, directory)
    return directory


def load(directory: str | Path) -> Artifact:
    """Load an artifact and replay its reference prediction.

    Raises FileNotFoundError when it is not there, ValueError when it is damaged, of another format, or no longer
    predicts what it did when it was written (the message says by how much).
    """
    directory = Path(directory)
    if not (directory / "card.json").is_file():
        raise FileNotFoundError(f"no artifact at {directory} (no card.json); make one with ssmr export")
    try:
        card = json.loads((directory / "card.json").read_text())
    except json.JSONDecodeError as error:
        raise ValueError(f"{directory / 'card.json'} is not valid JSON ({error}); export the model again") from error
    if not isinstance(card, dict) or not {"format", "kind", "model", "sha256"} <= card.keys():
        raise ValueError(f"{directory / 'card.json'} is not the card of an artifact; export the model again")
    if card["format"] != FORMAT or card["kind"] not in KINDS:
        raise ValueError(f"{directory} has format {card['format']!r} and kind {card['kind']!r}; "
                         f"this version reads {FORMAT!r} of the kinds {sorted(KINDS)}")
    for path in (directory / name for name in _HASHED):
        if not path.is_file() or hashlib.sha256(path.read_bytes()).hexdigest() != card["sha256"].get(path.name):
            raise ValueError(f"{path} is missing or differs from what the card records; export the model again")
    kind = KINDS[card["kind"]]
    # a setting that is newer than the artifact has a default: what it was then
    model = kind(**load_file(directory / "tables.safetensors"),
                 **{scalar: card["model"][scalar] for scalar in kind.scalar_names() if scalar in card["model"]})
    _replay(directory, model)
    return Artifact(model, card)


def reference(directory: str | Path) -> dict[str, np.ndarray]:
    """The reference batch of an artifact: state (16, n), input (16, m), window (16, n_d + 1, p), window_input
    (16, n_d, m), and what the model made of them when it was written.
    """
    return load_file(Path(directory) / "reference.safetensors")


def by_name(artifacts: list[Artifact]) -> dict[str, ModelTables]:
    """Models by the name on their card; a repeated name is numbered."""
    models: dict[str, ModelTables] = {}
    for loaded in artifacts:
        name, number = loaded.card["name"], 2
        while name in models:
            name, number = f"{loaded.card['name']} {number}", number + 1
        models[name] = loaded.model
    return models


def common_outputs(artifacts: list[Artifact]) -> list[str]:
    """The outputs that all of them observe. Raises ValueError when they differ: their errors would not compare."""
    names = [loaded.card["output_names"] for loaded in artifacts]
    if any(others != names[0] for others in names):
        raise ValueError(f"the artifacts observe different outputs {names}; compare models of the same ones")
    return names[0]


def check_source(loaded: Artifact, source) -> None:
    """Raises ValueError when a plant's or dataset's outputs, inputs or input unit are not those of the training."""
    card = loaded.card
    for what, trained, found in (("outputs", card["output_names"], list(source.output_names)),
                                 ("inputs", card["input_names"], list(source.input_names)),
                                 ("input unit", card["units"]["input"], source.input_unit)):
        if trained != found:
            raise ValueError(f"the model was trained with {what} {trained}, here they are {found}; "
                             "use the plant or data that it was trained on, or train again")


def _validate(model: ModelTables, output_names, input_names, rest: np.ndarray, bounds: np.ndarray) -> None:
    p, m = model.output_dim, model.input_dim
    if len(output_names) != p or rest.shape != (p,):
        raise ValueError(f"{len(output_names)} output names and a rest of shape {rest.shape} for a model of "
                         f"{p} outputs")
    if len(input_names) != m or bounds.shape != (2, m) or (bounds[0] >= bounds[1]).any():
        raise ValueError(f"{len(input_names)} input names and bounds of shape {bounds.shape} for a model of "
                         f"{m} inputs; expected (2, m) with the lower below the upper")
    for table in model.array_names():
        if not np.isfinite(getattr(model, table)).all():
            raise ValueError(f"the table {table} is not finite; fit the model before saving it")


def _refuse_foreign(directory: Path) -> None:
    if not directory.exists():
        return
    known = (*_HASHED, "card.json") + ((DEPLOYED,) if (directory / "card.json").is_file() else ())
    foreign = [directory.name] if directory.is_file() else sorted(
        path.name for path in directory.iterdir() if path.name not in known)
    if foreign:
        raise ValueError(f"{directory} exists and holds {foreign[:3]}, which are no part of an artifact; "
                         "choose another directory")


def _kind_of(model: ModelTables) -> str:
    return next(kind for kind, tables in KINDS.items() if type(model) is tables)


def _reference_inputs(model: ModelTables, bounds: np.ndarray) -> dict[str, np.ndarray]:
    """Seeded states, inputs, and windows that hold outputs of such states."""
    rng = np.random.default_rng(0)
    states = 0.5 * model.state_scale * rng.uniform(-1, 1, (16, model.state_dim))
    inputs = bounds[0] + (bounds[1] - bounds[0]) * rng.uniform(0, 1, (model.delays + 1, 16, model.input_dim))
    windows = model.decode(0.5 * model.state_scale * rng.uniform(-1, 1, (16, model.delays + 1, model.state_dim)))
    return {"state": states, "input": inputs[0], "window": windows,
            "window_input": np.ascontiguousarray(inputs[1:].swapaxes(0, 1))}


def _predict(model: ModelTables, reference: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    z, u, window = reference["state"], reference["input"], reference["window"]
    A, B, c = model.linearize(z, u)
    C, d = model.linearize_output(z)
    found = {"encoded": model.encode(window, reference["window_input"]), "decoded": model.decode(z),
             "following": model.step(z, u), "A": A, "B": B, "c": c, "C": C, "d": d}
    # a broadcast view would be stored as what lies behind it
    return {name: np.ascontiguousarray(array) for name, array in found.items()}


def _replay(directory: Path, model: ModelTables) -> None:
    recorded = reference(directory)
    for name, values in _predict(model, recorded).items():
        # c and d are what remains of a state or an output, and mere rounding of it where the model is linear
        size = np.abs(recorded[{"c": "following", "d": "decoded"}.get(name, name)]).max()
        error = np.abs(values - recorded[name]).max() / max(size, 1e-300)
        if not error <= REPLAY_TOLERANCE:
            raise ValueError(f"{directory} no longer reproduces its reference: {name} differs by {error:.3g} relative, "
                             f"more than {REPLAY_TOLERANCE:g}; export the model again with this version")


def _replace(aside: Path, directory: Path) -> None:
    old = directory.with_name(directory.name + ".old")
    shutil.rmtree(old, ignore_errors=True)
    if directory.exists():
        os.replace(directory, old)
    os.replace(aside, directory)
    shutil.rmtree(old, ignore_errors=True)
