"""Figures of sweeps and studies: many trained models at once."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from matplotlib.figure import Figure

from ssmr_torch.evaluation.figures import MM, MS, WIDTH, colours, styled

# column of a result, axis label, factor
COSTS = (("parameters", "parameters", 1.0), ("fit_time", "fit time (s)", 1.0), ("step_time", "step time (ms)", MS),
         ("controlled_samples", "controlled samples", 1.0))


@styled
def ranking(rows: Sequence[Mapping], score: str, label: str) -> Figure:
    """Score of every job of a sweep against what it cost, one panel per kind of cost.

    rows: {"model", score, "parameters", "fit_time", "step_time", "controlled_samples"} of each job; a job without a
    finite score is drawn as a cross at the top. label: of the score's axis.
    """
    figure = Figure(figsize=(WIDTH, 2.3), layout="constrained")
    panels = figure.subplots(1, len(COSTS), sharey=True)
    finite = [row[score] for row in rows if _finite(row.get(score))]
    top = 1.5 * max(finite, default=1.0)
    of = colours(dict.fromkeys(row["model"] for row in rows))
    for axes, (column, name, factor) in zip(panels, COSTS):
        for model, colour in of.items():
            points = [row for row in rows if row["model"] == model and _finite(row.get(column))]
            held = [row for row in points if _finite(row.get(score))]
            lost = [row for row in points if not _finite(row.get(score))]
            axes.scatter([factor * row[column] for row in held], [row[score] for row in held], s=14, color=colour,
                         label=model, alpha=0.8, linewidths=0)
            axes.scatter([factor * row[column] for row in lost], [top] * len(lost), s=16, color=colour, marker="x")
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_xlabel(name)
    panels[0].set_ylabel(label)
    handles, names = panels[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside upper center", ncols=min(len(names), 6), markerscale=1.4)
    return figure


@styled
def trend(rows: Sequence[Mapping], axis: str, scores: Sequence[tuple[str, str]], label: str) -> Figure:
    """Scores against one varied quantity, a line per model and a panel per score.

    rows: {"model", axis, score…} of each job. scores: (column, title) of each panel, in m. label: of the axis.
    """
    figure = Figure(figsize=(WIDTH, 2.4), layout="constrained")
    panels = figure.subplots(1, len(scores), squeeze=False)[0]
    of = colours(dict.fromkeys(row["model"] for row in rows))
    for axes, (column, title) in zip(panels, scores):
        for model, colour in of.items():
            line = sorted((row[axis], row.get(column)) for row in rows if row["model"] == model)
            kept = [(x, MM * y) for x, y in line if _finite(y)]
            axes.plot([x for x, _ in kept], [y for _, y in kept], "o-", color=colour, label=model, markersize=3)
        axes.set_yscale("log")
        axes.set_title(title)
        axes.set_xlabel(label)
    panels[0].set_ylabel("RMSE (mm)")
    handles, names = panels[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside upper center", ncols=min(len(names), 6))
    return figure


@styled
def reconstruction(rows: Sequence[Mapping]) -> Figure:
    """The delay study: ratio of norms (what the paper shows) beside the error, with and without reparametrization.

    rows: {"delays", "reparametrized", "ratio", "error"}, ratio and error in %.
    """
    figure = Figure(figsize=(0.7 * WIDTH, 2.3), layout="constrained")
    panels = figure.subplots(1, 2)
    for reparametrized, colour, name in ((False, "#D55E00", "own delays"), (True, "#0072B2", "reparametrized")):
        chosen = sorted((row["delays"], row["ratio"], row["error"]) for row in rows
                        if row["reparametrized"] == reparametrized)
        for axes, column in zip(panels, (1, 2)):
            axes.plot([row[0] for row in chosen], [row[column] for row in chosen], "o-", color=colour, label=name,
                      markersize=3)
            axes.set_xlabel("delays")
    panels[0].axhline(100, color="#999999", linewidth=0.8, linestyle="--")
    panels[0].set_ylabel("‖ŷ‖ / ‖y‖ (%)")
    panels[1].set_ylabel("‖ŷ − y‖ / ‖y‖ (%)")
    panels[1].legend()
    return figure


def _finite(value) -> bool:
    return isinstance(value, (int, float)) and math.isfinite(value)
