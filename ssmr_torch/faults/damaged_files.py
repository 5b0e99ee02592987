"""Damage to every file that the package writes: each one is refused when it is loaded, or loads as what it was."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from ssmr_torch.faults.made_recordings import Robot, made_recordings
from ssmr_torch.faults.outcome import REFUSALS, Found
from ssmr_torch.faults.reading import log_lines, read_and_fit
from ssmr_torch.result_files import save_bytes

ARTIFACT, CHECKPOINT, TRAJECTORIES, RECORD = "artifact", "run/model.ckpt", "trajectories.h5", "record.h5"


def flips(count: int, seed: int = 0) -> list[dict]:
    """So many damages, spread over all files; a row for each."""
    rng = np.random.default_rng(seed)
    with TemporaryDirectory() as folder:
        root = Path(folder)
        files = written_files(root)
        whole = {name: path.read_bytes() for name, path in files.items()}
        loaders = {name: _loader(root, name) for name in files}
        with log_lines():
            right = {load: load() for load in dict.fromkeys(loaders.values())}
            names = list(files)
            rows = []
            for k in range(count):
                name = names[k % len(names)]
                damage = list(DAMAGES)[int(rng.integers(len(DAMAGES)))]
                spoilt = DAMAGES[damage](bytearray(whole[name]), rng)
                save_bytes(files[name], bytes(spoilt))
                rows.append(_judged(name, damage, bytes(spoilt) == whole[name], loaders[name], right).row())
                save_bytes(files[name], whole[name])
    return rows


def written_files(root: Path) -> dict[str, Path]:
    """One of each file that is read again, by name: those of an artifact, a checkpoint, trajectories, a record."""
    from ssmr_torch.fitting.fit import fit

    made = made_recordings(Robot(), seconds=8.0)
    data = read_and_fit(made.write(root / "recordings"), None).data
    data.save(root / TRAJECTORIES)
    fit(data, "sssr", state_dim=4, progress=False, directory=root / "run").save(root / ARTIFACT)
    _record().save(root / RECORD)
    found = {f"artifact: {path.relative_to(root / ARTIFACT)}": path for path in sorted((root / ARTIFACT).rglob("*"))
             if path.is_file()}
    return found | {"trajectories": root / TRAJECTORIES, "closed-loop record": root / RECORD,
                    "checkpoint": root / CHECKPOINT}


def _record():
    from ssmr_torch.closed_loop.simulation import simulate
    from ssmr_torch.control.base import Command
    from ssmr_torch.plants.slow_manifold import SlowManifold
    from ssmr_torch.tasks.references import path

    class Pulling:
        period = 0.02

        def reset(self) -> None: ...

        def __call__(self, time, observation) -> Command:
            return Command(np.array([0.1 + 0.1 * np.sin(5 * time), 0.0, 0.0, 0.0]))

    return simulate(SlowManifold(), Pulling(), path([0.0, 0.3], [[0.0], [0.01]], outputs=["tip_x"]), noise_std=1e-5,
                    progress=False, provenance={"plant": "slow manifold"})


def _loader(root: Path, name: str) -> Callable[[], str]:
    if name.startswith("artifact"):
        return _artifact_loader(root)
    if name == "checkpoint":
        return _checkpoint_loader(root)
    path, own = (root / TRAJECTORIES, _trajectories) if name == "trajectories" else (root / RECORD, _closed_loop)
    return _of(own, path)


_LOADERS: dict[tuple, Callable[[], str]] = {}


def _of(own: Callable[[Path], object], path: Path) -> Callable[[], str]:
    return _LOADERS.setdefault((own, path), lambda: content_of(own(path)))


def _artifact_loader(root: Path) -> Callable[[], str]:
    return _of(_artifact, root / ARTIFACT)


def _checkpoint_loader(root: Path) -> Callable[[], str]:
    return _of(_checkpoint, root / CHECKPOINT)


def _trajectories(path: Path):
    from ssmr_torch.trajectory import TrajectoryDataset

    data = TrajectoryDataset.load(path)
    return [data.provenance, data.output_names, data.input_names, data.rest, [run.read() for run in data]]


def _closed_loop(path: Path):
    from ssmr_torch.closed_loop.record import ClosedLoopRecord

    return ClosedLoopRecord.load(path)


def _artifact(path: Path):
    from ssmr_torch.trained_model import TrainedModel

    model = TrainedModel.load(path)
    window = np.zeros((model.delays + 1, len(model.output_names)))
    return [model.card, model.predict(window, 0.5 * np.ones((50, len(model.input_names))))]


def _checkpoint(path: Path):
    from ssmr_torch.fitting.checkpoints import load_model

    model, card = load_model(path)
    return [card, {name: value.numpy() for name, value in model.state_dict().items()}]


def content_of(value) -> str:
    """A digest of everything in a value: arrays to the last bit, mappings, sequences, dataclasses."""
    digest = hashlib.sha256()

    def add(part) -> None:
        if isinstance(part, np.ndarray):
            digest.update(f"{part.dtype}{part.shape}".encode() + part.tobytes())
        elif isinstance(part, Mapping):
            for key in sorted(part, key=str):
                add(str(key))
                add(part[key])
        elif isinstance(part, (list, tuple)):
            digest.update(str(len(part)).encode())
            for each in part:
                add(each)
        elif is_dataclass(part):
            for field in fields(part):
                add(getattr(part, field.name))
        else:
            digest.update(repr(part).encode() + b"\0")

    add(value)
    return digest.hexdigest()


def _judged(name: str, damage: str, same: bool, load: Callable[[], str], right: dict) -> Found:
    kind = "damaged files: " + name.partition(":")[0]
    case = f"{damage} in {name.partition(': ')[2] or name}"
    if same:
        return Found(kind, case, "survived", "the damage changed nothing")
    try:
        loaded = load()
    except REFUSALS as refusal:
        return Found(kind, case, "refused", str(refusal)[:160])
    except Exception as error:  # whatever it is: that is what is looked for
        return Found(kind, case, "traceback", f"{type(error).__name__}: {error}"[:300])
    if loaded == right[load]:
        return Found(kind, case, "survived", "loaded as what it was")
    return Found(kind, case, "wrong", "loaded as something else")


def _bit(data: bytearray, rng) -> bytearray:
    data[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))
    return data


def _byte(data: bytearray, rng) -> bytearray:
    data[int(rng.integers(len(data)))] = int(rng.integers(256))
    return data


def _digit(data: bytearray, rng) -> bytearray:
    """Another digit for a digit of text; a bit where there is none."""
    digits = [place for place, value in enumerate(data) if 48 <= value <= 57]
    if not digits:
        return _bit(data, rng)
    data[digits[int(rng.integers(len(digits)))]] = 48 + int(rng.integers(10))
    return data


def _zeros(data: bytearray, rng) -> bytearray:
    first = int(rng.integers(len(data)))
    last = min(len(data), first + int(rng.integers(1, 513)))
    data[first:last] = bytes(last - first)
    return data


def _end_missing(data: bytearray, rng) -> bytearray:
    return data[:int(rng.integers(len(data)))]


def _more(data: bytearray, rng) -> bytearray:
    return data + rng.bytes(int(rng.integers(1, 100)))


DAMAGES = {"a flipped bit": _bit, "another byte": _byte, "another digit": _digit, "a block of zeros": _zeros,
           "an end that is missing": _end_missing, "bytes behind the end": _more}
