"""Figures of sweeps and studies: many trained models at once."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, NullFormatter, NullLocator, StrMethodFormatter

from ssmr_torch.evaluation.figures import METHODS, MM, MS, SPARE_COLOURS, WIDTH, look, panels, styled

# column of a result, axis label, factor
COSTS = (("parameters", "parameters (–)", 1.0), ("fit_time", "fit (CPU s)", 1.0), ("step_time", "step time (ms)", MS),
         ("controlled_samples", "controlled samples (–)", 1.0))
SCORES = ("50 ms", "200 ms", "1 s")
MARKERS = "osD^vPX<>p"
LOST = {"marker": "x", "linestyle": "none", "markersize": 6, "markeredgewidth": 1.4, "clip_on": False}


def looks(models: Iterable[str]) -> dict[str, tuple[str, str]]:
    """Colour and marker of each model, any number of them: its own colour of `METHODS` or a spare one; colours come
    round again with another marker.
    """
    found, spare = {}, 0
    for number, model in enumerate(dict.fromkeys(models)):
        colour, _ = look(model) or (None, "")
        if colour is None:
            colour, spare = SPARE_COLOURS[spare % len(SPARE_COLOURS)], spare + 1
        found[model] = colour, MARKERS[number % len(MARKERS)]
    return found


@styled
def ranking(rows: Sequence[Mapping], score: str) -> Figure:
    """Score of every job of a sweep against what it cost, one panel per kind of cost; all axes are logarithmic.

    rows: {"model", score, "parameters", "fit_time", "step_time", "controlled_samples"} of each job; one whose score is
    missing or infinite is a cross at the upper edge. score: an error in m where it is called rmse, a ratio otherwise.
    The best job of each model is drawn larger.
    """
    figure, grid = panels(WIDTH, 2.6, 1, len(COSTS), sharey=True)
    factor, unit = (MM, "mm") if "rmse" in score else (1.0, "–")
    known = [row for row in rows if any(_shown(row.get(column)) for column, _, _ in COSTS)]
    lost = [row for row in known if not _shown(row.get(score))]
    for model, (colour, marker) in looks(row["model"] for row in known).items():
        points = sorted((row for row in known if row["model"] == model and _shown(row.get(score))),
                        key=lambda row: row[score])
        for axes, (column, _, scale) in zip(grid, COSTS):
            there = [row for row in points if _shown(row.get(column))]
            x, y = [scale * row[column] for row in there], [factor * row[score] for row in there]
            axes.plot(x, y, marker, color=colour, markersize=3, alpha=0.6, markeredgewidth=0)
            axes.plot(x[:1], y[:1], marker, color=colour, markersize=6, label=model)
            _cross_out(axes, [scale * row[column] for row in lost
                              if row["model"] == model and _shown(row.get(column))], colour)
    some = any(_shown(row.get(score)) for row in known)
    for axes, (column, label, _) in zip(grid, COSTS):
        axes.set_xlabel(label)
        _logarithmic(axes, "x", any(_shown(row.get(column)) for row in known))
        _logarithmic(axes, "y", some)
    grid[0].set_ylabel(f"{score.replace('_', ', ')} ({unit})")
    _legend(figure, grid[0], bool(lost))
    return figure


@styled
def trend(rows: Sequence[Mapping], axis: str, label: str, scale: float = 1.0) -> Figure:
    """Scores (mm, logarithmic) over one varied quantity: a line per model, a panel per horizon.

    rows: {"model", axis, "50 ms", "200 ms", "1 s"} of each point, scores in m; a missing or infinite one is a cross at
    the upper edge. Several points of one model at one value are drawn as their median and the band that they span.
    label: of the axis, on which `scale` times the quantity is drawn.
    """
    figure, grid = panels(WIDTH, 2.6, 1, len(SCORES))
    values = sorted({row[axis] for row in rows})
    anything_lost = False
    for model, (colour, marker) in looks(row["model"] for row in rows).items():
        baseline = model in ("persistence", "constant velocity")
        for axes, score in zip(grid, SCORES):
            at = {scale * value: [row[score] if _shown(row.get(score)) else math.inf for row in rows
                                  if row["model"] == model and row[axis] == value] for value in values}
            at = {value: MM * np.array(found) for value, found in at.items() if found}
            middle = np.array([np.median(found) for found in at.values()])
            axes.plot(list(at), np.where(np.isfinite(middle), middle, np.nan), color=colour, label=model, markersize=4,
                      marker="" if baseline else marker, linestyle="--" if baseline else "-")
            low, high = (np.array([bound(found) for found in at.values()]) for bound in (np.min, np.max))
            axes.fill_between(list(at), low, np.where(np.isfinite(high), high, np.nan), color=colour, alpha=0.15,
                              linewidth=0)
            lost = [value for value, found in at.items() if np.isinf(found).any()]
            _cross_out(axes, lost, colour)
            anything_lost |= bool(lost)
    for axes, score in zip(grid, SCORES):
        axes.set(title=score, xlabel=label)
        _spread(axes, scale * np.array(values))
        _logarithmic(axes, "y", any(_shown(row.get(score)) for row in rows))
    grid[0].set_ylabel("mean RMSE (mm)")
    _legend(figure, grid[0], anything_lost)
    return figure


@styled
def reconstruction(rows: Sequence[Mapping], measured: np.ndarray, output_names: Sequence[str]) -> Figure:
    """The delay study: ratio of norms (what the paper shows), the error beside it, and the path of the longest window.

    rows: of `reconstruction_study`. measured: (T, p) m; its first two outputs span the plane of the path.
    """
    figure, grid = panels(WIDTH, 2.7, 1, 3)
    newest = MM * np.asarray(measured)[-len(rows[0]["outputs"]):, :2]
    grid[2].plot(*newest.T, color=METHODS["measured"][0], linewidth=2.2, alpha=0.35, label="measured")
    for reparametrized, colour, marker, name in ((False, METHODS["EDMD"][0], "s", "own delays"),
                                                 (True, METHODS["SSMR"][0], "o", "reparametrized")):
        chosen = sorted((row for row in rows if row["reparametrized"] == reparametrized), key=lambda row: row["delays"])
        for axes, column in zip(grid, ("ratio", "error")):
            axes.plot([row["delays"] for row in chosen], [row[column] for row in chosen], marker, color=colour,
                      markersize=4, linestyle="-")
        if chosen:
            grid[2].plot(*MM * chosen[-1]["outputs"][:, :2].T, color=colour, linewidth=1.0, label=name)
            grid[2].set_title(f"{chosen[-1]['delays']} delays", fontweight="normal")
    for axes, label in zip(grid, ("reconstruction ‖ŷ‖ / ‖y‖ (%)", "error ‖ŷ − y‖ / ‖y‖ (%)")):
        axes.set(xlabel="delays (–)", ylabel=label, xticks=sorted({row["delays"] for row in rows}))
        axes.set_ylim(bottom=0.0)
    grid[0].axhline(100, color="#666666", linewidth=0.8, linestyle="--")
    middle, half = 0.5 * (newest.max() + newest.min()), 0.5 * np.ptp(newest)
    farthest = max(float(np.abs(line.get_xydata() - middle).max()) for line in grid[2].lines)
    half = 1.1 * min(farthest, 2.0 * half)  # what is farther off leaves the panel
    limits = (middle - half, middle + half)
    grid[2].set(xlabel=f"{output_names[0]} (mm)", ylabel=f"{output_names[1]} (mm)", xlim=limits, ylim=limits,
                aspect="equal")
    _legend(figure, grid[2], False)
    return figure


def _cross_out(axes, at: Sequence[float], colour: str) -> None:
    """A cross at the upper edge over each of these."""
    if at:
        axes.plot(at, [1.0] * len(at), color=colour, transform=axes.get_xaxis_transform(), **LOST)


def _spread(axes, values: np.ndarray) -> None:
    """Logarithmic where the values span a decade, linear below the smallest where one is zero; a tick at every value
    where they lie far enough apart.
    """
    positive = values[values > 0]
    if len(positive) and positive.max() >= 7.9 * positive.min():
        axes.set_xscale("log") if values.min() > 0 else axes.set_xscale("symlog", linthresh=positive.min())
    transform = axes.xaxis.get_transform()
    at = transform.transform(values)
    room = 0.06 * np.ptp(at)
    if room > 0:
        axes.set_xlim(transform.inverted().transform(np.array([at[0] - room, at[-1] + room])))
    if len(at) == 1 or np.diff(at).min() > 2 * room:
        axes.set_xticks(values, [f"{value:.2g}" for value in values])
        axes.xaxis.set_minor_formatter(NullFormatter())


def _logarithmic(axes, which: str, anything: bool) -> None:
    """A logarithmic axis with few ticks; without anything to show, one without ticks."""
    axis = getattr(axes, f"{which}axis")
    if not anything:
        axis.set_major_locator(NullLocator())
        return
    axes.set(**{f"{which}scale": "log"})
    _sparse(axis, *axis.get_view_interval())


def _sparse(axis, low: float, high: float) -> None:
    """Two ticks or more with plain numbers on a logarithmic axis: decades, else 1, 2, 5, else three in between."""
    decades = 10.0 ** np.arange(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    for steps in ((1.0,), (1.0, 2.0, 5.0)):
        ticks = [tick for tick in np.outer(decades, steps).ravel() if low <= tick <= high]
        if len(ticks) >= 2:
            break
    else:
        ticks = [float(f"{tick:.2g}") for tick in np.geomspace(low, high, 5)[1:-1]]
    axis.set_major_locator(FixedLocator(ticks))
    axis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axis.set_minor_formatter(NullFormatter())


def _legend(figure: Figure, axes, lost: bool) -> None:
    handles, labels = axes.get_legend_handles_labels()
    if lost:
        handles.append(Line2D([], [], color="#333333", **LOST))
        labels.append("some or all diverge")
    if not labels:
        return
    rows = math.ceil(len(labels) * 1.25 / figure.get_figwidth())
    figure.legend(handles, labels, loc="outside upper center", ncols=math.ceil(len(labels) / rows))


def _shown(value) -> bool:
    """Whether a logarithmic axis has a place for it."""
    return isinstance(value, (int, float)) and math.isfinite(value) and value > 0
