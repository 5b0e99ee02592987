"""Parts of the report of a reproduction that show closed loops: tables, paths, boxes, accuracy over computing time."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ssmr_torch.closed_loop.record import ClosedLoopRecord
from ssmr_torch.evaluation.bootstrap import mean_interval
from ssmr_torch.paper import closed_loop_figures
from ssmr_torch.paper import published_numbers as published
from ssmr_torch.paper.figure_panels import plain
from ssmr_torch.paper.number_text import MM, MS, PERCENT, counted_runs, of_each, ordered, saver, scaled, unless_nan
from ssmr_torch.paper.path_figures import tracked_paths
from ssmr_torch.paper.verdicts import REFERENCE, Results, Run, loops, pareto_front, tally
from ssmr_torch.report.html_page import Picture, Table
from ssmr_torch.tasks.obstacles import random_circles

PATHS = 10  # runs of a method that are drawn


def loop_parts(figure: str, directory: Path, results: Results) -> list[Table | Picture]:
    """Table, paths and relative ISE of a figure's closed loops, among obstacles also boxes.

    Nothing where there are no runs. Drawings are saved below directory/figures.
    """
    places = loops(figure, results.runs)
    if not places:
        return []
    among_obstacles = figure in ("fig9", "fig12")
    save, parts = saver(directory), [_loop_table(figure, places)]
    relative = {task: {name: [run.ise for run in methods[name]] for name in ordered(methods, methods)}
                for (_, task), methods in places.items()
                if REFERENCE in methods and math.isfinite(tally(methods[REFERENCE]).ise)}
    for (robot, task), methods in places.items():
        methods = {name: methods[name] for name in ordered(methods, methods)}
        parts += _path_pictures(f"{figure}-{task.replace(' ', '-')}", directory, robot, task, methods, among_obstacles)
        if among_obstacles:
            statistics = {name: {key: np.array([getattr(run, key) for run in own])
                                 for key in ("ise", "violation_ratio", "max_violation")}
                          for name, own in methods.items()}
            stem = f"{figure}-boxes" + (f"-{task.replace(' ', '-')}" if len(places) > 1 else "")
            parts.append(Picture(save(closed_loop_figures.obstacle_boxes(statistics), stem),
                                 f"{task}: ISE, share of the time inside an obstacle, largest depth of each run; "
                                 "beside each box its median.", of_each(methods), "mm², %, mm"))
    if relative and not among_obstacles:
        parts.append(Picture(save(closed_loop_figures.relative_ise_bars(relative), f"{figure}-relative"),
                             "ISE relative to the mean of SSMR, with bootstrap 95 % intervals of the mean (none of a "
                             "single run); dots are runs.", of_each(next(iter(places.values()))), "%"))
    return parts


def pareto_parts(directory: Path, results: Results) -> list[Table | Picture]:
    """Drawing and table of ISE (mm²) over solve time / control period of all methods and tasks of Fig. 8."""
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
                         scaled(MS, printed), mean.load, mean.load_p99, "yes" if name in front else "no"])
    if not tasks:
        return []
    header = ["robot", "task", "method", "ISE (mm²)", "solve, median (ms)", "paper, about (ms)", "median / period (–)",
              "p99 / period (–)", "on the front"]
    picture = closed_loop_figures.pareto(tasks)
    return [Picture(saver(directory)(picture, "fig8-pareto"), "ISE over solve time / control period; ringed and "
                    "joined: none is better in both; lines reach to the 99th percentile; right of 1 is too late.",
                    f"{counted_runs(runs)} of each method", "mm² over 1"),
            Table(header, rows, "Accuracy and computing time of all methods.")]


def _loop_table(figure: str, places: Mapping) -> Table:
    rows = []
    for (robot, task), methods in places.items():
        reference = tally(methods[REFERENCE]).ise if REFERENCE in methods else math.nan
        for name in ordered(methods, methods):
            mean, interval = tally(methods[name]), mean_interval([run.ise for run in methods[name]])
            printed = next((row.get(name) for (at, what), row in published.TRACKING.items()
                            if at == robot and what in task), None)
            rows.append([task, name, mean.n, MM ** 2 * mean.ise, *(unless_nan(MM ** 2 * end) for end in interval[1:]),
                         unless_nan(PERCENT * (mean.ise / reference - 1)), MM * mean.rmse, scaled(MM, printed),
                         unless_nan(PERCENT * mean.violation_ratio), unless_nan(MM * mean.max_violation),
                         MS * methods[name][0].period, mean.load_p99, sum(run.fallbacks for run in methods[name])])
    header = ["task", "method", "n", "ISE (mm²)", "from", "to", "to SSMR (%)", "RMSE (mm)", "paper, about (mm)",
              "inside (%)", "depth (mm)", "period (ms)", "p99 / period (–)", "fallbacks"]
    kept = [column for column in range(len(header)) if any(row[column] is not None for row in rows)]
    return Table([header[column] for column in kept], [[row[column] for column in kept] for row in rows],
                 "Means over n runs, the ISE with its bootstrap 95 % interval (none of a single run); the paper's RMSE "
                 "is read off its plots where it can be; fallbacks in all runs.")


def _path_pictures(name: str, directory: Path, robot: str, task: str, methods: Mapping[str, Sequence[Run]],
                   among_obstacles: bool) -> list[Picture]:
    """Over the reference, one run of all methods among the same obstacles, or the best of each and some others."""
    kept = {method: [run for run in own if (directory / run.record).is_file()] for method, own in methods.items()}
    kept = _same_seed(kept) if among_obstacles else {
        method: sorted(own, key=lambda run: run.ise)[:PATHS] for method, own in kept.items()}
    shown = {method: [ClosedLoopRecord.load(directory / run.record) for run in own] for method, own in kept.items()}
    shown = {method: records for method, records in shown.items() if records and len(records[0].tracked) == 2}
    if not shown:
        return []
    first = next(iter(shown.values()))[0]
    axis_names = tuple(first.output_names[column].removeprefix("tip_") for column in first.tracked)
    paths = {method: [record.observation[:, list(record.tracked)] for record in records]
             for method, records in shown.items()}
    if among_obstacles:
        drawn = closed_loop_figures.obstacle_paths({
            method: {"reference": records[0].reference, "path": paths[method][0], "obstacles": _circles(records[0]),
                     "note": f"{plain(MM ** 2 * kept[method][0].ise)} mm², "
                             f"{PERCENT * kept[method][0].violation_ratio:.2g} % inside"}
            for method, records in shown.items()}, axis_names)
        caption = (f"{task}: all methods in one run, that in which {next(iter(shown))} has its median ISE; red: "
                   "inside an obstacle.")
    else:
        notes = {method: f"RMSE {MM * kept[method][0].rmse:.3g} mm" for method in shown}
        drawn = tracked_paths(first.reference, paths, axis_names, notes)
        caption = f"{task}, {robot}: best run (bold, its RMSE above) and up to {PATHS - 1} others; dashed: reference."
    return [Picture(saver(directory)(drawn, name), caption, of_each(methods), "mm")]


def _same_seed(methods: Mapping[str, Sequence[Run]]) -> dict[str, list[Run]]:
    """The run of each method with the seed that gives the first of them its median ISE, of those that all have."""
    methods = {name: {run.seed: run for run in own} for name, own in methods.items() if own}
    common = set.intersection(*map(set, methods.values())) if methods else set()
    if not common:
        return {name: [] for name in methods}
    first = next(iter(methods.values()))
    seed = sorted(common, key=lambda seed: first[seed].ise)[(len(common) - 1) // 2]
    return {name: [own[seed]] for name, own in methods.items()}


def _circles(record: ClosedLoopRecord) -> np.ndarray:
    """(O, 3) m, centre and radius of the circles that the record's configuration names."""
    task = (record.provenance.get("configuration") or {}).get("task") or {}
    given = task.get("obstacles") or []
    if isinstance(given, Mapping):
        options = {key: value for key, value in given.items() if not key.startswith("_")}
        return np.array([[*circle.center, circle.radius] for circle in random_circles(**options)])
    return np.array([[*circle["center"], circle["radius"]] for circle in given if "radius" in circle]).reshape(-1, 3)
