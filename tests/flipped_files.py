"""Damage to every file that the package writes and reads again, and what became of it.

`python tests/flipped_files.py 10000` damages each file 10,000 times and prints the table.
"""

import logging
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from time import perf_counter
from typing import NamedTuple

import numpy as np

from ssmr_torch import found_settings, result_files, trajectory_file
from ssmr_torch.closed_loop.record import ARRAYS, ClosedLoopRecord
from ssmr_torch.deployment import artifact
from ssmr_torch.deployment.checkpoint_copy import load_twin
from ssmr_torch.fitting.checkpoints import load_model, save_model
from ssmr_torch.trajectory import Trajectory, TrajectoryDataset

WRITTEN_BEFORE = Path(__file__).resolve().parent / "written_by_0_7" / "SSMR"
OUTCOMES = ("refused", "said", "harmless", "wrong", "traceback")  # said: read, and the log says that it changed
LONGEST = 5.0  # s that a damaged file may take


class Written(NamedTuple):
    """A file, and how what it says is read: `read` returns plain values and bytes."""

    path: Path
    read: Callable[[], object]


def written_files(folder: Path) -> dict[str, Written]:
    """One file of each kind that the package writes, by what it is called in the table."""
    model, card = load_model(WRITTEN_BEFORE / "model.ckpt")
    old = artifact.load(WRITTEN_BEFORE / "artifact")
    designed = {"controller": {"_target_": "ssmr_torch.control.designed.DesignedController", "horizon": 5},
                "task": None, "tracked": old.card["output_names"], "input_bounds": old.card["input_range"],
                "timestep": 0.01, "facts": {"tuned": "by hand"}}
    at = artifact.save(folder / "artifact", old.model, designed=designed, scores={"test/rmse": 1e-3}, provenance=card,
                       **{name: old.card[name] for name in ("output_names", "input_names", "rest", "input_range")})
    artifact.add_files(at, lambda copy: result_files.save_text(copy / "deployed" / "model.c", "double one = 1.0;\n"))
    checkpoint = save_model(folder / "model.ckpt", model, card)
    rng = np.random.default_rng(0)
    runs = [Trajectory(0.01 * np.arange(40), rng.normal(size=(40, 2)), rng.normal(size=(40, 1)), kind, split, kind)
            for kind, split in (("decay", "train"), ("controlled", "test"))]
    data = TrajectoryDataset(runs, [0.1, 0.2], "xy", "u", provenance={"source": "drawn"}).save(folder / "runs.h5")
    record = _record(rng).save(folder / "run.h5")
    found = folder / "robot.yaml"
    found_settings.write(found, "robot", {"models": {"ssmr": {"settings": {"model": {"delays": 4}}, "found": {
        "metric": "validation/rmse", "score": 0.00123, "trials": 30}}}, "controllers": {}})
    result = result_files.save_json(folder / "result.json", {"scores": {"test/rmse": 0.0012}, "rows": [1, 2.5, "a"]})
    whole = lambda: _of_artifact(at)  # noqa: E731
    return {"artifact: " + name: Written(at / name, whole) for name in (
        "card.json", "tables.safetensors", "reference.safetensors", "controller.json", "deployed/model.c")} | {
        "checkpoint": Written(checkpoint, lambda: _of_checkpoint(*load_model(checkpoint))),
        "copy of a checkpoint": Written(checkpoint.with_suffix(".safetensors"), lambda: _of_copy(checkpoint)),
        "trajectories": Written(data, lambda: _of_trajectories(data)),
        "closed-loop record": Written(record, lambda: _of_record(record)),
        "found settings": Written(found, lambda: found_settings.read(found)),
        "results": Written(result, lambda: result_files.read_json(result))}


def _record(rng) -> ClosedLoopRecord:
    return ClosedLoopRecord(
        time=0.01 * np.arange(50), reference=rng.normal(size=(50, 1)), observation=rng.normal(size=(50, 2)),
        measurement=rng.normal(size=(50, 2)), input=rng.normal(size=(50, 1)), fallback=np.zeros(50, bool),
        solve_time=rng.uniform(size=50), iterations=np.ones(50, int), statuses=["SOLVED"] * 50, tracked=(0,),
        output_names=("x", "y"), input_names=("u",), provenance={"task": "circle"})


def _bytes(arrays) -> list:
    return [np.asarray(array).tobytes() for array in arrays]


def _of_artifact(at: Path) -> object:
    loaded = artifact.load(at)
    return loaded.card, loaded.designed, loaded.model.plain(), _bytes(loaded.model.arrays.values())


def _of_checkpoint(model, card) -> object:
    return card, model.arguments, {name: _bytes([array]) for name, array in model.state_dict().items()}


def _of_copy(checkpoint: Path) -> object:
    """A damaged copy is passed over: then the checkpoint itself is read."""
    copy = load_twin(checkpoint)
    if copy is None:
        raise ValueError(f"{checkpoint.with_suffix('.safetensors')} is passed over")
    return copy[1], copy[0].plain(), _bytes(copy[0].arrays.values())


def _of_trajectories(path: Path) -> object:
    trajectory_file._open_once.cache_clear()
    data = TrajectoryDataset.load(path)
    return (data.output_names, data.input_names, data.input_unit, data.provenance, _bytes([data.rest]),
            [(run.name, run.kind, run.split, _bytes([run.time, run.observation, run.input]))
             for run in (stored.read() for stored in data)])


def _of_record(path: Path) -> object:
    record = ClosedLoopRecord.load(path)
    return (_bytes(getattr(record, name) for name in ARRAYS), record.statuses, record.tracked, record.output_names,
            record.input_names, record.input_unit, record.provenance)


def damaged(content: bytes, rng: np.random.Generator, trial: int) -> bytes:
    """The content with one flipped bit; every fourth time with another byte, every twentieth cut, and so on."""
    place, changed = int(rng.integers(len(content))), bytearray(content)
    if trial % 20 == 19:
        return content[:place]
    if trial % 20 == 18:
        return content + bytes(rng.integers(0, 256, 1 + place % 20, dtype=np.uint8))
    if trial % 20 == 17:
        return content[:place] + content[place + 1:]
    if trial % 4 == 3:
        changed[place] = (changed[place] + int(rng.integers(1, 256))) % 256
    else:
        changed[place] ^= 1 << int(rng.integers(8))
    return bytes(changed)


def outcomes(written: Written, flips: int, seed: int = 0) -> tuple[Counter, list[str]]:
    """How often each of `OUTCOMES` came, and sentences on those that must not be."""
    content, expected, said = written.path.read_bytes(), written.read(), []
    handler = logging.Handler()
    handler.emit = lambda record: said.append(record.getMessage())
    log = logging.getLogger("ssmr_torch")
    log.addHandler(handler)
    rng, found, bad = np.random.default_rng(seed), Counter(), []
    for trial in range(flips):
        changed = damaged(content, rng, trial)
        written.path.unlink()  # a new file, which no open handle shares
        written.path.write_bytes(changed)
        begun = perf_counter()
        said.clear()
        try:
            outcome = "harmless" if _same(written.read(), expected) else "said" if said else "wrong"
        except ValueError as error:
            outcome = "refused" if str(error).count("\n") < 3 else "traceback"
        except Exception as error:
            outcome = "traceback"
            bad.append(f"damage {trial}: {type(error).__name__}: {error}")
        found[outcome] += 1
        if outcome == "wrong" or perf_counter() - begun > LONGEST:
            bad.append(f"damage {trial}: {outcome} after {perf_counter() - begun:.2g} s: {_change(content, changed)}")
    log.removeHandler(handler)
    written.path.unlink()
    written.path.write_bytes(content)
    return found, bad


def _change(content: bytes, changed: bytes) -> str:
    place = next((k for k, pair in enumerate(zip(content, changed)) if pair[0] != pair[1]), len(changed))
    return f"{content[place - 20:place + 20]} -> {changed[place - 20:place + 20]}"


def _same(one: object, other: object) -> bool:
    return repr(one) == repr(other)


def main(flips: int) -> int:
    with tempfile.TemporaryDirectory() as folder:
        print(f"{'file':34s}" + "".join(f"{name:>10s}" for name in OUTCOMES) + "   s")
        wrong = 0
        for name, written in written_files(Path(folder)).items():
            begun = perf_counter()
            found, bad = outcomes(written, flips)
            wrong += found["traceback"] + found["wrong"]
            print(f"{name:34s}" + "".join(f"{found[outcome]:10d}" for outcome in OUTCOMES)
                  + f"{perf_counter() - begun:8.1f}", *bad[:3], sep="\n    " if bad else "", flush=True)
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]) if len(sys.argv) > 1 else 300))
