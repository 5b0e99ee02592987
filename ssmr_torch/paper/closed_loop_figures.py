"""Figures in the paper's kinds about closed loops: relative ISE, Pareto fronts, runs among obstacles. SI in."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from ssmr_torch.evaluation import figures
from ssmr_torch.evaluation.bootstrap import mean_interval
from ssmr_torch.evaluation.figures import MM, WIDTH, styled
from ssmr_torch.evaluation.metrics import relative_ise
from ssmr_torch.paper.error_distribution_figures import BAD, beside, boxes, scatter_runs
from ssmr_torch.paper.figure_panels import name_axes, plain, plain_ticks, tiles
from ssmr_torch.paper.path_figures import draw_paths

REFERENCE = "SSMR"
STATISTICS = (("ise", "ISE (mm²)", MM ** 2), ("violation_ratio", "time inside obstacles (%)", 100.0),
              ("max_violation", "largest depth (mm)", MM))


@styled
def relative_ise_bars(ise: Mapping[str, Mapping[str, Sequence[float]]]) -> figures.Figure:
    """(ISE / mean ISE of SSMR − 1) · 100 %, a panel per task: mean of each method as a bar with its bootstrap 95 %
    interval (a single run has none), the single runs as dots, the mean in print; a failed run is said to be one.

    ise: task → method → m² of each run, infinite where it failed. A task without SSMR raises ValueError.
    """
    tall = max(len(methods) for methods in ise.values())
    figure, grid = figures.panels(WIDTH, 0.7 + 0.27 * tall, 1, len(ise), squeeze=False)
    for axes, (task, methods) in zip(grid[0], ise.items()):
        if not len(methods.get(REFERENCE, ())):
            raise ValueError(f"no run of {REFERENCE} in the task {task!r}, only of {list(methods)}; the ISE is "
                             "relative to it")
        relative = {name: np.array([relative_ise(value, methods[REFERENCE]) if math.isfinite(value) else math.inf
                                    for value in values]) for name, values in methods.items()}
        _draw_bars(axes, relative)
        axes.set(title=task, xlabel=f"ISE relative to {REFERENCE} (%)")
        if list(methods) == list(next(iter(ise.values()))) and axes is not grid[0, 0]:
            axes.set_yticklabels([])
    return figure


@styled
def pareto(tasks: Mapping[str, Sequence[Mapping]]) -> figures.Figure:
    """ISE (mm²) over solve time / control period, both logarithmic, a panel per task: a point per method, with a line
    from the median to the 99th percentile; what no other beats in both is ringed and joined; right of 1 is too late.

    tasks: task → {"method", "ise" m², "load" median / period, "load_p99", "front": whether nothing beats it in both}.
    """
    figure, grid = tiles(len(tasks), 2.1, columns=2 if len(tasks) in (2, 4) else 3)
    methods = list(dict.fromkeys(point["method"] for points in tasks.values() for point in points))
    palette, markers = figures.colours(methods), dict(zip(methods, "osD^vPX<>p" * len(methods)))
    for axes, (task, points) in zip(grid, tasks.items()):
        points = [point for point in points if math.isfinite(point["ise"])]
        front = sorted((point["load"], MM ** 2 * point["ise"]) for point in points if point["front"])
        axes.plot(*np.array(front).reshape(-1, 2).T, color="#888888", linewidth=1.0, zorder=1, drawstyle="steps-post")
        for point in points:
            x, y, colour = point["load"], MM ** 2 * point["ise"], palette[point["method"]]
            axes.plot([x, max(x, point["load_p99"])], [y, y], color=colour, linewidth=0.9)
            axes.plot(x, y, markers[point["method"]], color=colour, markersize=5.5, markeredgewidth=1.1,
                      markeredgecolor="black" if point["front"] else colour, label=point["method"], linestyle="none")
        axes.axvline(1.0, color="black", linestyle="--", linewidth=0.8)
        axes.set(title=task, xscale="log", yscale="log")
        _widen(axes, [value for point in points for value in (point["load"], point["load_p99"], 1.0)],
               [MM ** 2 * point["ise"] for point in points])
    name_axes(figure, grid, "solve time / control period (–)", "ISE (mm²)")
    _legend_of_all(figure, grid, methods)
    return figure


@styled
def obstacle_paths(runs: Mapping[str, Mapping], axis_names: tuple[str, str]) -> figures.Figure:
    """The best run of each method among its obstacles, a panel each (mm); samples inside an obstacle are marked.

    runs: method → {"reference" (T, 2) m, "path" (T, 2) m, "obstacles" (O, 3) m: centre and radius, "note": text}.
    """
    figure, grid = tiles(len(runs), 1.85, sharex=True, sharey=True)
    for axes, (name, run) in zip(grid, runs.items()):
        path, obstacles = MM * np.asarray(run["path"]), MM * np.asarray(run["obstacles"]).reshape(-1, 3)
        for x, y, radius in obstacles:
            axes.add_patch(figures.Circle((x, y), radius, facecolor="#DDDDDD", edgecolor="#999999", linewidth=0.5,
                                          antialiased=False, rasterized=True))
        draw_paths(axes, MM * np.asarray(run["reference"]), [path], name, run.get("note"))
        apart = np.linalg.norm(path[:, None] - obstacles[None, :, :2], axis=-1) - obstacles[:, 2]
        axes.plot(*np.where((apart < 0).any(axis=1, keepdims=True), path, np.nan).T, color=BAD, linewidth=1.5)
    drawn = MM * np.concatenate([np.asarray(run["reference"]) for run in runs.values()])
    around = np.concatenate([np.asarray(run["obstacles"]).reshape(-1, 3) for run in runs.values()])
    reach = MM * np.concatenate([np.abs(around[:, :2]) + around[:, 2:], np.abs(drawn) / MM]).max(axis=0)
    limit = 1.04 * reach.max()
    grid[0].set(xlim=(-limit, limit), ylim=(-limit, limit))
    name_axes(figure, grid, *(f"{name} (mm)" for name in axis_names))
    return figure


@styled
def obstacle_boxes(statistics: Mapping[str, Mapping[str, np.ndarray]]) -> figures.Figure:
    """Boxes over the runs among obstacles: ISE (logarithmic), share of the time inside one, largest depth.

    statistics: method → {"ise" m², "violation_ratio", "max_violation" m: (n,) each}; the median in print.
    """
    figure, grid = figures.panels(WIDTH, 0.75 + 0.3 * len(statistics), 1, len(STATISTICS))
    for column, (axes, (key, label, factor)) in enumerate(zip(grid, STATISTICS)):
        values = {name: factor * np.asarray(found[key], dtype=np.float64) for name, found in statistics.items()}
        boxes(axes, values, points=True) if key == "ise" else _linear_boxes(axes, values)
        for number, value in enumerate(values.values()):
            median = float(np.median(value))
            beside(axes, number, plain(median))
        axes.set_xlabel(label)
        if column:
            axes.set_yticklabels([])
    return figure


def _draw_bars(axes, relative: Mapping[str, np.ndarray]) -> None:
    palette = figures.colours(relative)
    for row, (name, values) in enumerate(relative.items()):
        mean, low, high = mean_interval(values)
        finite = values[np.isfinite(values)]
        if math.isfinite(mean):
            axes.barh(row, mean, 0.6, color=palette[name], alpha=0.85)
        if math.isfinite(low):
            axes.plot([low, high], [row, row], color="black", linewidth=1.0, marker="|", markersize=5, zorder=4)
        scatter_runs(axes, finite, row)
        lost = len(values) - len(finite)
        beside(axes, row, f"{lost} of {len(values)} failed" if lost else f"{_signed(mean)} %")
    everything = np.concatenate([values[np.isfinite(values)] for values in relative.values()])
    if np.abs(everything).max() > 400:
        axes.set_xscale("symlog", linthresh=100)
        ticks = [0, *(10.0 ** power for power in range(2, 12) if 10.0 ** power <= 1.5 * everything.max())]
        axes.set_xticks(ticks, ["0", *(f"$10^{{{math.log10(tick):g}}}$" for tick in ticks[1:])])
        axes.set_xlim(left=min(1.3 * everything.min(), -10))
    axes.axvline(0.0, color="black", linewidth=0.8)
    axes.set_ylim(len(relative) - 0.4, -0.6)
    axes.set_yticks(range(len(relative)), list(relative))
    axes.grid(False, axis="y")


def _signed(percent: float) -> str:
    return "0" if abs(percent) < 1e-9 else ("+" if percent > 0 else "−") + plain(abs(percent))


def _linear_boxes(axes, values: Mapping[str, np.ndarray]) -> None:
    palette = figures.colours(values)
    drawn = axes.boxplot([value[np.isfinite(value)] for value in values.values()], orientation="horizontal",
                         positions=range(len(values)), widths=0.55, patch_artist=True, showfliers=False,
                         medianprops={"color": "black"})
    for row, (box, (name, value)) in enumerate(zip(drawn["boxes"], values.items())):
        box.set(facecolor=palette[name], alpha=0.85, linewidth=0.7)
        scatter_runs(axes, value[np.isfinite(value)], row)
    axes.set_ylim(len(values) - 0.45, -0.55)
    axes.set_yticks(range(len(values)), list(values))
    axes.set_xlim(left=min(0.0, axes.get_xlim()[0]))
    axes.grid(False, axis="y")


def _widen(axes, across: Sequence[float], upwards: Sequence[float]) -> None:
    for axis, values, limit in ((axes.xaxis, across, axes.set_xlim), (axes.yaxis, upwards, axes.set_ylim)):
        low, high = min(values, default=0.1), max(values, default=1.0)
        room = max((high / low) ** 0.1, 1.25)
        limit(low / room, high * room)
        plain_ticks(axis, low / room, high * room)


def _legend_of_all(figure, grid: Sequence, methods: Sequence[str]) -> None:
    found = {label: handle for axes in grid for handle, label in zip(*axes.get_legend_handles_labels())}
    names = [name for name in methods if name in found]
    figure.legend([found[name] for name in names], names, loc="outside upper center",
                  ncols=min(len(names), 4))
