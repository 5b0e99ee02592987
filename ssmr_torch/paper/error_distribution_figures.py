"""Distributions of errors by method, as box plots (paper, Fig. 4 and 5). SI in, mm drawn."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ssmr_torch.evaluation import figures
from ssmr_torch.evaluation.figures import MM, WIDTH, styled
from ssmr_torch.paper.figure_panels import plain, plain_ticks

BAD = "#CC3311"


@styled
def error_boxes(errors: Mapping[str, np.ndarray]) -> figures.Figure:
    """Errors (mm, logarithmic) of each method as a box: quartiles, whiskers within 1.5 of their distance, outliers.

    The median stands beside each, and the share of starts that diverged: these count as infinite in the quartiles.
    errors: name → (S,) m, infinite where a start diverged.
    """
    names = list(errors)
    figure, axes = figures.panels(WIDTH, 0.75 + 0.3 * len(names))
    lost = {name: float(np.isinf(errors[name]).mean()) for name in names}
    boxes(axes, {name: MM * np.asarray(errors[name], dtype=np.float64) for name in names})
    for number, name in enumerate(names):
        median = MM * float(np.median(errors[name]))
        share = f", {100 * lost[name]:.2g} % diverged" if lost[name] else ""
        beside(axes, number, f"{plain(median)} mm{share}")
    axes.set_title("median", fontweight="normal", fontsize=7, x=1.02, ha="left")
    axes.set_xlabel("RMSE over 50 ms (mm)")
    return figure


def boxes(axes, values: Mapping[str, np.ndarray], points: bool = False) -> None:
    """Horizontal boxes, the first method at the top, on a logarithmic axis; the single values on demand.

    Infinite values count in the quartiles; they stand at the largest finite value as one cross.
    """
    names, palette = list(values), figures.colours(values)
    finite = np.concatenate([value[np.isfinite(value) & (value > 0)] for value in values.values()])
    ceiling = finite.max(initial=0.0) or 1.0
    floor = finite.min(initial=ceiling)
    drawn = axes.boxplot([np.clip(values[name], floor, ceiling) for name in names], orientation="horizontal",
                         positions=range(len(names)), widths=0.55, patch_artist=True, showfliers=not points,
                         medianprops={"color": "black"},
                         flierprops={"marker": ".", "markersize": 2.5, "markeredgewidth": 0, "rasterized": True})
    for index, (name, box) in enumerate(zip(names, drawn["boxes"])):
        box.set(facecolor=palette[name], alpha=0.85, linewidth=0.7)
        if np.isinf(values[name]).any():
            axes.plot(ceiling, index, "x", color=BAD, markersize=5, markeredgewidth=1.2, zorder=4)
        if points:
            scatter_runs(axes, np.clip(values[name], floor, ceiling), index)
        else:
            drawn["fliers"][index].set(markerfacecolor=palette[name])
    axes.set(xscale="log", ylim=(len(names) - 0.45, -0.55))
    room = max((ceiling / floor) ** 0.06, 1.15)
    axes.set_xlim(floor / room, ceiling * room)
    axes.set_yticks(range(len(names)), names)
    axes.grid(False, axis="y")
    plain_ticks(axes.xaxis, *axes.get_xlim())


def scatter_runs(axes, values: np.ndarray, row: float) -> None:
    """Single runs as dots on a row, spread a little so that equal ones are seen."""
    spread = row + 0.14 * np.sin(2.4 * np.arange(len(values)))
    axes.plot(values, spread, ".", color="#333333", markersize=3, markeredgewidth=0, alpha=0.7, zorder=3,
              rasterized=len(values) > 20)


def beside(axes, row: float, text: str) -> None:
    """A text at the right edge of the axes, level with a row."""
    axes.annotate(text, (1.02, row), xycoords=axes.get_yaxis_transform(), va="center", fontsize=7,
                  annotation_clip=False)
