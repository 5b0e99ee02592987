"""Tables from the result files of a run: scores of models, comparisons, closed loops, benchmarks, the reproduction."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from statistics import fmean
from typing import NamedTuple

from ssmr_torch.closed_loop.record import ClosedLoopRecord
from ssmr_torch.data_sheet import number
from ssmr_torch.documents.store import FOLDER, Numbers, cell, read, write
from ssmr_torch.provenance import provenance
from ssmr_torch.result_files import read_json

MM, MM2 = 1e3, 1e6
RUN_OF_MAKE = "evaluate/scores.json"


class Table(NamedTuple):
    """columns, rows and text as in `Numbers`; origin: the provenance of the result file."""

    columns: list[str] | None
    rows: list[list] | None
    origin: dict
    text: list[str] | None = None


def store_results(root: Path, directory: Path, name: str, table: str | None, command: list[str]) -> Path:
    """Write docs/numbers/NAME.json from the result files of a directory; the path.

    table: which of several tables. command: the commands that made the results; where it is empty that of an existing
    store is kept, and so is the note of an existing store.
    Raises ValueError where the directory has no result, where `table` is none of its tables, or where no command is
    known.
    """
    path, tables = root / FOLDER / f"{name}.json", tables_of(directory)
    if table is None and len(tables) > 1 or table is not None and table not in tables:
        raise ValueError(f"{directory} has the tables {', '.join(tables)}; choose one: table=NAME (given: {table})")
    found = tables[table] if table is not None else next(iter(tables.values()))
    before = read(path) if path.is_file() else None
    if not command and before is None:
        raise ValueError(f"{path} is new: which commands made {directory}? Give them: 'command=[\"ssmr …\"]'")
    configuration = found.origin.get("configuration", {})
    write(path, Numbers(command=command or before.command, version=found.origin["package"].split()[-1],
                        date=found.origin["time"][:10], seed=configuration.get("seed"),
                        note=before.note if before else "", columns=found.columns, rows=found.rows,
                        text=found.text))
    return path


def store_tables(root: Path, tables: dict[str, tuple[list[str], list[list]]], command: str) -> None:
    """Write (columns, rows) that a script has just made by `command` to docs/numbers/NAME.json, for every name."""
    origin = provenance()
    for name, (columns, rows) in tables.items():
        path = root / FOLDER / f"{name}.json"
        note = read(path).note if path.is_file() else ""
        write(path, Numbers(command=[command], version=origin["package"].split()[-1], date=origin["time"][:10],
                            note=note, columns=columns, rows=rows))


def tables_of(directory: Path) -> dict[str, Table]:
    """Every table of a result directory by name. Raises ValueError where it has none."""
    found = {name: table for reader in READERS for name, table in reader(Path(directory))}
    if not found:
        raise ValueError(f"{directory} has no results: expected the directory of make run, or of ssmr train "
                         "model=auto, evaluate, compare, control, benchmark or reproduce")
    return found


def _run_of_make(directory: Path) -> Iterator[tuple[str, Table]]:
    """Open loop and letter of every model, one row each."""
    path = directory / RUN_OF_MAKE
    if not path.is_file():
        return
    content = read_json(path)
    loops = {row[0]: row[2:4] for _, table in _loops(directory / "control") for row in table.rows}
    open_loop = _scores_table(content["scores"], content["provenance"])
    rows = [[*row, *loops.get(row[0], [None, None])] for row in open_loop.rows]
    yield "run", Table([*open_loop.columns, "letter, RMSE (mm)", "letter, ISE (mm²)"], rows, content["provenance"])


def _selection(directory: Path) -> Iterator[tuple[str, Table]]:
    """What a training with model=auto says of its choice, a line each."""
    path = directory / "report.json"
    content = read_json(path) if path.is_file() else {}
    if content.get("selection", {}).get("found"):
        yield "selection", Table(None, None, content["provenance"], content["selection"]["found"])


def _scores(directory: Path) -> Iterator[tuple[str, Table]]:
    """All runs together, and every group of runs."""
    path = directory / "scores.json"
    if path.is_file():
        content = read_json(path)
        for group, scores in ({"all": content["scores"]} | content["groups"]).items():
            yield group, _scores_table(scores, content["provenance"])


def _comparison(directory: Path) -> Iterator[tuple[str, Table]]:
    """Every group of runs: marked errors, share that diverged, error in % of the reach, CPU time. Then a summary: the
    first model beside the best other one, a row per group.
    """
    path = directory / "comparison.json"
    if not path.is_file():
        return
    content, summary = read_json(path), []
    for group, scores in content["groups"].items():
        base, rows = _scores_table(scores, content["provenance"], without="full"), []
        for row, score in zip(base.rows, scores.values()):
            parts = [part for part in score["horizons"] if part["label"] != "full"]
            marked = [f"{cell(value)} {score['marks'].get(part['label'], '')}".strip()
                      for value, part in zip(row[1:], parts)]
            last, seconds = parts[-1]["mean"], content["cpu"].get(row[0])
            rows.append([row[0], *marked, float(100 * max(part["diverged"] for part in parts)),
                         "∞" if last is None else float(100 * last / content["reach"]),
                         None if seconds is None else round(seconds)])
        yield group, Table([*base.columns, "diverged (%)", f"of reach, {parts[-1]['label']} (%)", "fit (CPU, s)"], rows,
                           base.origin)
        summary.append([group, *rows[0][1:len(parts) + 1], *_best_others(scores, content["cpu"])])
    labels = [part["label"] for part in parts]
    yield "summary", Table(["test runs", *(f"{next(iter(scores))}, {label} (mm)" for label in labels),
                            *(f"best other, {label} (mm)" for label in labels)], summary, content["provenance"])


def _best_others(scores: dict, fitted: dict) -> list[str]:
    """The lowest error of the fitted models but the first, with its name, by horizon."""
    _, *others = [name for name in scores if name in fitted]
    found = []
    for column, part in enumerate(scores[others[0]]["horizons"]):
        if part["label"] != "full":
            errors = {name: scores[name]["horizons"][column]["mean"] for name in others}
            best = min(others, key=lambda name: math.inf if errors[name] is None else errors[name])
            found.append(f"{cell(_mean(scores[best]['horizons'][column]))} {best}")
    return found


def _loops(directory: Path) -> Iterator[tuple[str, Table]]:
    """One closed loop, or one for each job of a multirun."""
    own = directory / "record.h5"
    records = [ClosedLoopRecord.load(path) for path in ([own] if own.is_file() else
                                                        sorted(directory.glob("*/record.h5")))]
    rows = []
    for record in records:
        metrics = record.report().metrics
        rows.append([record.provenance.get("model"), record.provenance.get("task"), MM * metrics["rmse"],
                     MM2 * metrics["ise"], round(metrics["fallbacks"])])
    if records:
        yield "loops", Table(["model", "task", "RMSE (mm)", "ISE (mm²)", "fallbacks"], rows, records[0].provenance)


def _benchmark(directory: Path) -> Iterator[tuple[str, Table]]:
    """A file of `ssmr benchmark NAME`: rows by name of column."""
    for path in sorted(directory.glob("*.json")):
        content = read_json(path)
        rows = content.get("rows") if isinstance(content, dict) else None
        if rows:
            columns = list(dict.fromkeys(column for row in rows for column in row))
            yield path.stem, Table(columns, [[row.get(column) for column in columns] for row in rows],
                                   content["provenance"])


def _reproduction(directory: Path) -> Iterator[tuple[str, Table]]:
    """ISE, time inside an obstacle, depth, and computing time over the period: a row per task, a column per method.
    Open loop: a row per robot and horizon.
    """
    if not (directory / "runs.csv").is_file():
        return
    with open(directory / "runs.csv", encoding="utf-8", newline="") as file:
        runs = list(csv.DictReader(file))
    origin = ClosedLoopRecord.load(directory / runs[0]["record"]).provenance
    methods = list(dict.fromkeys(run["method"] for run in runs))
    for name, value in (("ise", lambda run: MM2 * float(run["ise"])),
                        ("inside", lambda run: 100 * float(run["violation_ratio"])),
                        ("depth", lambda run: MM * float(run["max_violation"])),
                        ("computing_time", lambda run: float(run["solve_p99"]) / float(run["period"]))):
        yield name, Table(["robot: task", *methods], _by_task(runs, methods, value), origin)
    scores = {path.stem: read_json(path)["scores"]
              for path in sorted(directory.glob("open_loop/*.json"))}
    names = list(dict.fromkeys(name for of_robot in scores.values() for name in of_robot))
    rows = [[f"{robot}, {label}", *(cells.get(name) for name in names)] for robot, of_robot in scores.items()
            for label, cells in _by_horizon(of_robot).items()]
    if rows:
        yield "open_loop", Table(["robot, horizon", *names], rows, origin)


READERS = (_run_of_make, _selection, _scores,  _comparison, _loops, _benchmark, _reproduction)


def _by_task(runs: list[dict], methods: list[str], value: Callable[[dict], float]) -> list[list]:
    """Means over the runs of each robot, task and method at the shortest period; empty cells where there is no run."""
    rows = []
    for robot, task in dict.fromkeys((run["robot"], run["task"]) for run in runs):
        own = [run for run in runs if (run["robot"], run["task"]) == (robot, task)]
        period = min(float(run["period"]) for run in own)
        cells = [[value(run) for run in own if run["method"] == method and float(run["period"]) == period
                  and run["ise"]] for method in methods]
        rows.append([f"{robot}: {task}", *(fmean(each) if each else None for each in cells)])
    return rows


def _by_horizon(scores: dict) -> dict[str, dict]:
    """Mean error in mm by horizon and model."""
    found: dict[str, dict] = {}
    for name, score in scores.items():
        for each in score["horizons"]:
            found.setdefault(each["label"], {})[name] = _mean(each)
    return found


def _scores_table(scores: dict, origin: dict, without: str = "") -> Table:
    """Mean errors in mm by horizon; ∞ with the share of diverged rollouts where some diverged."""
    labels = [part["label"] for part in next(iter(scores.values()))["horizons"] if part["label"] != without]
    rows = [[name, *(_mean(part) for part in score["horizons"] if part["label"] != without)]
            for name, score in scores.items()]
    return Table(["model", *(f"{label} (mm)" for label in labels)], rows, origin)


def _mean(part: dict) -> float | str:
    if part["mean"] is None or not math.isfinite(part["mean"]):
        return f"∞ ({number(100 * part['diverged'])} %)"
    return MM * part["mean"]
