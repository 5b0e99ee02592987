"""Figures in the paper's kinds over a robot's workspace: error maps, box plots, tracked paths. SI in, mm drawn."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from ssmr_torch.evaluation import figures
from ssmr_torch.evaluation.figures import MM, WIDTH, styled

COLUMNS = 4
SCALE = "cividis"
BAD = "#CC3311"
POINTS_PER_PATH = 600
LONGEST = 16  # letters of a name that fit above a panel


@styled
def error_maps(position: np.ndarray, errors: Mapping[str, np.ndarray], axis_names: tuple[str, str] = ("x", "y"),
               plane: tuple[int, int] = (0, 1)) -> figures.Figure:
    """One panel per method: where the tip was at each start, coloured by the error from there (mm), on one common
    logarithmic scale; a start from which the method diverged is crossed out.

    position: (S, 3) m; errors: name → (S,) m, infinite where it diverged; plane: the two columns that are drawn.
    """
    position = MM * np.asarray(position)[:, list(plane)]
    errors = {name: MM * np.asarray(error, dtype=np.float64) for name, error in errors.items()}
    _match_starts(position, errors)
    figure, grid = tiles(len(errors), 1.55, sharex=True, sharey=True)
    low, high = _colour_range(errors)
    for axes, (name, error) in zip(grid, errors.items()):
        finite = np.isfinite(error)
        order = np.argsort(error[finite])  # the worst on top
        drawn = axes.scatter(*position[finite][order].T, c=np.clip(error[finite][order], low, high), s=7, linewidths=0,
                             cmap=SCALE, norm="log", rasterized=True, antialiased=False)
        drawn.set_clim(low, high)
        axes.plot(*position[~finite].T, "x", color=BAD, markersize=3.5, markeredgewidth=0.8, rasterized=True)
        title(axes, name, None if finite.all() else f"{100 * (~finite).mean():.2g} % diverged")
        axes.set_aspect("equal", adjustable="box")
    name_axes(figure, grid, *(f"{name} (mm)" for name in axis_names))
    bar = figure.colorbar(drawn, ax=grid, label="RMSE over 50 ms (mm)", aspect=35, pad=0.02, extend="both")
    plain_ticks(bar.ax.yaxis, low, high)
    bar.ax.grid(False)
    return figure


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


@styled
def tracked_paths(reference: np.ndarray, paths: Mapping[str, Sequence[np.ndarray]], axis_names: tuple[str, str],
                  notes: Mapping[str, str] | None = None) -> figures.Figure:
    """One panel per method: the path of each run over the reference (mm), the first of them bold.

    reference: (T, 2) m; paths: name → (T, 2) m of each run, the best first. notes: name → text below the name.
    """
    reference = MM * np.asarray(reference)
    figure, grid = tiles(len(paths), 1.75, sharex=True, sharey=True)
    for axes, (name, runs) in zip(grid, paths.items()):
        draw_paths(axes, reference, [MM * np.asarray(run) for run in runs], name, (notes or {}).get(name))
    low, high = reference.min(axis=0), reference.max(axis=0)
    room = 0.14 * max(high - low)
    grid[0].set(xlim=(low[0] - room, high[0] + room), ylim=(low[1] - room, high[1] + room))
    name_axes(figure, grid, *(f"{name} (mm)" for name in axis_names))
    return figure


def draw_paths(axes, reference: np.ndarray, runs: Sequence[np.ndarray], name: str, note: str | None) -> None:
    """A method's runs, the first bold, and the reference over them. All in mm."""
    colour = figures.colours([name])[name]
    for run in runs[:0:-1]:
        axes.plot(*run.T, color=colour, linewidth=0.6, alpha=0.35, antialiased=False, rasterized=True)
    thin = max(1, math.ceil(len(reference) / POINTS_PER_PATH))
    axes.plot(*runs[0][::thin].T, color=colour, linewidth=1.5)
    axes.plot(*reference[::thin].T, color="black", linestyle=(0, (3, 2)), linewidth=0.7)
    title(axes, name, note)
    axes.set_aspect("equal", adjustable="box")


def title(axes, name: str, note: str | None = None) -> None:
    """The method in its colour, and what is to say of it below."""
    lines = name.replace(" ", "\n", 1) if len(name) > LONGEST else name
    axes.set_title(f"{lines}\n" if note else lines, color=figures.colours([name])[name])
    if note:
        axes.annotate(note, (0.5, 1.0), (0, 4), "axes fraction", "offset points", ha="center", va="bottom", fontsize=7)


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


def _colour_range(errors: Mapping[str, np.ndarray]) -> tuple[float, float]:
    """Between which errors the colours vary: 1 to 99 % of all finite ones."""
    finite = np.concatenate([error[np.isfinite(error) & (error > 0)] for error in errors.values()])
    if not len(finite):
        return 1e-3, 1.0
    low, high = np.quantile(finite, [0.01, 0.99])
    return float(low), float(max(high, 1.01 * low))


def _match_starts(position: np.ndarray, errors: Mapping[str, np.ndarray]) -> None:
    wrong = {name: error.shape for name, error in errors.items() if error.shape != position.shape[:1]}
    if wrong or not errors:
        raise ValueError(f"errors of shape {wrong or 'none'} for {len(position)} starts; expected one error per start")
