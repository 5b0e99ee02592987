"""What a command leaves: its result as plain values that can be compared, and files that cannot be read."""

from __future__ import annotations

import csv
import hashlib
import re
from collections.abc import Callable
from pathlib import Path

from ssmr_torch.closed_loop.record import ARRAYS, ClosedLoopRecord
from ssmr_torch.fitting.checkpoints import load_model
from ssmr_torch.result_files import read_json
from ssmr_torch.search.multirun_table import results
from ssmr_torch.trajectory import TrajectoryDataset

LOGS = ("metrics", ".hydra")  # folders of what is written as it comes, which nothing reads
TIMES = ("fit_time", "step_time", "seconds", "minutes", "solve_time", "mean_solve_time", "time", "provenance", "cost",
         "commit", "python", "duration", "overrides")
SAID = re.compile(r"in [\d.]+ s of CPU")
TAKEN = re.compile(r"time|latency|seconds|slow|cpu", re.IGNORECASE)


def without_times(value):
    """Plain values without what differs from one run of the same work to the next."""
    if isinstance(value, dict):
        return {key: without_times(each) for key, each in value.items() if key not in TIMES and not TAKEN.search(key)}
    if isinstance(value, str):
        return SAID.sub("", value)
    return [without_times(each) for each in value] if isinstance(value, list) else value


def values_in(path: Path):
    return without_times(read_json(path))


def digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def of_collect(directory: Path):
    dataset = TrajectoryDataset.load(directory / "trajectories.h5")
    runs = [run.read() for run in dataset]
    return [(run.name, run.kind, run.split, *(array.tobytes() for array in (run.time, run.observation, run.input)))
            for run in runs] + [str(without_times(dataset.provenance))]


def of_train(directory: Path):
    model, card = load_model(directory / "model.ckpt")
    report = values_in(directory / "report.json")
    return {name: value.numpy().tobytes() for name, value in model.state_dict().items()}, card["scores"], report, \
        values_in(directory / "result.json")


def of_search(directory: Path):
    tried = sorted((sorted(result["overrides"]), sorted(without_times(result["metrics"]).items()))
                   for result in results(directory))
    with open(directory / "sweep.csv", newline="", encoding="utf-8") as file:
        best = next(csv.DictReader(file))
    return tried, best["overrides"], (directory / "found.yaml").is_file()


def of_artifact(directory: Path):
    found = {path.name: digest(path) for path in sorted(directory.glob("artifact/*.safetensors"))}
    controller = directory / "artifact" / "controller.json"
    return found, values_in(controller) if controller.is_file() else None, sorted(
        path.relative_to(directory).as_posix() for path in directory.glob("artifact/**/*"))


def of_evaluate(directory: Path):
    return values_in(directory / "scores.json")


def of_compare(directory: Path):
    return values_in(directory / "comparison.json")


def of_control(directory: Path):
    record = ClosedLoopRecord.load(directory / "record.h5")
    return [getattr(record, name).tobytes() for name in ARRAYS if name != "solve_time"], record.statuses


def of_report(directory: Path):
    page = (directory.parent / "inputs" / "report.html").read_text(encoding="utf-8")
    return page.count("<svg"), page.count("<table"), page.rstrip().endswith("</html>")


PRODUCTS: dict[tuple[str, bool], Callable] = {
    ("collect", False): of_collect, ("train", False): of_train, ("train", True): of_search,
    ("export", False): of_artifact, ("design", False): of_artifact, ("evaluate", False): of_evaluate,
    ("compare", False): of_compare, ("control", False): of_control, ("report", False): of_report}


def unreadable(directory: Path, *, leftovers: bool = False) -> str:
    """What is half written in a directory; "" where nothing is. leftovers: whether a file may wait for its renaming."""
    for path in sorted(directory.rglob("*")):
        unfinished = any(".part" in part for part in path.relative_to(directory).parts)
        if not path.is_file() or set(path.relative_to(directory).parts) & set(LOGS) or leftovers and unfinished:
            continue
        if unfinished:
            return f"{path.name} is left"
        try:
            _read(path)
        except Exception as error:
            return f"{path.name} cannot be read: {error}"
    return ""


def _read(path: Path) -> None:
    if path.suffix == ".json":
        read_json(path)
    elif path.suffix == ".h5":
        (ClosedLoopRecord if path.name == "record.h5" else TrajectoryDataset).load(path)
    elif path.suffix == ".ckpt":
        load_model(path)
    elif path.suffix == ".svg" and not path.read_text(encoding="utf-8").rstrip().endswith("</svg>"):
        raise ValueError("it has no end")
