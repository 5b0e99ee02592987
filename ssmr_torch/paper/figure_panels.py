"""Panels of the paper's figures: their grid, titles, axis labels and plain numbers on logarithmic axes."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ssmr_torch.evaluation import figures
from ssmr_torch.evaluation.figures import WIDTH

COLUMNS = 4
LONGEST = 16  # letters of a name that fit above a panel


def title(axes, name: str, note: str | None = None) -> None:
    """The method in its colour, and what is to say of it below."""
    lines = name.replace(" ", "\n", 1) if len(name) > LONGEST else name
    axes.set_title(f"{lines}\n" if note else lines, color=figures.colours([name])[name])
    if note:
        axes.annotate(note, (0.5, 1.0), (0, 4), "axes fraction", "offset points", ha="center", va="bottom", fontsize=7)


def tiles(count: int, height: float, columns: int = COLUMNS, **options):
    """A figure of the paper's width with `count` panels of that height in rows, and the panels; none is left over."""
    rows = math.ceil(count / columns)
    columns = math.ceil(count / rows)  # as many in each row, as nearly as it goes
    width = WIDTH * (1.0 if columns > 2 else 0.35 + 0.3 * columns)
    figure, grid = figures.panels(width, 0.45 + height * rows, rows, columns, squeeze=False, **options)
    figure.set_layout_engine("compressed")  # knows that panels of equal scales do not fill their places
    for axes in grid.flat[count:]:
        axes.remove()
    return figure, list(grid.flat[:count])


def name_axes(figure, grid: Sequence, across: str, upwards: str) -> None:
    """Labels at the outer panels only; the lowest panel of each column has its ticks."""
    places = [axes.get_subplotspec() for axes in grid]
    lowest = {place.colspan.start: place.rowspan.start for place in places}
    for axes, place in zip(grid, places):
        if lowest[place.colspan.start] == place.rowspan.start:
            axes.set_xlabel(across)
            axes.tick_params(labelbottom=True)
        if place.is_first_col():
            axes.set_ylabel(upwards)
    figure.align_labels(grid)


def plain_ticks(axis, low: float, high: float) -> None:
    """Plain numbers on a logarithmic axis: decades, every second or third of many; with two 1, 3; else 1, 2, 5."""
    decades = 10.0 ** np.arange(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    decades = decades[(decades >= low * (1 - 1e-9)) & (decades <= high * (1 + 1e-9))]
    ticks = decades[::math.ceil(len(decades) / 5)] if len(decades) else decades
    if len(decades) < 3:
        ticks = [float(f"{tick:.1g}") for decade in range(math.floor(math.log10(low)), math.ceil(math.log10(high)))
                 for tick in np.array([1.0, 3.0] if len(decades) == 2 else [1.0, 2.0, 5.0]) * 10.0 ** decade]
        ticks = [tick for tick in ticks if low <= tick <= high]
    if len(ticks) < 2:
        ticks = [float(f"{tick:.2g}") for tick in np.geomspace(low, high, 5)[1:-1]]
    axis.set_ticks(ticks, [_tick(tick, max(ticks)) for tick in ticks])
    axis.set_ticks([], minor=True)


def _tick(value: float, largest: float) -> str:
    """Powers of ten where plain numbers would not fit beside one another."""
    exponent = math.log10(value)
    return f"$10^{{{exponent:.0f}}}$" if largest > 1e4 and exponent == round(exponent) else f"{value:g}"


def plain(value: float) -> str:
    """Three digits or more, never a power of ten for a large number."""
    if not math.isfinite(value):
        return "∞"
    return f"{value:.3g}" if abs(value) < 1000 else f"{value:,.0f}".replace(",", "\u2009")
