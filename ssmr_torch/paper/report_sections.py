"""The report of a reproduction: a summary, then every table and figure of the paper with ours, theirs and a verdict."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path

import h5py

from ssmr_torch.paper import published_numbers as published
from ssmr_torch.paper.error_distribution_figures import error_boxes
from ssmr_torch.paper.error_map_figures import error_maps
from ssmr_torch.paper.number_text import MM, MS, PERCENT, counted_runs, ordered, saver, scaled, span, unless_nan
from ssmr_torch.paper.report_closed_loops import loop_parts, pareto_parts
from ssmr_torch.paper.verdicts import REFERENCE, Results, Run, judge, loops, tally
from ssmr_torch.report.html_page import Picture, Section, Table
from ssmr_torch.result_files import read_json

HORIZONS = ("50 ms", "200 ms", "1 s")
BENCHES = ("emulated_bench", "recordings")  # the emulated one, and recordings of the real one
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
                             for name, score in read_json(path)["scores"].items()}
                 for path in sorted(directory.glob("open_loop/*.json"))}
    delays = {path.parent.name: read_json(path)["rows"]
              for path in sorted(directory.glob("delays/*/delays.json"))}
    return Results(runs, _rows(directory / "models.csv"), open_loop, delays)


def _rows(path: Path) -> list[dict]:
    """Rows of a table; an empty number is infinite, but NaN where it tells of obstacles."""
    if not path.is_file():
        return []
    return [{key: value == "true" if key == "real_time" else value if key in NOT_A_NUMBER else
             float(value) if value else math.nan if "violation" in key else math.inf for key, value in row.items()}
            for row in csv.DictReader(path.read_text(encoding="utf-8").splitlines())]


def _summary(results: Results, experiments: Sequence[str], missing: Sequence[str]) -> Section:
    verdicts = {name: judge(name, results) for name in experiments}
    counted = {kind: sum(verdict.verdict == kind for verdict in verdicts.values())
               for kind in ("reproduced", "better", "refuted", "not judged")}
    parts = [f"Of {len(verdicts)} tables and figures {', '.join(f'{n} {kind}' for kind, n in counted.items() if n)}. "
             "Refuted: the claim does not hold here. Better: it holds, and the number that the paper prints of SSMR is "
             "surpassed. The robots are finite-element models of our own and the bench is emulated: numbers compare "
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
                  unless_nan(mean.ise / reference), unless_nan(PERCENT * mean.violation_ratio),
                  unless_nan(MM * mean.max_violation), mean.load_p99]
                 for name, mean in ((name, means[name]) for name in ordered(means, means))]
    return rows


def _protocol(figure: str, results: Results) -> str:
    """How the paper did it, and how it was done here."""
    paper = published.FIGURES[figure]
    if paper.here:
        return f"{paper.protocol} {paper.here}"
    if paper.robot:
        return (f"{paper.protocol} Here every model sees its own true window at the same "
                f"{_starts(paper.robot, results)}, also over "
                "200 ms and 1 s, beside persistence and constant velocity.")
    loop = [own for methods in loops(figure, results.runs).values() for own in methods.values()]
    periods = sorted({MS * own[0].period for own in loop})
    return (f"{paper.protocol} Here {counted_runs({len(own) for own in loop})} of each method at a period of "
            f"{span(periods)} ms, the ISE being the sum of squared errors from 1 s on.")


def _parts(figure: str, directory: Path, results: Results) -> list:
    """Tables and pictures of one section; none where its data are missing."""
    if figure == "table1":
        return _model_parts(results)
    if figure == "fig3":
        return _delay_parts(directory, results)
    if published.FIGURES[figure].robot:
        return _open_loop_parts(figure, directory, results)
    if figure == "fig10":
        return _emulated_bench_parts(results)
    if figure == "fig8":
        return pareto_parts(directory, results)
    return loop_parts(figure, directory, results)


def _model_parts(results: Results) -> list:
    rows = []
    order = ordered({row["method"] for row in results.models}, [row["method"] for row in results.models])
    for row in sorted(results.models, key=lambda row: (row["robot"], order.index(row["method"]))):
        printed = published.TABLE_1.get(row["robot"], {}).get(row["method"])
        rows.append([row["robot"], row["method"], unless_nan(row["state_dim"]), printed and printed.dimension,
                     unless_nan(row["controlled_samples"]), printed and printed.transitions, unless_nan(row["decays"]),
                     printed and printed.others, unless_nan(row["delays"]), printed and printed.delays,
                     unless_nan(row["parameters"]), unless_nan(row["fit_time"]), row["command"] or None])
    header = ["robot", "method", "n", "paper", "controlled samples", "paper", "decays", "paper", "delays", "paper",
              "parameters", "fit (CPU s)", "settings"]
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
    if not results.open_loop.get(robot):
        return []
    parts, starts = [_open_loop_table(robot, results)], _starts(robot, results)
    path = directory / "open_loop" / f"{robot}.h5"
    if path.is_file():
        with h5py.File(path, "r") as file:
            position, errors = file["position"][:], {name: file["error"][name][:] for name in file["error"]}
        errors = {name: errors[name] for name in ordered(errors, results.open_loop[robot])}
        save = saver(directory)
        parts += [Picture(save(error_maps(position, errors), f"{figure}-map"),
                          "Error over the 50 ms after each start, drawn where the tip was; crossed out: diverged.",
                          starts, "mm"),
                  Picture(save(error_boxes(errors), f"{figure}-boxes"),
                          "The same errors: quartiles, whiskers within 1.5 of their distance, outliers; diverged "
                          "starts count as infinite.", starts, "mm")]
    return parts


def _starts(robot: str, results: Results) -> str:
    return f"{next(iter(results.open_loop[robot].values()))['50 ms']['starts']} starts"


def _open_loop_table(robot: str, results: Results) -> Table:
    scores, paper = results.open_loop[robot], published.OPEN_LOOP.get(robot, {})
    rows = [[name, *(scaled(MM, scores[name].get(label, {}).get("mean"), math.inf) for label in HORIZONS),
             scaled(MM, scores[name]["50 ms"]["median"], math.inf), *([scaled(MM, paper.get(name))] if paper else []),
             PERCENT * max(part["diverged"] for part in scores[name].values())] for name in ordered(scores, scores)]
    return Table(["method", *(f"{label} (mm)" for label in HORIZONS), "median, 50 ms (mm)",
                  *(["paper, 50 ms (mm)"] if paper else []), "diverged (%)"], rows,
                 f"{robot.capitalize()}: mean RMSE of the tip over n = {_starts(robot, results)} for each horizon, the "
                 f"median{', what the paper prints' if paper else ''}, and the largest share of diverged rollouts; ∞ "
                 "where one diverged.")


def _emulated_bench_parts(results: Results) -> list:
    rows = []
    for figure in ("fig11", "fig12"):
        for (_, task), methods in loops(figure, results.runs).items():
            rows += [[task, name, MS * runs[0].period, len(runs)] for name, runs in methods.items()]
    parts = [Table(["task", "method", "period (ms)", "runs"], rows, "Tasks on the emulated bench, and the shortest "
                   "control period that each method held in real time.")] if rows else []
    return parts + [_open_loop_table(robot, results) for robot in BENCHES if results.open_loop.get(robot)]
