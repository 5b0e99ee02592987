"""An artifact: a directory with a model's tables, its model card, and a stored prediction that is checked on loading.

    tables.safetensors     the arrays, float64, and the structure in its metadata
    reference.safetensors  the reference batch: seeded windows, states and inputs, and what the model predicted for them
    card.json              model card: kind, shapes, units, timestep, provenance, scores, hashes of the other files, and
                           a checksum of the card itself
    controller.json        only with a designed controller: settings, task, bounds, facts; see `control.designed`
    deployed/              only on request: the model in C, as Torch programs, as ONNX graphs; see docs/deployment.md

Loading needs only NumPy and safetensors, and never unpickles anything. A model family of another package is found by
its class; that package must be installed where the artifact is loaded.
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ssmr_torch import checksum
from ssmr_torch.deployment.card_checks import refuse_card, refuse_designed
from ssmr_torch.deployment.tables import class_of, load_tables, needed, save_arrays, save_tables, stored_arrays
from ssmr_torch.deployment.whole_directory import whole_directory
from ssmr_torch.lazy import found
from ssmr_torch.models.base import Model
from ssmr_torch.result_files import save_text

FORMAT = "ssmr_torch artifact 4"
WITHOUT_CHECKSUM = "ssmr_torch artifact 3"  # of versions 0.8 to 0.11
# Kinds of models in the format of versions up to 0.7, with the functions that read their tables.
BEFORE = "ssmr_torch artifact 2"
KINDS_BEFORE = {"polynomial": "ssmr_torch.models.named_structures:spectral_submanifold",
                "control-augmented": "ssmr_torch.models.named_structures:control_augmented",
                "koopman": "ssmr_torch.models.named_structures:koopman",
                "neural ODE": "ssmr_torch.models.neural:NeuralModel",
                "TPWL": "ssmr_torch.models.piecewise_linear:PiecewiseLinearModel"}
REPLAY_TOLERANCE = 1e-9
DEPLOYED = "deployed"
CONTROLLER = "controller.json"
CARD = "card.json"
MOST_ROWS = 1000  # of a reference batch
_HASHED = ("tables.safetensors", "reference.safetensors")


@dataclass(frozen=True)
class Artifact:
    """A loaded model and its card. designed: the controller designed for it, as JSON; None where there is none."""

    model: Model
    card: dict
    designed: dict | None = None

    @property
    def reduced(self) -> Model:
        """The model, under the name that controllers use for it."""
        return self.model


def save(directory: str | Path, model: Model, *, output_names, input_names, rest, input_range,
         input_unit: str = "N", name: str = "SSMR", provenance: dict | None = None,
         scores: dict | None = None, cost: dict | None = None, sampling_time: float | None = None,
         output_range=None, designed: dict | None = None,
         complete: Callable[[Path], object] | None = None) -> Path:
    """Write the artifact aside and move it into place. An artifact that is already there is replaced as a whole.

    model: of NumPy arrays.   output_names (p,), input_names (m,), rest (p,) m, input_range (2, m): of the training.
    sampling_time: s, of the recordings; default: the window_timestep.   output_range: (2, p) m, of the training.
    scores, cost: plain numbers; one that is not finite (a rollout diverged) is stored as null.
    designed: a controller as `control.designed.carried` returns it; None: the artifact has no controller.
    complete: called with the directory while it is still aside, to add files. If it raises, nothing is changed.
    Raises ValueError when these do not fit the model, a table is not finite, or the directory holds other files.
    """
    directory = Path(directory)
    rest, bounds = np.asarray(rest, dtype=np.float64), np.asarray(input_range, dtype=np.float64)
    _validate(model, output_names, input_names, rest, bounds)
    _refuse_foreign(directory)
    plain = {key: value for key, value in model.plain().items() if key != "structure"}  # too long for the card
    card = {"format": FORMAT, "kind": model.kind, "class": class_of(model), "name": name,
            "model": plain | {"state_dim": model.state_dim},
            "geometry": model.geometry, "units": {"length": "m", "time": "s", "input": input_unit},
            "sampling_time": model.window_timestep if sampling_time is None else float(sampling_time),
            "output_names": list(output_names), "input_names": list(input_names), "rest": rest.tolist(),
            "input_range": bounds.tolist(), "output_range": output_range, "provenance": provenance or {},
            "scores": {key: value if np.isfinite(value) else None for key, value in (scores or {}).items()},
            "cost": cost or {}}
    with whole_directory(directory, _refuse_foreign) as aside:
        save_tables(aside / "tables.safetensors", model)
        reference = _reference_inputs(model, bounds)
        save_arrays(aside / "reference.safetensors", reference | _predict(model, reference))
        if designed is not None:
            save_text(aside / CONTROLLER, json.dumps(designed, indent=1, allow_nan=False) + "\n")
        _write_card(aside, card)
        if complete is not None:
            complete(aside)
            _write_card(aside, card)
    return directory


def add_files(directory: str | Path, write: Callable[[Path], object]) -> None:
    """Add files to an artifact: `write` is called with a copy of it, which then replaces it as a whole.

    Raises ValueError as `load` does; if write raises, nothing is changed.
    """
    directory = Path(directory)
    with whole_directory(directory) as aside:
        shutil.copytree(directory, aside, symlinks=True, dirs_exist_ok=True)
        write(aside)
        _write_card(aside, _card(aside / CARD))


def _write_card(directory: Path, card: dict) -> None:
    """Write the card with the hashes of all other files of the artifact, and its own checksum."""
    paths = [directory / name for name in (*_HASHED, CONTROLLER)]
    paths += sorted(path for path in (directory / DEPLOYED).rglob("*") if path.is_file())
    hashes = {path.relative_to(directory).as_posix(): _sha256(path) for path in paths if path.is_file()}
    save_text(directory / CARD, checksum.sealed_json(card | {"sha256": hashes}))


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def load(directory: str | Path) -> Artifact:
    """Load an artifact and repeat its reference prediction. Artifacts of versions up to 0.7 can be loaded, too.

    Raises FileNotFoundError when there is none, and ValueError when it is damaged, has another format, or no longer
    gives the stored prediction (the message gives the difference).
    """
    directory = Path(directory)
    if not (directory / CARD).is_file():
        raise FileNotFoundError(f"no artifact at {directory} (no card.json); make one with ssmr export")
    card = _card(directory / CARD)
    carries = CONTROLLER in card["sha256"] or (directory / CONTROLLER).exists()
    _refuse_changed(directory, card["sha256"], (*_HASHED, *([CONTROLLER] if carries else [])))
    path = directory / "tables.safetensors"
    if card["format"] == BEFORE:
        # A setting that is newer than the artifact takes its default: the behaviour when the artifact was written.
        settings = {name: value for name, value in card["model"].items() if name != "state_dim"}
        arrays, _ = stored_arrays(path)
        with needed(path, f"a model of the kind {card['kind']}"):
            model = found(KINDS_BEFORE[card["kind"]])(**arrays, **settings)
    else:
        model = load_tables(path)[0]
    refuse_card(directory / CARD, card, model)
    _replay(directory, model)
    return Artifact(model, card, refuse_designed(directory / CONTROLLER, model) if carries else None)


def _card(path: Path) -> dict:
    """The card, whose format and checksum were checked. Raises ValueError for any other file."""
    card = checksum.parsed(path)
    refuse_card(path, card)
    if card["format"] not in (FORMAT, WITHOUT_CHECKSUM, BEFORE) or (
            card["format"] == BEFORE and card["kind"] not in KINDS_BEFORE):
        raise ValueError(f"{path.parent} has format {card['format']!r} and kind {card['kind']!r}; this version reads "
                         f"{FORMAT!r}, {WITHOUT_CHECKSUM!r}, and {BEFORE!r} of the kinds {sorted(KINDS_BEFORE)}")
    checksum.refuse_unsealed(path, checksum.KEY in card, card["format"], WITHOUT_CHECKSUM, BEFORE)
    return card


def _refuse_changed(directory: Path, hashes: dict, names: tuple[str, ...]) -> None:
    """Raises ValueError for a missing or changed file, and for a changed program in the folder `deployed`."""
    for path in (directory / name for name in names):
        if not path.is_file() or _sha256(path) != hashes.get(path.name):
            raise ValueError(f"{path} is missing or differs from the hash in the card; export the model again")
    folder = directory / DEPLOYED
    for path in sorted(folder.rglob("*")) if folder.is_dir() and not folder.is_symlink() else ():
        given = hashes.get(path.relative_to(directory).as_posix())  # others may lie there, such as what was compiled
        if given is not None and path.is_file() and _sha256(path) != given:
            raise ValueError(f"{path} differs from the hash in the card; export the model again, or remove the folder "
                             f"{folder}")


def reference(directory: str | Path) -> dict[str, np.ndarray]:
    """The reference batch of an artifact: state (16, n), input (16, m), window (16, n_d + 1, p), window_input
    (16, n_d, m), and what the model predicted for them when it was written. Raises ValueError for a damaged file.
    """
    return stored_arrays(Path(directory) / "reference.safetensors")[0]


def by_name(artifacts: list[Artifact]) -> dict[str, Model]:
    """Models by the name on their card. Equal names get a number."""
    models: dict[str, Model] = {}
    for loaded in artifacts:
        name, number = loaded.card["name"], 2
        while name in models:
            name, number = f"{loaded.card['name']} {number}", number + 1
        models[name] = loaded.model
    return models


def common_outputs(artifacts: list[Artifact]) -> list[str]:
    """The outputs that all artifacts observe. Raises ValueError when they differ, since errors could not be compared.
    """
    names = [loaded.card["output_names"] for loaded in artifacts]
    if any(others != names[0] for others in names):
        raise ValueError(f"the artifacts observe different outputs {names}; compare models with the same outputs")
    return names[0]


def check_source(loaded: Artifact, source) -> None:
    """Raise ValueError when outputs, inputs or input unit of a plant or dataset differ from those of the training."""
    card = loaded.card
    for what, trained, given in (("outputs", card["output_names"], list(source.output_names)),
                                 ("inputs", card["input_names"], list(source.input_names)),
                                 ("input unit", card["units"]["input"], source.input_unit)):
        if trained != given:
            raise ValueError(f"the model was trained with {what} {trained}, but this robot or data has {given}; "
                             "use the robot or data of the training, or train again")


def _validate(model: Model, output_names, input_names, rest: np.ndarray, bounds: np.ndarray) -> None:
    p, m = model.output_dim, model.input_dim
    if len(output_names) != p or rest.shape != (p,):
        raise ValueError(f"{len(output_names)} output names and a rest of shape {rest.shape} were given; "
                         f"the model has {p} outputs, so expected {p} names and ({p},)")
    if len(input_names) != m or bounds.shape != (2, m) or (bounds[0] >= bounds[1]).any():
        raise ValueError(f"{len(input_names)} input names and bounds of shape {bounds.shape} were given; the model has "
                         f"{m} inputs, so expected {m} names and (2, {m}), lowest below highest")
    for table, array in model.arrays.items():
        if not np.isfinite(array).all():
            raise ValueError(f"the table {table} is not finite; fit the model before saving it")


def _refuse_foreign(directory: Path) -> None:
    if not directory.exists():
        return
    known = (*_HASHED, CONTROLLER, CARD) + ((DEPLOYED,) if (directory / CARD).is_file() else ())
    foreign = [directory.name] if directory.is_file() else sorted(
        path.name for path in directory.iterdir() if path.name not in known)
    if foreign:
        raise ValueError(f"{directory} exists and holds {foreign[:3]}, which do not belong to an artifact; "
                         "choose another directory")


def _reference_inputs(model: Model, bounds: np.ndarray) -> dict[str, np.ndarray]:
    """Seeded states and inputs, and windows whose outputs belong to such states."""
    rng = np.random.default_rng(0)
    states = 0.5 * model.state_scale * rng.uniform(-1, 1, (16, model.state_dim))
    inputs = bounds[0] + (bounds[1] - bounds[0]) * rng.uniform(0, 1, (model.delays + 1, 16, model.input_dim))
    windows = model.decode(0.5 * model.state_scale * rng.uniform(-1, 1, (16, model.delays + 1, model.state_dim)))
    return {"state": states, "input": inputs[0], "window": windows,
            "window_input": np.ascontiguousarray(inputs[1:].swapaxes(0, 1))}


def _predict(model: Model, reference: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    z, u, window = reference["state"], reference["input"], reference["window"]
    A, B, c = model.linearize(z, u)
    C, d = model.linearize_output(z)
    predicted = {"encoded": model.encode(window, reference["window_input"]), "decoded": model.decode(z),
                 "following": model.step(z, u), "A": A, "B": B, "c": c, "C": C, "d": d}
    return predicted


def _replay(directory: Path, model: Model) -> None:
    recorded = reference(directory)
    if max((len(array) for array in recorded.values() if array.ndim), default=0) > MOST_ROWS:
        raise ValueError(f"{directory / 'reference.safetensors'} holds more than {MOST_ROWS} rows; export the model "
                         "again")
    with needed(directory / "reference.safetensors", "the replay of this model"), np.errstate(all="ignore"):
        predicted = _predict(model, recorded)
        # c and d are differences of states or outputs. For a linear model they are only rounding, so they are compared
        # with the size of the state or output itself.
        sizes = {name: np.abs(recorded[{"c": "following", "d": "decoded"}.get(name, name)]).max() for name in predicted}
        errors = {name: np.abs(values - recorded[name]).max() / max(sizes[name], 1e-300)
                  for name, values in predicted.items()}
    for name, error in errors.items():
        if not error <= REPLAY_TOLERANCE:
            raise ValueError(f"{directory} no longer gives its stored reference prediction: {name} differs by "
                             f"{error:.3g} relative; at most {REPLAY_TOLERANCE:g} is allowed. Export the model again "
                             "with this version")
