"""The report of a reproduction: a summary, then every table and figure of the paper with ours, theirs and a verdict."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path

import h5py
import numpy as np

from ssmr_torch.closed_loop import ClosedLoopRecord
from ssmr_torch.evaluation import figures, paper_figures, paper_figures_runs
from ssmr_torch.evaluation.bootstrap import mean_interval
from ssmr_torch.evaluation.report import Picture, Section, Table
from ssmr_torch.reproduction import published
from ssmr_torch.reproduction.verdicts import REFERENCE, Results, Run, judge, loops, pareto_front, tally
from ssmr_torch.tasks.obstacles import random_circles

HORIZONS = ("50 ms", "200 ms", "1 s")
PATHS = 10  # runs of a method that are drawn
MM, MS, PERCENT = 1e3, 1e3, 100.0
NOT_A_NUMBER = {"figure", "robot", "method", "task", "record", "command", "real_time"}


def report_sections(directory: Path, experiments: Sequence[str]) -> list[Section]:
    """Sections from what lies in the directory of a reproduction; what is missing is left out with a sentence.

    experiments: table1, fig3 … fig12, as they shall appear. Drawings are saved below directory/figures.
    Raises ValueError for another name.
    """
    directory = Path(directory)
    unknown = [name for name in experiments if name not in published.FIGURES]
    if unknown:
        raise ValueError(f"no table or figure {unknown}; expected some of {', '.join(published.FIGURES)}")
    results = read_results(directory)
    made = {name: _parts(name, directory, results) for name in experiments}
    sections = [Section(published.FIGURES[name].title, [_protocol(name, results), *parts,
                                                        "Verdict: {}. {}".format(*judge(name, results))])
                for name, parts in made.items() if parts]
    return [_summary(results, experiments, [name for name, parts in made.items() if not parts]), *sections]


def read_results(directory: Path) -> Results:
    """runs.csv, models.csv, scores below open_loop and studies below delays, as far as they exist."""
    runs = [Run(**{field.name: row[field.name] for field in fields(Run)}) for row in _rows(directory / "runs.csv")]
    open_loop = {path.stem: {name: {part["label"]: part for part in score["horizons"]}
                             for name, score in json.loads(path.read_text())["scores"].items()}
                 for path in sorted(directory.glob("open_loop/*.json"))}
    delays = {path.parent.name: json.loads(path.read_text())["rows"]
              for path in sorted(directory.glob("delays/*/delays.json"))}
    return Results(runs, _rows(directory / "models.csv"), open_loop, delays)


def _rows(path: Path) -> list[dict]:
    """Rows of a table; an empty number is infinite, but NaN where it tells of obstacles."""
    if not path.is_file():
        return []
    return [{key: value == "true" if key == "real_time" else value if key in NOT_A_NUMBER else
             float(value) if value else math.nan if "violation" in key else math.inf for key, value in row.items()}
            for row in csv.DictReader(path.read_text().splitlines())]


def _summary(results: Results, experiments: Sequence[str], missing: Sequence[str]) -> Section:
    verdicts = {name: judge(name, results) for name in experiments}
    counted = {kind: sum(verdict.verdict == kind for verdict in verdicts.values())
               for kind in ("reproduced", "better", "refuted", "not judged")}
    parts = [f"Of {len(verdicts)} tables and figures {', '.join(f'{n} {kind}' for kind, n in counted.items() if n)}. "
             "Refuted: the claim does not hold here. Better: it holds, and the number that the paper prints of SSMR is "
             "surpassed. The robots are finite-element models of our own and the hardware is emulated: numbers compare "
             "within this report first. Where the settings of a model were searched, its table says how.",
             *([f"Left out, as their data are missing: {', '.join(missing)}."] if missing else []),
             Table(["", "claim", "verdict", "reason"],
                   [[name, published.FIGURES[name].claim or None, *verdict] for name, verdict in verdicts.items()],
                   "The paper's claims, judged by the numbers below.")]
    rows = [row for name in experiments if name != "fig8" for row in _summary_rows(name, results)]
    if rows:
        parts.append(Table(["robot", "task", "method", "n", "period (ms)", "ISE (mm²)", "ISE / SSMR (–)", "inside (%)",
                            "depth (mm)", "solve p99 / period (–)"], rows,
                           "Closed loops: means over n runs of the ISE, its ratio to that of SSMR, the time inside "
                           "obstacles, the largest depth, and the 99th percentile of the solve times over the period."))
    return Section("What came out", parts)


def _summary_rows(figure: str, results: Results) -> list[list]:
    rows = []
    for (robot, task), methods in loops(figure, results.runs).items():
        means = {name: tally(runs) for name, runs in methods.items()}
        reference = means[REFERENCE].ise if REFERENCE in means else math.nan
        rows += [[robot, task, name, mean.n, MS * methods[name][0].period, MM ** 2 * mean.ise,
                  _known(mean.ise / reference), _known(PERCENT * mean.violation_ratio), _known(MM * mean.max_violation),
                  mean.load_p99] for name, mean in ((name, means[name]) for name in _ordered(means, means))]
    return rows


def _protocol(figure: str, results: Results) -> str:
    """How the paper did it, and how it was done here."""
    paper = published.FIGURES[figure]
    if paper.here:
        return f"{paper.protocol} {paper.here}"
    if paper.robot:
        starts = next(iter(results.open_loop[paper.robot].values()))["50 ms"]["starts"]
        return (f"{paper.protocol} Here every model sees its own true window at the same {starts} starts, also over "
                "200 ms and 1 s, beside persistence and constant velocity.")
    loop = [own for methods in loops(figure, results.runs).values() for own in methods.values()]
    periods = sorted({MS * own[0].period for own in loop})
    return (f"{paper.protocol} Here {_runs({len(own) for own in loop})} of each method at a period of "
            f"{_range(periods)} ms, the ISE being the sum of squared errors from 1 s on.")


def _parts(figure: str, directory: Path, results: Results) -> list:
    """Tables and pictures of one section; none where its data are missing."""
    if figure == "table1":
        return _model_parts(results)
    if figure == "fig3":
        return _delay_parts(directory, results)
    if published.FIGURES[figure].robot:
        return _open_loop_parts(figure, directory, results)
    if figure == "fig10":
        return _bench_parts(results)
    if figure == "fig8":
        return _pareto_parts(directory, results)
    return _loop_parts(figure, directory, results)


def _model_parts(results: Results) -> list:
    rows = []
    order = _ordered({row["method"] for row in results.models}, [row["method"] for row in results.models])
    for row in sorted(results.models, key=lambda row: (row["robot"], order.index(row["method"]))):
        printed = published.TABLE_1.get(row["robot"], {}).get(row["method"])
        rows.append([row["robot"], row["method"], _known(row["state_dim"]), printed and printed.dimension,
                     _known(row["controlled_samples"]), printed and printed.transitions, _known(row["decays"]),
                     printed and printed.others, _known(row["delays"]), printed and printed.delays,
                     _known(row["parameters"]), _known(row["fit_time"]), row["command"] or None])
    header = ["robot", "method", "n", "paper", "controlled samples", "paper", "decays", "paper", "delays", "paper",
              "parameters", "fit (s)", "settings"]
    caption = ("State dimension n, training data, delays and parameters of every model, beside the paper's Table 1 (of "
               "the static pregain set points in place of decays), and how its settings were found.")
    return [Table(header, rows, caption)] if rows else []


def _delay_parts(directory: Path, results: Results) -> list:
    parts = []
    for robot, study in results.delays.items():
        rows = [[row["delays"], "yes" if row["reparametrized"] else "no", row["ratio"], row["error"]] for row in study]
        parts.append(Table(["delays", "reparametrized", "‖ŷ‖ / ‖y‖ (%)", "‖ŷ − y‖ / ‖y‖ (%)"], rows,
                           f"A controlled run of the {robot} through manifolds of its decays (n = 1 run); the paper "
                           "shows the ratio as a plot only."))
        if (drawing := directory / "delays" / robot / "delays.svg").is_file():
            parts.append(Picture(drawing, f"What delays do to the {robot}'s manifold under control.", "1 run",
                                 "%, mm"))
    return parts


def _open_loop_parts(figure: str, directory: Path, results: Results) -> list:
    robot = published.FIGURES[figure].robot
    scores = results.open_loop.get(robot)
    if not scores:
        return []
    rows = [[name, *(_scaled(MM, parts.get(label, {}).get("mean"), math.inf) for label in HORIZONS),
             _scaled(MM, parts["50 ms"]["median"], math.inf), _scaled(MM, published.OPEN_LOOP[robot].get(name)),
             PERCENT * max(part["diverged"] for part in parts.values())] for name, parts in scores.items()]
    starts = next(iter(scores.values()))["50 ms"]["starts"]
    count = f"{starts} starts"
    parts = [Table(["method", *(f"{label} (mm)" for label in HORIZONS), "median, 50 ms (mm)", "paper, 50 ms (mm)",
                    "diverged (%)"], rows, f"Mean RMSE of the tip over n = {count} for each horizon, the median, what "
                   "the paper prints, and the largest share of diverged rollouts; ∞ where one diverged.")]
    path = directory / "open_loop" / f"{robot}.h5"
    if path.is_file():
        with h5py.File(path, "r") as file:
            position, errors = file["position"][:], {name: file["error"][name][:] for name in file["error"]}
        errors = {name: errors[name] for name in _ordered(errors, scores)}
        save = _saver(directory)
        parts += [Picture(save(paper_figures.error_maps(position, errors), f"{figure}-map"),
                          "Error over the 50 ms after each start, drawn where the tip was; crossed out: diverged.",
                          count, "mm"),
                  Picture(save(paper_figures.error_boxes(errors), f"{figure}-boxes"),
                          "The same errors: quartiles, whiskers within 1.5 of their distance, outliers; diverged "
                          "starts count as infinite.", count, "mm")]
    return parts


def _bench_parts(results: Results) -> list:
    rows = []
    for figure in ("fig11", "fig12"):
        for (_, task), methods in loops(figure, results.runs).items():
            rows += [[task, name, MS * runs[0].period, len(runs)] for name, runs in methods.items()]
    return [Table(["task", "method", "period (ms)", "runs"], rows, "Tasks on the emulated bench, and the shortest "
                  "control period that each method held in real time.")] if rows else []


def _pareto_parts(directory: Path, results: Results) -> list:
    tasks, rows, runs = {}, [], set()
    for (robot, task), methods in loops("fig8", results.runs).items():
        means = {name: tally(own) for name, own in methods.items()}
        front = pareto_front({name: (mean.load, mean.ise) for name, mean in means.items()})
        tasks[f"{robot}: {task}"] = [{"method": name, "ise": mean.ise, "load": mean.load, "load_p99": mean.load_p99,
                                      "front": name in front} for name, mean in means.items()]
        runs |= {mean.n for mean in means.values()}
        for name, mean in means.items():
            printed = published.SOLVE_TIME.get(robot, {}).get(name)
            rows.append([robot, task, name, MM ** 2 * mean.ise, MS * mean.load * methods[name][0].period,
                         _scaled(MS, printed), mean.load, mean.load_p99, "yes" if name in front else "no"])
    if not tasks:
        return []
    header = ["robot", "task", "method", "ISE (mm²)", "solve, median (ms)", "paper, about (ms)", "median / period (–)",
              "p99 / period (–)", "on the front"]
    picture = paper_figures_runs.pareto(tasks)
    return [Picture(_saver(directory)(picture, "fig8-pareto"), "ISE over solve time / control period; ringed and "
                    "joined: none is better in both; lines reach to the 99th percentile; right of 1 is too late.",
                    f"{_runs(runs)} of each method", "mm² over 1"),
            Table(header, rows, "Accuracy and computing time of all methods.")]


def _loop_parts(figure: str, directory: Path, results: Results) -> list:
    places = loops(figure, results.runs)
    if not places:
        return []
    among_obstacles = figure in ("fig9", "fig12")
    save, parts = _saver(directory), [_loop_table(figure, places)]
    relative = {task: {name: [run.ise for run in methods[name]] for name in _ordered(methods, methods)}
                for (_, task), methods in places.items()
                if REFERENCE in methods and math.isfinite(tally(methods[REFERENCE]).ise)}
    for (robot, task), methods in places.items():
        methods = {name: methods[name] for name in _ordered(methods, methods)}
        parts += _path_pictures(f"{figure}-{task.replace(' ', '-')}", directory, robot, task, methods, among_obstacles)
        if among_obstacles:
            statistics = {name: {key: np.array([getattr(run, key) for run in own])
                                 for key in ("ise", "violation_ratio", "max_violation")}
                          for name, own in methods.items()}
            parts.append(Picture(save(paper_figures_runs.obstacle_boxes(statistics), f"{figure}-boxes"),
                                 "ISE, share of the time inside an obstacle, largest depth of each run; beside each "
                                 "box its median.", _count(methods), "mm², %, mm"))
    if relative and not among_obstacles:
        parts.append(Picture(save(paper_figures_runs.relative_ise_bars(relative), f"{figure}-relative"),
                             "ISE relative to the mean of SSMR, with bootstrap 95 % intervals of the mean (none of a "
                             "single run); dots are runs.", _count(next(iter(places.values()))), "%"))
    return parts


def _loop_table(figure: str, places: Mapping) -> Table:
    rows = []
    for (robot, task), methods in places.items():
        reference = tally(methods[REFERENCE]).ise if REFERENCE in methods else math.nan
        for name in _ordered(methods, methods):
            mean, interval = tally(methods[name]), mean_interval([run.ise for run in methods[name]])
            printed = next((row.get(name) for (at, what), row in published.TRACKING.items()
                            if at == robot and what in task), None)
            rows.append([task, name, mean.n, MM ** 2 * mean.ise, *(_known(MM ** 2 * end) for end in interval[1:]),
                         _known(PERCENT * (mean.ise / reference - 1)), MM * mean.rmse, _scaled(MM, printed),
                         _known(PERCENT * mean.violation_ratio), _known(MM * mean.max_violation),
                         MS * methods[name][0].period, mean.load_p99, sum(run.fallbacks for run in methods[name])])
    header = ["task", "method", "n", "ISE (mm²)", "from", "to", "to SSMR (%)", "RMSE (mm)", "paper, about (mm)",
              "inside (%)", "depth (mm)", "period (ms)", "p99 / period (–)", "fallbacks"]
    kept = [column for column in range(len(header)) if any(row[column] is not None for row in rows)]
    return Table([header[column] for column in kept], [[row[column] for column in kept] for row in rows],
                 "Means over n runs, the ISE with its bootstrap 95 % interval (none of a single run); the paper's RMSE "
                 "is read off its plots where it can be; fallbacks in all runs.")


def _path_pictures(name: str, directory: Path, robot: str, task: str, methods: Mapping[str, Sequence[Run]],
                   among_obstacles: bool) -> list[Picture]:
    """The best run of each method over the reference, among obstacles or with some of the others."""
    shown = {method: [ClosedLoopRecord.load(directory / run.record)
                      for run in sorted(own, key=lambda run: run.ise)[:1 if among_obstacles else PATHS]
                      if (directory / run.record).is_file()] for method, own in methods.items()}
    shown = {method: records for method, records in shown.items() if records and len(records[0].tracked) == 2}
    if not shown:
        return []
    first = next(iter(shown.values()))[0]
    axis_names = tuple(first.output_names[column].removeprefix("tip_") for column in first.tracked)
    paths = {method: [record.observation[:, list(record.tracked)] for record in records]
             for method, records in shown.items()}
    least = {method: min(methods[method], key=lambda run: run.ise) for method in shown}
    if among_obstacles:
        drawn = paper_figures_runs.obstacle_paths({
            method: {"reference": records[0].reference, "path": paths[method][0], "obstacles": _circles(records[0]),
                     "note": f"{MM ** 2 * least[method].ise:.3g} mm², "
                             f"{PERCENT * least[method].violation_ratio:.2g} % inside"}
            for method, records in shown.items()}, axis_names)
        caption = f"{task}: the run of each method with the lowest ISE among its obstacles; red: inside one."
    else:
        notes = {method: f"RMSE {MM * least[method].rmse:.3g} mm" for method in shown}
        drawn = paper_figures.tracked_paths(first.reference, paths, axis_names, notes)
        caption = f"{task}, {robot}: best run (bold, its RMSE above) and up to {PATHS - 1} others; dashed: reference."
    return [Picture(_saver(directory)(drawn, name), caption, _count(methods), "mm")]


def _circles(record: ClosedLoopRecord) -> np.ndarray:
    """(O, 3) m, centre and radius of the circles that the record's configuration names."""
    task = (record.provenance.get("configuration") or {}).get("task") or {}
    given = task.get("obstacles") or []
    if isinstance(given, Mapping):
        options = {key: value for key, value in given.items() if not key.startswith("_")}
        return np.array([[*circle.center, circle.radius] for circle in random_circles(**options)])
    return np.array([[*circle["center"], circle["radius"]] for circle in given if "radius" in circle]).reshape(-1, 3)


def _saver(directory: Path):
    return lambda figure, name: figures.save(figure, directory / "figures" / f"{name}.svg")


def _ordered(names: Iterable[str], there: Iterable[str]) -> list[str]:
    """In the order of the figures' methods: the paper's, then ours and further ones."""
    order = list(dict.fromkeys([*published.METHODS, *there]))
    return sorted(names, key=order.index)


def _count(methods: Mapping[str, Sequence[Run]]) -> str:
    return f"{_runs({len(own) for own in methods.values()})} of each method"


def _runs(counts: set[int]) -> str:
    return f"{_range(sorted(counts))} run{'s' * (max(counts) > 1)}"


def _range(values: Sequence[float]) -> str:
    return f"{values[0]:g}" if len(values) == 1 else f"{values[0]:g} to {values[-1]:g}"


def _known(value: float) -> float | None:
    return None if math.isnan(value) else value


def _scaled(factor: float, value: float | None, missing: float | None = None) -> float | None:
    return missing if value is None else factor * value
