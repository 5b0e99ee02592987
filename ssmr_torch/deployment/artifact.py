"""An artifact: a directory with a model's tables, its model card, and a stored prediction that is checked on loading.

    tables.safetensors     the arrays, float64, and the structure in its metadata
    reference.safetensors  the reference batch: seeded windows, states and inputs, and what the model predicted for them
    card.json              model card: kind, shapes, units, timestep, provenance, scores, hashes of the other files
    controller.json        only with a designed controller: settings, task, bounds, facts; see `control.designed`
    deployed/              only on request: the model in C, as Torch programs, as ONNX graphs; see docs/deployment.md

Loading needs only NumPy and safetensors, and never unpickles anything. A model family of another package is found by
its class; that package must be installed where the artifact is loaded.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import tempfile
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save_file

from ssmr_torch.lazy import found
from ssmr_torch.models.base import Model

FORMAT = "ssmr_torch artifact 3"
# Kinds of models in the format of versions up to 0.7, with the functions that read their tables.
BEFORE = "ssmr_torch artifact 2"
KINDS_BEFORE = {"polynomial": "ssmr_torch.models.named_structures:spectral_submanifold",
                "control-augmented": "ssmr_torch.models.named_structures:control_augmented",
                "koopman": "ssmr_torch.models.named_structures:koopman",
                "neural ODE": "ssmr_torch.models.neural:NeuralModel",
                "TPWL": "ssmr_torch.models.piecewise_linear:PiecewiseLinearModel"}
# The entries that every card must have, with their types.
CARD = {"format": str, "kind": str, "model": dict, "sha256": dict, "name": str, "units": dict, "output_names": list,
        "input_names": list, "rest": list, "input_range": list}
# The entries that controller.json must have, with their types.
DESIGNED = {"controller": dict, "tracked": list, "input_bounds": list, "timestep": float, "facts": dict}
REPLAY_TOLERANCE = 1e-9
DEPLOYED = "deployed"
CONTROLLER = "controller.json"
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
    card = {"format": FORMAT, "kind": model.kind, "class": _class_of(model), "name": name,
            "model": plain | {"state_dim": model.state_dim},
            "geometry": model.geometry, "units": {"length": "m", "time": "s", "input": input_unit},
            "sampling_time": model.window_timestep if sampling_time is None else float(sampling_time),
            "output_names": list(output_names), "input_names": list(input_names), "rest": rest.tolist(),
            "input_range": bounds.tolist(), "output_range": output_range, "provenance": provenance or {},
            "scores": {key: value if np.isfinite(value) else None for key, value in (scores or {}).items()},
            "cost": cost or {}}
    with _replacing(directory) as aside:
        save_tables(aside / "tables.safetensors", model)
        reference = _reference_inputs(model, bounds)
        save_file(reference | _predict(model, reference), aside / "reference.safetensors")
        if designed is not None:
            (aside / CONTROLLER).write_text(json.dumps(designed, indent=1, allow_nan=False) + "\n")
        card["sha256"] = {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted(aside.iterdir())}
        (aside / "card.json").write_text(json.dumps(card, indent=2, allow_nan=False) + "\n")
        if complete is not None:
            complete(aside)
    return directory


def load(directory: str | Path) -> Artifact:
    """Load an artifact and repeat its reference prediction. Artifacts of versions up to 0.7 can be loaded, too.

    Raises FileNotFoundError when there is none, and ValueError when it is damaged, has another format, or no longer
    gives the stored prediction (the message gives the difference).
    """
    directory = Path(directory)
    if not (directory / "card.json").is_file():
        raise FileNotFoundError(f"no artifact at {directory} (no card.json); make one with ssmr export")
    card = _card(directory / "card.json")
    if card["format"] not in (FORMAT, BEFORE) or (card["format"] == BEFORE and card["kind"] not in KINDS_BEFORE):
        raise ValueError(f"{directory} has format {card['format']!r} and kind {card['kind']!r}; this version reads "
                         f"{FORMAT!r}, and {BEFORE!r} of the kinds {sorted(KINDS_BEFORE)}")
    carries = CONTROLLER in card["sha256"] or (directory / CONTROLLER).exists()
    for path in (directory / name for name in (*_HASHED, *([CONTROLLER] if carries else []))):
        if not path.is_file() or hashlib.sha256(path.read_bytes()).hexdigest() != card["sha256"].get(path.name):
            raise ValueError(f"{path} is missing or differs from the hash in the card; export the model again")
    if card["format"] == BEFORE:
        # A setting that is newer than the artifact takes its default: the behaviour when the artifact was written.
        settings = {name: value for name, value in card["model"].items() if name != "state_dim"}
        arrays, _ = _stored(directory / "tables.safetensors")
        with _needed(directory / "tables.safetensors", f"a model of the kind {card['kind']}"):
            model = found(KINDS_BEFORE[card["kind"]])(**arrays, **settings)
    else:
        model = load_tables(directory / "tables.safetensors")[0]
    _replay(directory, model)
    return Artifact(model, card, _designed(directory / CONTROLLER) if carries else None)


def _designed(path: Path) -> dict:
    try:
        designed = json.loads(path.read_text())
    except ValueError as error:
        raise ValueError(f"{path} is not valid JSON ({error}); design the controller again") from error
    missing = [name for name, kind in DESIGNED.items() if not isinstance(designed, dict)
               or not isinstance(designed.get(name), kind)]
    if missing:
        raise ValueError(f"{path} is not a designed controller: it has no {', '.join(missing)}; design it again")
    return designed


def _class_of(model: Model) -> str:
    return f"{type(model).__module__}:{type(model).__qualname__}"


def save_tables(path: Path, model: Model, **noted) -> None:
    """Write the arrays to one file. Its metadata hold class and plain values of the model, and the entries `noted`."""
    # One key only: safetensors writes several keys in any order, and the file's hash would change.
    noted = {"class": _class_of(model), "plain": model.plain(), **noted}
    save_file({name: np.ascontiguousarray(array) for name, array in model.arrays.items()}, path,
              {"model": json.dumps(noted)})


def _card(path: Path) -> dict:
    try:
        card = json.loads(path.read_text())
    except ValueError as error:  # not JSON, or not text
        raise ValueError(f"{path} is not valid JSON ({error}); export the model again") from error
    missing = [name for name in CARD if not isinstance(card, dict) or not isinstance(card.get(name), CARD[name])]
    if missing:
        raise ValueError(f"{path} is not the card of an artifact: it has no {', '.join(missing)}; export the model "
                         "again")
    return card


def _stored(path: Path) -> tuple[dict[str, np.ndarray], dict]:
    """The arrays of a file, and the entries in its metadata. Raises ValueError where the file is damaged."""
    try:
        with safe_open(path, "np") as file:
            noted = json.loads((file.metadata() or {}).get("model", "{}"))
            return {name: file.get_tensor(name) for name in file.keys()}, noted  # noqa: SIM118
    except (SafetensorError, ValueError) as error:
        raise ValueError(f"{path} is damaged ({error}); export the model again") from error


@contextmanager
def _needed(path: Path, what: str):
    """Turn any error that a model raises for missing or wrong arrays into a ValueError that names the file."""
    try:
        yield
    except (TypeError, LookupError, ValueError, AttributeError, OverflowError, MemoryError) as error:
        raise ValueError(f"{path} does not hold what {what} needs ({error}); export the model again") from error


def load_tables(path: Path) -> tuple[Model, dict]:
    """The model in a file of `save_tables`, and the entries in its metadata. Raises ValueError for any other file.
    """
    arrays, noted = _stored(path)
    if not isinstance(noted, dict) or not {"class", "plain"} <= noted.keys():
        raise ValueError(f"{path} does not say which model its tables belong to; export the model again")
    try:
        family = found(noted["class"])
    except (ImportError, AttributeError, ValueError) as error:
        raise ValueError(f"{path} holds a model of the class {noted['class']}, which is not installed here ({error}); "
                         "install its package") from error
    if not (isinstance(family, type) and issubclass(family, Model)):
        raise ValueError(f"{path} names the class {noted['class']}, which is not a model; export the model again")
    with _needed(path, f"a {family.__name__}"):
        return family.from_plain(arrays, noted["plain"]), noted


def reference(directory: str | Path) -> dict[str, np.ndarray]:
    """The reference batch of an artifact: state (16, n), input (16, m), window (16, n_d + 1, p), window_input
    (16, n_d, m), and what the model predicted for them when it was written. Raises ValueError for a damaged file.
    """
    return _stored(Path(directory) / "reference.safetensors")[0]


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
    known = (*_HASHED, CONTROLLER, "card.json") + ((DEPLOYED,) if (directory / "card.json").is_file() else ())
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
    # safetensors would store the memory behind a broadcast view, so it is copied.
    return {name: np.ascontiguousarray(array) for name, array in predicted.items()}


def _replay(directory: Path, model: Model) -> None:
    recorded = reference(directory)
    with _needed(directory / "reference.safetensors", "the replay of this model"), np.errstate(all="ignore"):
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


@contextmanager
def _replacing(directory: Path):
    """A temporary folder that replaces the directory once everything is written; after an error it is removed."""
    directory.parent.mkdir(parents=True, exist_ok=True)
    within = Path(tempfile.mkdtemp(prefix=f".{directory.name}.", dir=directory.parent))
    try:
        aside = within / "new"
        aside.mkdir()
        yield aside
        for path in aside.rglob("*"):
            if path.is_file():  # temporary files are readable only by their owner
                path.chmod(path.stat().st_mode | 0o444)
        _replace(aside, directory, within / "old")
    finally:
        shutil.rmtree(within, ignore_errors=True)


def _replace(aside: Path, directory: Path, old: Path) -> None:
    if directory.exists():
        os.replace(directory, old)
    try:
        os.replace(aside, directory)
    except OSError:
        if old.exists():
            os.replace(old, directory)
        raise
