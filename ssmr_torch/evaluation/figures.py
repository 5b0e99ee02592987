"""Figures of fits, predictions and closed loops. Arguments are in SI units; axes show mm, ms and %."""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import wraps
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter, StrMethodFormatter

from ssmr_torch.result_files import written_aside

METHODS = {
    "SSMR": ("#0072B2", "-"), "SSSR": ("#56B4E9", "-"), "DMD": ("#E69F00", "-"), "EDMD": ("#D55E00", "-"),
    "static pregain": ("#CC79A7", "-"), "TPWL": ("#009E73", "-"), "neural ODE": ("#882255", "-"),
    "SSMR stability guard": ("#003D66", "--"), "SSMR oblique": ("#7FA8E5", "-."),
    "SSMR control augmented": ("#117733", "-"),
    "EDMD bilinear": ("#8C510A", "--"), "EDMD relift": ("#F4A582", "-."),
    "persistence": ("#999999", "--"), "constant velocity": ("#666666", ":"), "reference": ("#000000", "--"),
    "measured": ("#000000", "-")}
# other names of the same methods, two of them in results of version 0.10 and older
ALIASES = {"control-augmented SSMR": "SSMR control augmented", "Koopman LQR": "static pregain",
           "SSMR guarded": "SSMR stability guard"}
SPARE_COLOURS = ("#332288", "#999933", "#AA4499", "#44AA99", "#661100", "#DDCC77")
STYLE = {"font.size": 8, "axes.titlesize": 8, "axes.titleweight": "bold", "legend.fontsize": 8,
         "legend.frameon": False, "lines.linewidth": 1.3, "axes.linewidth": 0.7, "axes.spines.top": False,
         "axes.spines.right": False, "axes.grid": True, "grid.color": "#E6E6E6", "grid.linewidth": 0.6,
         "axes.axisbelow": True, "svg.hashsalt": "ssmr_torch", "pdf.fonttype": 42, "savefig.dpi": 200}
WIDTH = 7.0
FORMATS = (".svg", ".pdf", ".png")
MM = 1e3
MS = 1e3


def styled(draw: Callable[..., Figure]) -> Callable[..., Figure]:
    @wraps(draw)
    def drawn(*arguments, **options):
        with matplotlib.rc_context(STYLE):
            return draw(*arguments, **options)
    return drawn


def look(name: str) -> tuple[str, str] | None:
    """Colour and line style of a method of `METHODS`; None for others. Case, spaces and underscores do not matter."""
    return _LOOKS.get(_plain(name))


def _plain(name: str) -> str:
    return name.casefold().replace("_", " ")


_LOOKS = {_plain(name): own for name, own in METHODS.items()}
_LOOKS |= {_plain(alias): METHODS[name] for alias, name in ALIASES.items()}


def colours(names: Iterable[str]) -> dict[str, str]:
    """The colour of each method: fixed for those of `METHODS`, the next spare colour for each other one."""
    names = list(names)
    unknown = [name for name in names if look(name) is None]
    if len(unknown) > len(SPARE_COLOURS):
        raise ValueError(f"{len(unknown)} methods have no fixed colour, but there are {len(SPARE_COLOURS)} spare "
                         f"colours; draw fewer methods at once, or use the names {list(METHODS)}")
    spare = dict(zip(unknown, SPARE_COLOURS))
    return {name: spare[name] if name in spare else look(name)[0] for name in names}


@styled
def save(figure: Figure, path: str | Path) -> Path:
    """Write the figure as .svg, .pdf or .png; the file appears only when it is complete."""
    path = Path(path)
    if path.suffix not in FORMATS:
        raise ValueError(f"cannot save a figure as {path.name!r}; expected a name ending in one of {FORMATS}")
    dateless = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}, ".png": None}[path.suffix]
    with written_aside(path) as aside:
        figure.savefig(aside, format=path.suffix[1:], metadata=dateless)
    return path


@styled
def svg(figure: Figure) -> str:
    """The figure as the text of an SVG file."""
    figure.savefig(text := io.StringIO(), format="svg", metadata={"Date": None})
    return text.getvalue()


@styled
def singular_values(values: np.ndarray, dimension: int) -> Figure:
    """σ_i / σ_1, the omitted variance 1 − Σ_{j≤i} σ_j² / Σ σ_j² (%), and the gaps σ_i / σ_{i+1}, over the mode i.

    values: (K,) singular values, descending; dimension: the number of modes that are kept, which is marked.
    Raises ValueError if the values are not positive and descending, or if there are fewer than dimension.
    """
    values = np.asarray(values, dtype=np.float64)
    descending = values.ndim == 1 and (values > 0).all() and (np.diff(values) <= 0).all()
    if not descending or len(values) < 2 or not 1 <= dimension <= len(values):
        raise ValueError(f"{values.shape} singular values and dimension {dimension}; expected (K,) positive "
                         "values in descending order, K >= 2, and 1 <= dimension <= K")
    left_out = 100 * np.cumsum(values[::-1] ** 2)[::-1][1:] / (values ** 2).sum()
    mode = np.arange(1, len(values) + 1)
    figure, (spectrum, remainder, gaps) = panels(WIDTH, 2.3, 1, 3, sharex=True)
    for axes, x, y, title in ((spectrum, mode, values / values[0], r"singular value $\sigma_i/\sigma_1$ (–)"),
                              (remainder, mode[:-1], left_out, "variance left out (%)")):
        axes.semilogy(x, y, "o-", color="#999999", markersize=3.5)
        axes.semilogy(x[:dimension], y[:dimension], "o", color=METHODS["SSMR"][0], markersize=4.5)
        axes.set_ylabel(title)
    chosen = np.where(mode[:-1] == dimension, METHODS["SSMR"][0], "#BBBBBB")
    gaps.bar(mode[:-1], values[:-1] / values[1:], color=chosen, width=0.7)
    gaps.set_ylabel(r"gap $\sigma_i/\sigma_{i+1}$ (–)")
    captured = 100 * (values[:dimension] ** 2).sum() / (values ** 2).sum()
    remainder.set_title(f"{dimension} modes capture {captured:.4g} %", fontweight="normal")
    gaps.grid(False, axis="x")
    for axes in (spectrum, remainder, gaps):
        axes.set_xlabel("mode $i$")
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    return figure


@styled
def eigenvalues(spectra: Mapping[str, np.ndarray], reference: np.ndarray | None = None,
                label: str = "reference") -> Figure:
    """Eigenvalues (1/s) of the linear part of the reduced dynamics, per method; a reference is drawn as open circles.
    """
    figure, axes = panels(WIDTH / 2, 2.8)
    axes.axvline(0.0, color="#666666", linewidth=0.8)
    if reference is not None:
        axes.plot(np.real(reference), np.imag(reference), "o", color="black", mfc="none", ms=9, label=label)
    palette = colours(spectra)
    for (name, values), marker in zip(spectra.items(), "o^sDvPX" * len(spectra)):
        axes.plot(np.real(values), np.imag(values), marker, color=palette[name], markersize=4.5, label=name)
    axes.set(xlabel=r"real part $\mathrm{Re}\,\lambda$ (1/s)", ylabel=r"imaginary part $\mathrm{Im}\,\lambda$ (rad/s)")
    axes.margins(0.12)
    _legend(figure, axes)
    return figure


@styled
def prediction(time: np.ndarray, measured: np.ndarray, predicted: Mapping[str, tuple[np.ndarray, np.ndarray]],
               output_names: Sequence[str], target: str = "measured") -> Figure:
    """Each output (mm) over time (s): the measurement, and each model's prediction from one start without correction.

    time: (T,) s; measured: (T, p) m; predicted: name → (time (H,) s, outputs (H, p) m). The measurement sets the limits
    of the axes, so a diverging prediction leaves them. target: label of the measured line.
    """
    measured = np.asarray(measured)
    _match_columns(measured, output_names)
    figure, grid = panels(WIDTH, 0.7 + 1.15 * len(output_names), len(output_names), 1, sharex=True, squeeze=False)
    rows = grid[:, 0]
    palette = colours(predicted)
    for column, (axes, label) in enumerate(zip(rows, output_names)):
        axes.plot(time, MM * measured[:, column], color=METHODS["measured"][0], linewidth=2.2, alpha=0.35, label=target)
        low, high = MM * measured[:, column].min(), MM * measured[:, column].max()
        for name, (at, outputs) in predicted.items():
            axes.plot(at, MM * np.asarray(outputs)[:, column], _line(name), color=palette[name], label=name)
        room = 0.25 * max(high - low, 1e-3)
        axes.set(ylabel=f"{label} (mm)", ylim=(low - room, high + room))
    rows[-1].set(xlabel="time (s)", xlim=(time[0], time[-1]))
    figure.align_ylabels(rows)
    _legend(figure, rows[0])
    return figure


@styled
def error_over_horizon(horizons: np.ndarray, errors: Mapping[str, np.ndarray]) -> Figure:
    """Mean RMSE (mm) over the prediction horizon (s), both logarithmic; a cross marks where rollouts begin to diverge.

    horizons: (K,) s; errors: name → (K,) m, infinite where a rollout diverged.
    """
    horizons = np.asarray(horizons)
    many = len(errors) > 6
    figure, axes = panels(WIDTH if many else WIDTH / 2 + 0.6, 3.0)
    palette = colours(errors)
    for name, values in errors.items():
        values = np.asarray(values, dtype=np.float64)
        finite = np.isfinite(values)
        end = len(values) if finite.all() else int(np.argmin(finite))
        axes.loglog(horizons[:end], MM * values[:end], color=palette[name], linestyle=_line(name), marker="o",
                    markersize=3, label=name if finite.all() else f"{name} (× diverges)")
        if 0 < end < len(values):
            axes.plot(horizons[end - 1], MM * values[end - 1], "x", color=palette[name], markersize=9, mew=2)
    axes.set(xlabel="prediction horizon (s)", ylabel="mean RMSE (mm)")
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axis.set_minor_formatter(NullFormatter())
    if many:
        figure.legend(loc="outside center right")
    else:
        _legend(figure, axes)
    return figure


@styled
def tracking(time: np.ndarray, reference: np.ndarray, paths: Mapping[str, np.ndarray],
             axis_names: tuple[str, str], obstacles: np.ndarray | None = None) -> Figure:
    """Paths in the task's plane (mm), and the tracking error ‖e‖ (mm) over time (s).

    time: (T,) s; reference: (T, 2) m; paths: name → (T, 2) m; obstacles: (O, 3) centre and radius, m.
    """
    figure, (plane, error) = panels(WIDTH, 3.1, 1, 2, width_ratios=(1.0, 1.25))
    for x, y, radius in () if obstacles is None else MM * np.asarray(obstacles):
        plane.add_patch(Circle((x, y), radius, facecolor="#DDDDDD", edgecolor="#888888", linewidth=0.8))
    palette = colours(paths)
    for below, (name, path) in enumerate(paths.items()):
        line = {"color": palette[name], "zorder": 2.5 - below / len(paths), "label": name}
        plane.plot(*MM * np.asarray(path).T, **line)
        error.semilogy(time, MM * np.linalg.norm(path - reference, axis=1), linewidth=1.0, **line)
    colour, style = METHODS["reference"]
    plane.plot(*MM * np.asarray(reference).T, style, color=colour, linewidth=1.0, zorder=3, label="reference")
    largest = MM * max(np.linalg.norm(path - reference, axis=1).max() for path in paths.values())
    error.set_ylim(bottom=max(1e-3 * largest, 1e-9))
    plane.set(xlabel=f"{axis_names[0]} (mm)", ylabel=f"{axis_names[1]} (mm)")
    plane.set_aspect("equal", adjustable="datalim")
    error.set(xlabel="time (s)", ylabel="tracking error (mm)", xlim=(time[0], time[-1]))
    error.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    _legend(figure, plane)
    return figure


@styled
def inputs(time: np.ndarray, commands: Mapping[str, np.ndarray], bounds: np.ndarray,
           input_names: Sequence[str], unit: str = "N") -> Figure:
    """Each input over time (s), with its bounds. commands: name → (T, m); bounds: (2, m), both in `unit`."""
    bounds = np.asarray(bounds)
    _match_columns(bounds, input_names)
    columns = min(4, len(input_names))
    rows = -(-len(input_names) // columns)
    figure, grid = panels(WIDTH, 0.6 + 1.5 * rows, rows, columns, sharex=True, sharey=True, squeeze=False)
    palette = colours(commands)
    label = "–" if unit == "1" else unit
    for index, axes in enumerate(grid.flat):
        if index >= len(input_names):
            axes.set_axis_off()
            continue
        for below, (name, command) in enumerate(commands.items()):
            axes.step(time, np.asarray(command)[:, index], where="post", color=palette[name], linewidth=1.0,
                      zorder=2.5 - below / len(commands), label=name)
        for row, bound in enumerate(bounds[:, index]):
            axes.axhline(bound, color="black", linestyle=(0, (4, 3)), linewidth=0.8, label=None if row else "bounds")
        axes.set(title=input_names[index], xlim=(time[0], time[-1]))
        if index + columns >= len(input_names):
            axes.set_xlabel("time (s)")
            axes.tick_params(labelbottom=True)
        if index % columns == 0:
            axes.set_ylabel(f"input ({label})")
    _legend(figure, grid[0, 0])
    return figure


@styled
def solve_times(times: Mapping[str, np.ndarray], period: float) -> Figure:
    """Solve times (ms, logarithmic) per method, with the control period. Boxes: quartiles; whiskers: 1 and 99 %.

    times: name → (K,) s; period: s.
    """
    figure, axes = panels(WIDTH * 0.7, 0.9 + 0.32 * len(times))
    names = list(times)[::-1]
    palette = colours(names)
    boxes = axes.boxplot([MS * np.asarray(times[name]) for name in names], orientation="horizontal",
                         whis=(1, 99), widths=0.55, patch_artist=True, medianprops={"color": "black"},
                         flierprops={"marker": ".", "markersize": 3, "alpha": 0.4})
    for name, box, fliers in zip(names, boxes["boxes"], boxes["fliers"]):
        box.set(facecolor=palette[name], linewidth=0.7)
        fliers.set(markeredgecolor=palette[name], markerfacecolor=palette[name])
    axes.set(xscale="log", xlabel="solve time (ms)")
    axes.set_yticks(range(1, len(names) + 1), names)
    axes.axvline(MS * period, color="black", linestyle="--", linewidth=1.0, label=f"control period, {MS * period:g} ms")
    axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axes.grid(False, axis="y")
    _legend(figure, axes)
    return figure


@styled
def ise_bars(ise: Mapping[str, Mapping[str, float]]) -> Figure:
    """Integral squared error (mm², logarithmic) per task and method; ise: task → method → m².

    An infinite value is marked as failed; a missing value leaves a gap.
    """
    methods = list(dict.fromkeys(method for row in ise.values() for method in row))
    figure, axes = panels(min(WIDTH, 2.0 + 0.4 * len(methods) * len(ise)), 2.7)
    width = 0.82 / len(methods)
    palette = colours(methods)
    lowest = MM ** 2 * min((v for row in ise.values() for v in row.values() if 0 < v < np.inf), default=1.0)
    for index, method in enumerate(methods):
        at = np.arange(len(ise)) + (index - (len(methods) - 1) / 2) * width
        heights = MM ** 2 * np.array([row.get(method, np.nan) for row in ise.values()], dtype=np.float64)
        finite = np.where(np.isfinite(heights), heights, np.nan)
        axes.bar(at, finite, 0.9 * width, color=palette[method], label=method)
        for x in at[np.isinf(heights)]:
            axes.annotate("failed", (x, lowest), rotation=90, ha="center", va="bottom", color=palette[method])
    axes.set(yscale="log", xlim=(-0.5, len(ise) - 0.5), ylim=(lowest / 2, None), ylabel="ISE (mm²)")
    axes.set_xticks(np.arange(len(ise)), list(ise))
    axes.grid(False, axis="x")
    _legend(figure, axes)
    return figure


def panels(width: float, height: float, *grid: int, **options):
    """A figure of this size in inches, and its axes, as `Figure.subplots` returns them."""
    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, figure.subplots(*grid, **options)


def _line(name: str) -> str:
    return (look(name) or ("", "-"))[1]


def _legend(figure: Figure, axes: Axes) -> None:
    handles, labels = axes.get_legend_handles_labels()
    entry = 0.55 + 0.075 * max(map(len, labels))  # width of a handle and the longest label, in inches
    columns = max(1, min(len(labels), int(figure.get_figwidth() / entry)))
    figure.legend(handles, labels, loc="outside upper center", ncols=math.ceil(len(labels) / math.ceil(
        len(labels) / columns)))


def _match_columns(array: np.ndarray, names: Sequence[str]) -> None:
    if array.ndim != 2 or array.shape[1] != len(names):
        raise ValueError(f"an array of shape {array.shape} for {len(names)} names {list(names)}; "
                         f"expected (samples, {len(names)})")
