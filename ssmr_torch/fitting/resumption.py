"""What a training that is resumed must share with its beginning: its data, its configuration, and the version."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from ssmr_torch import __version__
from ssmr_torch.interruption import END
from ssmr_torch.result_files import read_json, save_json
from ssmr_torch.run import STRETCH
from ssmr_torch.trajectory import TrajectoryDataset

BEGUN = "training.json"  # in the folder of the checkpoints
LAST = "last.ckpt"
DECISIVE = ("data", "outputs", "model", "module", "seed", "trainer")
OF_THE_DATA = ("output_names", "input_names", "input_unit", "sampling_time", "rest")
HARMLESS = ("trainer.enable_progress_bar", "trainer.enable_model_summary", "trainer.log_every_n_steps")
RESULTS = ("model.ckpt", "model.safetensors", "report.json", "result.json")
NAMED = 3  # differing files or runs in a message


def fingerprint(dataset: TrajectoryDataset, configuration: Mapping) -> dict:
    """What decides a training, as plain values.

    data: names, units, sampling time, s, rest, m, and of each run its kind, its split and the SHA-256 of its samples;
    sources: the SHA-256 of the files that it was read from, which name what has changed.
    """
    found = {"output_names": list(dataset.output_names), "input_names": list(dataset.input_names),
             "input_unit": dataset.input_unit, "sampling_time": dataset.timestep, "rest": dataset.rest.tolist()}
    runs = {f"{run.name or place}": {"kind": run.kind, "split": run.split, "sha256": _digest(run)}
            for place, run in enumerate(dataset)}
    plain = json.dumps({
        "version": __version__, "data": found, "runs": runs, "sources": _sources(dataset.provenance),
        "configuration": {name: configuration.get(name) for name in (*DECISIVE, "fit")}}, default=str)
    return json.loads(plain, parse_constant=lambda _: None)  # as `save_json` writes it


def begin(folder: Path, now: Mapping) -> None:
    """A training from its start: nothing of an earlier one in the directory of the run passes for its own."""
    for path in (*folder.glob("*/best.ckpt"), *folder.glob("*/last.ckpt"),
                 *(folder.parent / name for name in RESULTS)):
        path.unlink(missing_ok=True)
    save_json(folder / BEGUN, now)
    END.can_go_on()


def was_begun(folder: Path) -> bool:
    """Whether a training has written into this folder of checkpoints."""
    return (folder / BEGUN).is_file() or any(folder.glob(f"*/{LAST}"))


def go_on(folder: Path, steps: Sequence[str], now: Mapping) -> None:
    """Check that the fits `steps` can go on from the checkpoints in the folder with these data and this configuration.

    Raises ValueError, with the first difference, if nothing was begun there, or if data, model, module, seed, trainer,
    the version, or a fit that was begun differ.
    """
    directory, begun = folder.parent, [step for step in steps if (folder / step / LAST).is_file()]
    if not begun and not (folder / BEGUN).is_file():
        raise ValueError(f"resume=true, but there are no checkpoints below {folder}; give the directory of the run "
                         "to continue as hydra.run.dir, or leave resume=true out to begin a run there")
    then = _stored(folder / BEGUN)
    difference = next(_differences(then, now, begun), None)
    if difference:
        raise ValueError(f"the run in {directory} cannot be resumed: {difference}; resume it as it was started, or "
                         "start a new run in another hydra.run.dir")
    save_json(folder / BEGUN, now)
    END.can_go_on()


def _stored(path: Path) -> dict:
    try:
        found = read_json(path)
        if isinstance(found, dict) and {"version", "data", "runs", "sources", "configuration"} <= found.keys():
            return found
    except (OSError, ValueError):
        pass
    raise ValueError(f"{path}, which says with what data a run was started, is missing or damaged, as in runs of "
                     "versions before 0.12; start a new run in another hydra.run.dir")


def _differences(then: Mapping, now: Mapping, begun: Sequence[str]) -> Iterator[str]:
    """Sentences, those that explain others first."""
    if then["version"] != now["version"]:
        yield f"it was started by version {then['version']}, but this is version {now['version']}"
    for name in OF_THE_DATA:
        if then["data"].get(name) != now["data"][name]:
            yield f"data differ: {name} was {_shown(name, then['data'].get(name))}, now it is " \
                  f"{_shown(name, now['data'][name])}"
    yield from _other_runs(then, now)
    asked, given = (each["configuration"] for each in (then, now))
    pairs = [(name, asked.get(name), given.get(name)) for name in DECISIVE]
    pairs += [(f"fit.{step}", (asked.get("fit") or {}).get(step), (given.get("fit") or {}).get(step)) for step in begun]
    for name, old, new in pairs:
        yield from (f"it was started with {key}={one}, but now it is {two}"
                    for key, one, two in _different(name, old, new) if key not in HARMLESS)


def _other_runs(then: Mapping, now: Mapping) -> Iterator[str]:
    old, new = then["runs"], now["runs"]
    for what, names in (("without", [name for name in old if name not in new]),
                        ("with", [name for name in new if name not in old])):
        if names:
            yield f"data differ: they are now {what} the run {_few(names)}"
    for what in ("kind", "split"):
        for name in old.keys() & new.keys():
            if old[name][what] != new[name][what]:
                yield f"data differ: the {what} of {name} was {old[name][what]}, now it is {new[name][what]}"
    changed = [name for name in old if name in new and old[name]["sha256"] != new[name]["sha256"]]
    if changed:
        files = [name for name, digest in now["sources"].items() if then["sources"].get(name) != digest]
        yield f"data differ: {_few(files) if files else 'the samples of ' + _few(changed)}"


def _different(name: str, old, new) -> Iterator[tuple]:
    """The keys in which two configurations differ, and both values."""
    if isinstance(old, Mapping | None) and isinstance(new, Mapping | None) and old != new:
        old, new = old or {}, new or {}
        for key in sorted(old.keys() | new.keys()):
            yield from _different(f"{name}.{key}", old.get(key), new.get(key))
    elif old != new:
        yield name, old, new


def _digest(run) -> str:
    """SHA-256 of the samples of a run and of its sampling time; read piece by piece."""
    digest = hashlib.sha256(f"{run.length} {run.timestep!r}".encode())
    for start in range(0, run.length, STRETCH):
        for array in run.slice(start, min(start + STRETCH, run.length)):
            digest.update(np.ascontiguousarray(array, dtype=np.float64).tobytes())
    return digest.hexdigest()


def _sources(provenance: Mapping) -> dict[str, str]:
    """SHA-256 of each file by its name, as the readers note it."""
    stored = [provenance.get("stored"), *(provenance.get("joined") or ())]
    files = {each["file"]: each["sha256"] for each in stored if isinstance(each, Mapping) and "sha256" in each}
    noted = provenance.get("sources")
    return files | (dict(noted) if isinstance(noted, Mapping) else {})


def _shown(name: str, value) -> str:
    if name == "rest" and value is not None:
        return f"{[float(f'{1e3 * each:.6g}') for each in value]} mm"
    return f"{value}"


def _few(names: Sequence[str]) -> str:
    return ", ".join(names[:NAMED]) + (f" and {len(names) - NAMED} more" if len(names) > NAMED else "")
