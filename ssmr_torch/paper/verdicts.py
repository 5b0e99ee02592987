"""Whether what the paper claims came out, computed from the numbers of a reproduction.

refuted: the claim does not hold here. reproduced: it holds. better: it holds, and what the paper printed of SSMR is
surpassed; where the paper prints no number, nothing can be better. Claims are about the paper's methods; what a further
one does is told, but changes no verdict.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from ssmr_torch.paper import published_numbers as published

REFERENCE = "SSMR"
PARETO = ("fig6", "fig7", "fig8")  # Fig. 8 is about the closed loops of Fig. 6 and 7, and further ones of its own
REAL_ROBOT = ("fig10", "fig11", "fig12")
MM, MS, PERCENT = 1e3, 1e3, 100.0


@dataclass(frozen=True)
class Run:
    """One closed loop, a row of runs.csv: SI units; infinite where a run failed, NaN where there are no obstacles."""

    figure: str
    robot: str
    method: str
    task: str
    seed: int
    period: float
    real_time: bool
    ise: float
    rmse: float
    max_error: float
    violation_ratio: float
    max_violation: float
    solve_median: float
    solve_p99: float
    fallbacks: int
    record: str


@dataclass(frozen=True)
class Results:
    """What a reproduction left. models: rows of models.csv; open_loop: by robot, method and horizon's label, of
    `HorizonScore.as_dict`; delays: by robot, rows of `reconstruction_study`.
    """

    runs: Sequence[Run] = ()
    models: Sequence[Mapping] = ()
    open_loop: Mapping[str, Mapping[str, Mapping[str, Mapping]]] = field(default_factory=dict)
    delays: Mapping[str, Sequence[Mapping]] = field(default_factory=dict)


class Verdict(NamedTuple):
    """verdict: "reproduced", "better", "refuted" or "not judged"; reason: one sentence."""

    verdict: str
    reason: str


class Tally(NamedTuple):
    """Means over n runs of one method: ise m², rmse m, max_violation m, median and 99 % of the solve times / period."""

    n: int
    ise: float
    rmse: float
    violation_ratio: float
    max_violation: float
    load: float
    load_p99: float


def judge(figure: str, results: Results) -> Verdict:
    """The verdict on a table or figure. Raises ValueError for one that the paper does not have."""
    if figure not in JUDGES:
        raise ValueError(f"no verdict on {figure!r}; expected one of {', '.join(JUDGES)}")
    return JUDGES[figure](figure, results)


def loops(figure: str, runs: Sequence[Run]) -> dict[tuple[str, str], dict[str, list[Run]]]:
    """(robot, task) → method → runs of the figure, each method at one control period: in simulation that of SSMR, as in
    the paper, or the shortest; on the emulated bench the shortest that most of its runs held in real time.
    """
    found: dict[tuple[str, str], dict[str, list[Run]]] = {}
    for run in runs:
        if run.figure in (PARETO if figure == "fig8" else (figure,)):
            found.setdefault((run.robot, run.task), {}).setdefault(run.method, []).append(run)
    chosen = {}
    for place, methods in found.items():
        common = min((run.period for run in methods.get(REFERENCE, ())), default=0.0)
        periods = {method: _period(own, common, figure in REAL_ROBOT) for method, own in methods.items()}
        chosen[place] = {name: [run for run in own if run.period == periods[name]] for name, own in methods.items()}
    return chosen


def tally(runs: Sequence[Run]) -> Tally:
    """Means of the runs; infinite where one failed."""
    columns = ("ise", "rmse", "violation_ratio", "max_violation")
    means = [float(np.mean([getattr(run, column) for run in runs])) for column in columns]
    loads = [float(np.mean([getattr(run, column) / run.period for run in runs]))
             for column in ("solve_median", "solve_p99")]
    return Tally(len(runs), *means, *loads)


def pareto_front(points: Mapping[str, tuple[float, float]]) -> set[str]:
    """Those that no other equals or undercuts in one of two costs and undercuts in the other."""
    def beats(other: tuple[float, float], point: tuple[float, float]) -> bool:
        return other[0] <= point[0] and other[1] <= point[1] and other != point
    return {name for name, point in points.items()
            if all(map(math.isfinite, point)) and not any(beats(other, point) for other in points.values())}


def _period(runs: Sequence[Run], common: float, in_real_time: bool) -> float:
    periods = sorted({run.period for run in runs})
    if in_real_time:
        held = [period for period in periods
                if 2 * sum(run.real_time for run in runs if run.period == period)
                > sum(run.period == period for run in runs)]
        return held[0] if held else periods[0]
    return common if common in periods else periods[0]


def _table1(figure: str, results: Results) -> Verdict:
    said, holds, smaller = [], True, True
    for robot in dict.fromkeys(row["robot"] for row in results.models):
        printed = published.TABLE_1.get(robot, {})
        dimension = {row["method"]: row["state_dim"] for row in results.models
                     if row["robot"] == robot and row["method"] in printed}
        others = {name: n for name, n in dimension.items() if name not in published.OURS}
        if REFERENCE not in dimension or not others:
            continue
        least = min(others, key=others.get)
        holds &= dimension[REFERENCE] <= others[least]
        smaller &= dimension[REFERENCE] < printed[REFERENCE].dimension
        said.append(f"{robot} {dimension[REFERENCE]:.0f} against {others[least]:.0f} of {least}, the smallest baseline "
                    f"(published {printed[REFERENCE].dimension} against "
                    f"{min(printed[name].dimension for name in printed if name not in published.OURS)})")
    if not said:
        return _missing("models.csv has no robot with SSMR and a baseline")
    return Verdict(_rank(holds, smaller), f"Dimension of SSMR: {'; '.join(said)}.")


def _delays(figure: str, results: Results) -> Verdict:
    for robot, rows in results.delays.items():
        own, new = ({row["delays"]: row for row in rows if row["reparametrized"] == kind} for kind in (False, True))
        if len(own) < 2 or not new:
            continue
        first, last = min(own), max(own)
        lost = own[first]["ratio"] - own[last]["ratio"]
        ratios = [row["ratio"] for row in new.values()]
        holds = lost > max(ratios) - min(ratios) and lost > 0
        return Verdict(_rank(holds, False), (
            f"From {first} to {last} delays the {robot}'s reconstruction goes from {own[first]['ratio']:.3g} to "
            f"{own[last]['ratio']:.3g} %, reparametrized it stays within {min(ratios):.3g} and {max(ratios):.3g} %; "
            f"the error at {last} delays is {own[last]['error']:.3g} %, reparametrized {new[max(new)]['error']:.3g} %."
        ))
    return _missing("delays/ has no study with several delays, with and without reparametrization")


def _open_loop(figure: str, results: Results) -> Verdict:
    paper = published.FIGURES[figure]
    scores = results.open_loop.get(paper.robot, {})
    error = {name: _mean(parts, "50 ms") for name, parts in scores.items() if name in paper.methods}
    ours, theirs = (("SSMR", "SSSR"), ("DMD", "EDMD")) if figure == "fig4" else (("SSMR",), paper.methods[1:])
    theirs = [name for name in theirs if name in error]
    if any(name not in error for name in ours) or set(theirs) <= set(published.OURS):
        return _missing(f"open_loop/{paper.robot}.json has no errors over 50 ms of {' and '.join(ours)} and a baseline")
    worst, best = max(ours, key=error.get), min(theirs, key=error.get)
    holds = error[worst] < error[best]
    printed = published.OPEN_LOOP[paper.robot]
    starts = scores[REFERENCE]["50 ms"]["starts"]
    late = {name: _mean(parts, "1 s") for name, parts in scores.items() if name in paper.methods and "1 s" in parts}
    others = [name for name in late if name not in published.OURS]
    after = ""
    if REFERENCE in late and others:
        first = min(others, key=late.get)
        after = f"; at 1 s SSMR makes {_mm(late[REFERENCE])}, the best baseline ({first}) {_mm(late[first])}"
    listed = [f"{name} {_mm(error[name])}" for name in paper.methods if name in error]
    return Verdict(_rank(holds, error[REFERENCE] < printed[REFERENCE]), (
        f"Over 50 ms {worst} ({_mm(error[worst])}) is {'below' if holds else 'not below'} {best} ({_mm(error[best])}), "
        f"n = {starts} starts: {', '.join(listed)}, where the paper has SSMR {_mm(printed[REFERENCE])}, "
        f"DMD {_mm(printed['DMD'])}, EDMD {_mm(printed['EDMD'])}{after}."))


def _tracking(figure: str, results: Results) -> Verdict:
    """Whether SSMR (on the emulated bench SSMR and SSSR) track with a lower mean ISE than the others in every task."""
    paper, leaders = published.FIGURES[figure], ("SSMR", "SSSR") if figure == "fig11" else ("SSMR",)
    said, holds, printed = [], [], []
    for (robot, task), methods in loops(figure, results.runs).items():
        means = {name: tally(runs) for name, runs in methods.items()}
        ise = {name: means[name].ise for name in means if name in paper.methods}
        rest = [name for name in ise if name not in leaders]
        if any(name not in ise for name in leaders) or set(rest) <= set(published.OURS):
            continue
        holds.append(max(ise[name] for name in leaders) < min(ise[name] for name in rest))
        known = [row[REFERENCE] for (at, name), row in published.TRACKING.items() if at == robot and name in task]
        printed += [means[REFERENCE].rmse < value for value in known]
        rmse = "".join(f", RMSE {_mm(means[REFERENCE].rmse)} (published about {_mm(value)})" for value in known)
        said.append(f"{task}: {_factors(means, paper.methods)}{rmse}")
    if not holds:
        return _missing(f"runs.csv has no task of {figure} with {' and '.join(leaders)} and a baseline")
    return Verdict(_rank(all(holds), bool(printed) and all(printed)), (
        f"{' and '.join(leaders)} {'has' if len(leaders) == 1 else 'have'} the lowest mean ISE in {sum(holds)} of "
        f"{len(holds)} tasks ({'; '.join(said)})."))


def _pareto(figure: str, results: Results) -> Verdict:
    said, holds, solve, late = [], [], {}, set()
    for (robot, task), methods in loops(figure, results.runs).items():
        means = {name: tally(runs) for name, runs in methods.items()}
        own = {name: (mean.load, mean.ise) for name, mean in means.items()
               if name in published.FIGURES[figure].methods}
        if REFERENCE not in own or "SSSR" not in own or len(own) < 3:
            continue
        front = pareto_front(own)
        holds.append({REFERENCE, "SSSR"} <= front)
        late |= {name for name, mean in means.items() if mean.load_p99 > 1}
        solve.setdefault(robot, []).append(means[REFERENCE].load * methods[REFERENCE][0].period)
        said.append(f"{robot}, {task}: {', '.join(name for name in own if name in front)}")
    if not holds:
        return _missing("runs.csv has no task of fig6, fig7 or fig8 with SSMR, SSSR and a baseline")
    slow = f"; more than 1 % of the programs take longer than a period with {', '.join(sorted(late))}" if late else \
        "; no method takes longer than a period for more than 1 % of its programs"
    known = {robot: published.SOLVE_TIME.get(robot, {}).get(REFERENCE, 0.0) for robot in solve}
    times = ", ".join(f"{robot} {MS * max(solve[robot]):.3g} ms (published about {MS * known[robot]:.3g} ms)"
                      for robot in solve)
    return Verdict(_rank(all(holds), all(max(solve[robot]) < known[robot] for robot in solve)), (
        f"SSMR and SSSR are both on the front of the paper's methods in {sum(holds)} of {len(holds)} tasks "
        f"({'; '.join(said)}); SSMR's median solve time is at most {times}{slow}."))


def _obstacles(figure: str, results: Results) -> Verdict:
    """The first task that can be judged is the paper's; what SSMR does in further ones is told."""
    paper = published.FIGURES[figure]
    places = {task: {name: tally(runs) for name, runs in methods.items()}
              for (_, task), methods in loops(figure, results.runs).items()}
    for task, means in places.items():
        own = {name: mean for name, mean in means.items() if name in paper.methods}
        if REFERENCE not in own or set(own) <= set(published.OURS):
            continue
        checks = {"ISE": ("ise", MM ** 2, "mm²"), "time inside": ("violation_ratio", PERCENT, "%"),
                  "depth": ("max_violation", MM, "mm")}
        said, holds = [], []
        for what, (column, factor, unit) in checks.items():
            value = {name: getattr(mean, column) for name, mean in own.items()}
            best = min((name for name in value if name != REFERENCE), key=value.get)
            holds.append(value[REFERENCE] < value[best] or value[REFERENCE] == value[best] == 0)
            said.append(f"{what} {factor * value[REFERENCE]:.3g} {unit} against {factor * value[best]:.3g} {unit} of "
                        f"{best}, the best other")
        return Verdict(_rank(all(holds), False), (
            f"{task}, means over {_counts(own)}: SSMR is lowest in {sum(holds)} of 3 ({'; '.join(said)})"
            f"{_beyond(means, paper.methods)}{_further_tasks(places, task)}."))
    return _missing(f"runs.csv has no task of {figure} with SSMR and a baseline")


def _further_tasks(places: Mapping[str, Mapping[str, Tally]], judged: str) -> str:
    further = {task: means[REFERENCE] for task, means in places.items() if task != judged and REFERENCE in means}
    return "".join(f"; {task}, n = {mean.n}: ISE of SSMR {MM ** 2 * mean.ise:.3g} mm², time inside "
                   f"{PERCENT * mean.violation_ratio:.3g} %, depth {MM * mean.max_violation:.3g} mm"
                   for task, mean in further.items())


def _setup(figure: str, results: Results) -> Verdict:
    return Verdict("not judged", "The figure shows a setup and claims nothing.")


JUDGES: Mapping[str, Callable[[str, Results], Verdict]] = {
    "table1": _table1, "fig3": _delays, "fig4": _open_loop, "fig5": _open_loop, "fig6": _tracking, "fig7": _tracking,
    "fig8": _pareto, "fig9": _obstacles, "fig10": _setup, "fig11": _tracking, "fig12": _obstacles}


def _rank(holds: bool, surpassed: bool) -> str:
    return "refuted" if not holds else "better" if surpassed else "reproduced"


def _missing(what: str) -> Verdict:
    return Verdict("not judged", f"Data are missing: {what}.")


def _factors(means: Mapping[str, Tally], methods: Sequence[str]) -> str:
    """ISE of SSMR, of the best baseline and of SSSR over it, and what a further method does."""
    own, reference = {name: mean for name, mean in means.items() if name in methods}, means[REFERENCE].ise
    best = min((name for name in own if name not in published.OURS), key=lambda name: own[name].ise)
    sssr = f", SSSR {_times(own['SSSR'].ise, reference)}" if "SSSR" in own else ""
    return (f"SSMR {MM ** 2 * reference:.3g} mm², the best baseline {best} {_times(own[best].ise, reference)}{sssr}, "
            f"{_counts(own)}{_beyond(means, methods)}")


def _beyond(means: Mapping[str, Tally], methods: Sequence[str]) -> str:
    """The best of the methods that the paper does not have here."""
    further = [name for name in means if name not in methods]
    if not further:
        return ""
    best = min(further, key=lambda name: means[name].ise)
    return f", beyond the paper {best} {_times(means[best].ise, means[REFERENCE].ise)} the ISE of SSMR"


def _times(value: float, reference: float) -> str:
    return f"{value / reference:.3g} times" if math.isfinite(value) and math.isfinite(reference) else "∞ (a run failed)"


def _counts(means: Mapping[str, Tally]) -> str:
    counts = sorted({mean.n for mean in means.values()})
    return f"n = {counts[0]}" + (f" to {counts[-1]}" if len(counts) > 1 else "") + f" run{'s' * (counts[-1] > 1)} each"


def _mean(parts: Mapping[str, Mapping], label: str) -> float:
    """m; infinite where a rollout diverged."""
    mean = parts.get(label, {}).get("mean")
    return math.inf if mean is None else mean


def _mm(value: float) -> str:
    return f"{MM * value:.3g} mm" if math.isfinite(value) else "∞"
