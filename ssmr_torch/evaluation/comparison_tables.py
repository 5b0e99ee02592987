"""Tables that compare models: prediction errors by horizon, ties, and the cost of each model."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np

from ssmr_torch.evaluation.bootstrap import Interval, difference_intervals, rank
from ssmr_torch.evaluation.horizon_scores import HorizonScore, OpenLoopScore
from ssmr_torch.evaluation.run_groups import GroupedScores

BEST, TIED = "*", "="
LEGEND = (f"{BEST}: lowest mean of the column; {TIED}: tie, because the 95 % interval of the difference contains zero "
          "(paired bootstrap over blocks of a second or a horizon)")
CELLS = "mean / median RMSE in mm"
SHARES = "in brackets NMTE, mean error / largest norm of the run"


def marks(scores: Mapping[str, OpenLoopScore]) -> dict[str, dict[str, str]]:
    """Mark for each model and horizon: "*" for the lowest mean, "=" for a tie with it, otherwise "".

    They come from the paired block bootstrap of `bootstrap.rank`. A horizon with too few blocks of starts has no marks,
    for example full rollouts of few runs. Raises ValueError if the models were not scored from the same starts.
    """
    refuse_other_starts(scores)
    found: dict[str, dict[str, str]] = {name: {} for name in scores}
    for parts in zip(*(score.horizons for score in scores.values())):
        best, tied = None, np.zeros(len(parts), dtype=bool)
        if parts[0].blocks is not None:
            best, tied = rank(np.stack([part.errors for part in parts]), parts[0].blocks)
        for number, (name, part) in enumerate(zip(scores, parts)):
            found[name][part.label] = BEST if number == best else TIED if tied[number] else ""
    return found


def difference(scores: Mapping[str, OpenLoopScore], model: str, other: str, label: str) -> Interval:
    """Mean error of one model minus that of another over a horizon, m, with its paired 95 % interval."""
    refuse_other_starts(scores)
    parts = [scores[name][label] for name in (other, model)]
    if parts[0].blocks is None:
        raise ValueError(f"the scores over {label} do not name their starts; compute them with compare_open_loop")
    return difference_intervals(np.stack([part.errors for part in parts]), parts[0].blocks, 0)[1]


def table_rows(scores: Mapping[str, OpenLoopScore], cell: Callable[[HorizonScore], str]) -> list[list[str]]:
    """Rows of name, then cell and mark by horizon: one row per model, and a second one for its score with noise.
    """
    noisy = {name: score.noisy for name, score in scores.items() if score.noisy is not None}
    marked, noisily = marks(scores), marks(noisy) if noisy else {}
    rows = []
    for name, score in scores.items():
        rows.append(_row(name, score, marked[name], cell))
        if name in noisy:
            title = f"{name}, noise {1e3 * noisy[name].noise:.3g} mm"
            rows.append(_row(title, noisy[name], noisily[name], cell))
    return rows


def comparison_table(scores: Mapping[str, OpenLoopScore], costs: Mapping[str, Mapping[str, float]]) -> str:
    """Markdown table: mean / median error in mm and NMTE per horizon with the marks of `marks`, share of diverged
    rollouts over all horizons, state dimension, parameters, and fit time in CPU seconds. A mean is ∞ if a rollout
    diverged.

    costs: from `training.cost_of`; empty if unknown.
    """
    labels = [part.label for part in next(iter(scores.values())).horizons]
    header = ["model", *labels, "diverged", "n", "parameters", "fit (CPU)"]
    lines = [" | ".join(header), " | ".join(["---"] * len(header))]
    every = [each for score in scores.values() for each in (score, score.noisy) if each is not None]
    for row, score in zip(table_rows(scores, mean_and_median), every):
        cost = costs.get(row[0], {})
        worst = max(part.diverged for part in score.horizons)
        lines.append(" | ".join([*row, f"{100 * worst:.3g} %",
                                 *(_number(cost.get(key)) for key in ("state_dim", "parameters")),
                                 f"{cost['fit_time']:.3g} s" if cost.get("fit_time") else "–"]))
    return "\n".join(f"| {line} |" for line in lines)


def format_table(scores: Mapping[str, OpenLoopScore]) -> str:
    """Text table: mean error in mm and NMTE per model and horizon. If a rollout diverged, the cell shows ∞, the share
    of diverged rollouts, and the mean of the others.

    Raises ValueError if the models were not scored over the same horizons from the same starts.
    """
    first = next(iter(scores.values()))
    rows = [["model", *(part.label for part in first.horizons)], *table_rows(scores, _mean_and_survivors)]
    widths = [max(map(len, column)) for column in zip(*rows)]
    lines = ["  ".join(cell.rjust(width) if column else cell.ljust(width)
                       for column, (cell, width) in enumerate(zip(row, widths))) for row in rows]
    note = (f"mean RMSE in mm over n = {starts_of(first)} starts, one training per model, {SHARES};\n"
            f"∞: some rollouts diverged (their share, mean of the others); {LEGEND}")
    return "\n".join([lines[0], "-" * len(lines[0]), *lines[1:], note])


def format_groups(found: GroupedScores) -> str:
    """Text: the table of each group of runs, and the kinds of runs that were left out. A single group has no title."""
    if len(found.groups) <= 1:
        return format_table(found.scores)
    parts = [f"{name}, {found.sizes[name]} {'run' if found.sizes[name] == 1 else 'runs'}\n{format_table(scores)}"
             for name, scores in found.groups.items()]
    return "\n\n".join([*parts, *(f"{kind} runs are too short for any horizon" for kind in found.left_out)])


def stored(found: GroupedScores) -> dict:
    """Plain JSON values of all scores and of each group's, with the marks of `marks`."""
    def plain(scores: Mapping[str, OpenLoopScore]) -> dict:
        noisy = {name: score.noisy for name, score in scores.items() if score.noisy is not None}
        found = {name: score.as_dict() | {"marks": marked} for (name, score), marked in zip(
            scores.items(), marks(scores).values())}
        for name, marked in marks(noisy).items() if noisy else ():
            found[name]["noisy"]["marks"] = marked
        return found

    return {"scores": plain(found.scores), "groups": {name: plain(each) for name, each in found.groups.items()},
            "runs": dict(found.sizes)}


def refuse_other_starts(scores: Mapping[str, OpenLoopScore]) -> None:
    """Raises ValueError if the models were not scored over the same horizons from the same starts."""
    first = next(iter(scores.values()))
    for name, score in scores.items():
        if _setting(score) != _setting(first):
            raise ValueError(f"{name!r} was scored with {_setting(score)}, but the first model with "
                             f"{_setting(first)} (horizons and starts, margin, seed, outputs, noise); "
                             "score both with compare_open_loop")


def starts_of(score: OpenLoopScore) -> str:
    """"500 (50 ms), 2 (full)": starts per horizon."""
    return ", ".join(f"{len(part.errors)} ({part.label})" for part in score.horizons)


def mean_and_median(part: HorizonScore) -> str:
    """"mean / median [NMTE %]" of one horizon in mm, three digits."""
    return f"{_millimetres(part.mean)} / {_millimetres(part.median)}{_share(part)}"


def _mean_and_survivors(part: HorizonScore) -> str:
    if part.diverged == 0:
        return f"{1e3 * part.mean:.3g}{_share(part)}"
    survivors = "" if part.diverged == 1 else f", {1e3 * part.mean_of_survivors:.3g}"
    return f"∞ ({100 * part.diverged:.3g} %{survivors})"


def _row(name: str, score: OpenLoopScore, marked: Mapping[str, str], cell: Callable[[HorizonScore], str]) -> list[str]:
    return [name, *(f"{cell(part)} {marked[part.label]}".rstrip() for part in score.horizons)]


def _share(part: HorizonScore) -> str:
    if part.nmte is None or not math.isfinite(part.nmte):
        return ""
    percent = 100 * part.nmte
    return f" [{percent:.2g} %]" if percent < 10 else f" [{percent:.0f} %]"


def _setting(score: OpenLoopScore) -> tuple:
    horizons = [(part.label, len(part.errors)) for part in score.horizons]
    return horizons, score.margin, score.seed, score.outputs, score.noise


def _millimetres(value: float) -> str:
    return f"{1e3 * value:.3g}" if math.isfinite(value) else "∞"


def _number(value: float | None) -> str:
    return "–" if not value else f"{value:.0f}"
