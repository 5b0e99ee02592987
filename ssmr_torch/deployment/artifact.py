"""A deployable model: a directory with tables, a card, and a reference prediction that loading replays.

    tables.safetensors     the arrays, float64, and the structure in its metadata
    reference.safetensors  seeded windows, states and inputs, and what the model made of them
    card.json              kind, shapes, units, sampling time, provenance, scores, hashes of the other files
    controller.json        where one was designed: its settings, task, bounds and what tuned it, see `control.designed`
    deployed/              where asked for: the model in C, as Torch programs, as ONNX graphs; see docs/deployment.md

Loading needs NumPy and safetensors only, and never unpickles anything. A family of models from outside is found by its
class, which must be installed where the artifact is loaded.
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
# Kinds of the format before, of versions up to 0.7: what takes their tables.
BEFORE = "ssmr_torch artifact 2"
KINDS_BEFORE = {"polynomial": "ssmr_torch.models.named_structures:spectral_submanifold",
                "control-augmented": "ssmr_torch.models.named_structures:control_augmented",
                "koopman": "ssmr_torch.models.named_structures:koopman",
                "neural ODE": "ssmr_torch.models.neural:NeuralModel",
                "TPWL": "ssmr_torch.models.piecewise_linear:PiecewiseLinearModel"}
# What every card says, and of which type.
CARD = {"format": str, "kind": str, "model": dict, "sha256": dict, "name": str, "units": dict, "output_names": list,
        "input_names": list, "rest": list, "input_range": list}
# What controller.json says, and of which type.
DESIGNED = {"controller": dict, "tracked": list, "input_bounds": list, "timestep": float, "facts": dict}
REPLAY_TOLERANCE = 1e-9
DEPLOYED = "deployed"
CONTROLLER = "controller.json"
_HASHED = ("tables.safetensors", "reference.safetensors")


@dataclass(frozen=True)
class Artifact:
    """A loaded model and its card. designed: the controller that was designed for it, as JSON; None without one."""

    model: Model
    card: dict
    designed: dict | None = None

    @property
    def reduced(self) -> Model:
        """The model, under the name by which controllers ask for it."""
        return self.model


def save(directory: str | Path, model: Model, *, output_names, input_names, rest, input_range,
         input_unit: str = "N", name: str = "SSMR", provenance: dict | None = None,
         scores: dict | None = None, cost: dict | None = None, sampling_time: float | None = None,
         output_range=None, designed: dict | None = None,
         complete: Callable[[Path], object] | None = None) -> Path:
    """Write the artifact aside and move it into place; an artifact already there is replaced whole.

    model: NumPy arrays. output_names (p,), input_names (m,), rest (p,) m, input_range (2, m): what it was trained on;
    sampling_time: s, of the recordings, default the window_timestep. output_range: (2, p) m, of the training.
    scores, cost: plain numbers; one that is not finite, of rollouts that diverge, is stored as null.
    designed: a controller as `control.designed.carried` gives it; None: the artifact carries none.
    complete: called with the directory while it is still aside, to add to it; what it raises leaves all as it was.
    Raises ValueError when these disagree with the model, a table is not finite, or the directory holds other files.
    """
    directory = Path(directory)
    rest, bounds = np.asarray(rest, dtype=np.float64), np.asarray(input_range, dtype=np.float64)
    _validate(model, output_names, input_names, rest, bounds)
    _refuse_foreign(directory)
    plain = {key: value for key, value in model.plain().items() if key != "structure"}  # which is long
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
    """Load an artifact and replay its reference prediction; those of versions up to 0.7 as well.

    Raises FileNotFoundError when it is not there, ValueError when it is damaged, of another format, or no longer
    predicts what it did when it was written (the message says by how much).
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
            raise ValueError(f"{path} is missing or differs from what the card records; export the model again")
    if card["format"] == BEFORE:
        # a setting that is newer than the artifact has a default: what it was then
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
        raise ValueError(f"{path} is no designed controller, it has no {', '.join(missing)}; design it again")
    return designed


def _class_of(model: Model) -> str:
    return f"{type(model).__module__}:{type(model).__qualname__}"


def save_tables(path: Path, model: Model, **noted) -> None:
    """The arrays in one file, whose metadata hold class and plain values of the model, and what else is noted."""
    # one key: safetensors writes several in any order, and the same model would have another hash each time
    noted = {"class": _class_of(model), "plain": model.plain(), **noted}
    save_file({name: np.ascontiguousarray(array) for name, array in model.arrays.items()}, path,
              {"model": json.dumps(noted)})


def _card(path: Path) -> dict:
    try:
        card = json.loads(path.read_text())
    except ValueError as error:  # no JSON, or no text
        raise ValueError(f"{path} is not valid JSON ({error}); export the model again") from error
    missing = [name for name in CARD if not isinstance(card, dict) or not isinstance(card.get(name), CARD[name])]
    if missing:
        raise ValueError(f"{path} is not the card of an artifact, it has no {', '.join(missing)}; export the model "
                         "again")
    return card


def _stored(path: Path) -> tuple[dict[str, np.ndarray], dict]:
    """The arrays of a file, and what is noted beside them. Raises ValueError where it is damaged."""
    try:
        with safe_open(path, "np") as file:
            noted = json.loads((file.metadata() or {}).get("model", "{}"))
            return {name: file.get_tensor(name) for name in file.keys()}, noted  # noqa: SIM118
    except (SafetensorError, ValueError) as error:
        raise ValueError(f"{path} is damaged ({error}); export the model again") from error


@contextmanager
def _needed(path: Path, what: str):
    """Whatever a model makes of arrays and settings that are not its own, said of the file that they come from."""
    try:
        yield
    except (TypeError, LookupError, ValueError, AttributeError, OverflowError, MemoryError) as error:
        raise ValueError(f"{path} does not hold what {what} needs ({error}); export the model again") from error


def load_tables(path: Path) -> tuple[Model, dict]:
    """The model of a file of `save_tables`, and all that is noted in it. Raises ValueError for another or damaged file.
    """
    arrays, noted = _stored(path)
    if not isinstance(noted, dict) or not {"class", "plain"} <= noted.keys():
        raise ValueError(f"{path} does not say which model its tables belong to; export the model again")
    try:
        family = found(noted["class"])
    except (ImportError, AttributeError, ValueError) as error:
        raise ValueError(f"{path} holds a model of {noted['class']}, which is not installed here ({error}); install "
                         "its package") from error
    if not (isinstance(family, type) and issubclass(family, Model)):
        raise ValueError(f"{path} names {noted['class']}, which is no model; export the model again")
    with _needed(path, f"a {family.__name__}"):
        return family.from_plain(arrays, noted["plain"]), noted


def reference(directory: str | Path) -> dict[str, np.ndarray]:
    """The reference batch of an artifact: state (16, n), input (16, m), window (16, n_d + 1, p), window_input
    (16, n_d, m), and what the model made of them when it was written. Raises ValueError where the file is damaged.
    """
    return _stored(Path(directory) / "reference.safetensors")[0]


def by_name(artifacts: list[Artifact]) -> dict[str, Model]:
    """Models by the name on their card; a repeated name is numbered."""
    models: dict[str, Model] = {}
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
    for what, trained, given in (("outputs", card["output_names"], list(source.output_names)),
                                 ("inputs", card["input_names"], list(source.input_names)),
                                 ("input unit", card["units"]["input"], source.input_unit)):
        if trained != given:
            raise ValueError(f"the model was trained with {what} {trained}, here they are {given}; "
                             "use the plant or data that it was trained on, or train again")


def _validate(model: Model, output_names, input_names, rest: np.ndarray, bounds: np.ndarray) -> None:
    p, m = model.output_dim, model.input_dim
    if len(output_names) != p or rest.shape != (p,):
        raise ValueError(f"{len(output_names)} output names and a rest of shape {rest.shape} for a model of "
                         f"{p} outputs")
    if len(input_names) != m or bounds.shape != (2, m) or (bounds[0] >= bounds[1]).any():
        raise ValueError(f"{len(input_names)} input names and bounds of shape {bounds.shape} for a model of "
                         f"{m} inputs; expected (2, m) with the lower below the upper")
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
        raise ValueError(f"{directory} exists and holds {foreign[:3]}, which are no part of an artifact; "
                         "choose another directory")


def _reference_inputs(model: Model, bounds: np.ndarray) -> dict[str, np.ndarray]:
    """Seeded states, inputs, and windows that hold outputs of such states."""
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
    # a broadcast view would be stored as what lies behind it
    return {name: np.ascontiguousarray(array) for name, array in predicted.items()}


def _replay(directory: Path, model: Model) -> None:
    recorded = reference(directory)
    with _needed(directory / "reference.safetensors", "the replay of this model"), np.errstate(all="ignore"):
        predicted = _predict(model, recorded)
        # c and d are what remains of a state or an output, and mere rounding of it where the model is linear
        sizes = {name: np.abs(recorded[{"c": "following", "d": "decoded"}.get(name, name)]).max() for name in predicted}
        errors = {name: np.abs(values - recorded[name]).max() / max(sizes[name], 1e-300)
                  for name, values in predicted.items()}
    for name, error in errors.items():
        if not error <= REPLAY_TOLERANCE:
            raise ValueError(f"{directory} no longer reproduces its reference: {name} differs by {error:.3g} relative, "
                             f"more than {REPLAY_TOLERANCE:g}; export the model again with this version")


@contextmanager
def _replacing(directory: Path):
    """A folder aside that takes the directory's place when all has been written, and leaves no trace otherwise."""
    directory.parent.mkdir(parents=True, exist_ok=True)
    within = Path(tempfile.mkdtemp(prefix=f".{directory.name}.", dir=directory.parent))
    try:
        aside = within / "new"
        aside.mkdir()
        yield aside
        for path in aside.rglob("*"):
            if path.is_file():  # a file of a temporary kind is readable by its owner alone
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
