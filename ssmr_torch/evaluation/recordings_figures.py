"""Figure of the recording checks: one panel for each subject that has a curve."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from ssmr_torch.evaluation.figures import MM, MS, WIDTH, panels, save, styled

COLOURS = {"good": "#117733", "warning": "#C46A00", "missing": "#B2182B", "unknown": "#777777"}
INK, TRAINING, TEST = "#0072B2", "#9A9A9A", "#0072B2"
MOST_POINTS = 4000


def save_all(findings: Sequence, directory: str | Path, output_names: Sequence[str]) -> list[Path]:
    """Write the figure as directory/recordings.svg, and the rows with faults as directory/faults.svg if there are any.
    """
    written = [save(recordings(findings, output_names), Path(directory) / "recordings.svg")]
    stretches = next((each.curves["stretches"] for each in findings if "stretches" in each.curves), [])
    return [*written, save(faults(stretches), Path(directory) / "faults.svg")] if stretches else written


@styled
def faults(stretches: Sequence[Mapping]) -> Figure:
    """One panel for each fault: the recorded values around its first bad row, with the bad rows marked.

    stretches: with `title`, `output`, `first_row`, `values` (m, None where a cell was empty) and `bad`.
    """
    figure, grid = panels(WIDTH, 2.1 * len(stretches), len(stretches), 1)
    for axes, each in zip(np.ravel(grid), stretches):
        values = np.array([np.nan if value is None else value for value in each["values"]])
        rows, bad = each["first_row"] + np.arange(len(values)), np.array(each["bad"], dtype=bool)
        axes.plot(rows, MM * values, ".-", color=INK, linewidth=0.7, markersize=3)
        axes.plot(rows[bad], MM * values[bad], "o", color=COLOURS["missing"], markersize=4)
        axes.set_title(each["title"], loc="left")
        axes.set(xlabel="row of the file", ylabel=f"{each['output']} (mm)")
        good = MM * values[~bad & np.isfinite(values)]
        if len(good) and np.ptp(good) > 0:
            margin = 1.5 * np.ptp(good)
            axes.set_ylim(good.min() - margin, good.max() + margin)
    return figure


@styled
def recordings(findings: Sequence, output_names: Sequence[str]) -> Figure:
    """Panels for decays, range, dither, sampling, delay and drift, each with its severity in the title.

    findings: with `subject`, `severity`, `numbers` and `curves`, see `recording_checks.finding`. The range is shown for
    the output that moves most.
    """
    figure, grid = panels(WIDTH, 4.4, 2, 3)
    by_subject = {finding.subject: finding for finding in findings}
    for axes, (subject, draw) in zip(grid.flat, PANELS.items()):
        finding = by_subject[subject]
        axes.set_title(f"{subject}: {finding.severity}", color=COLOURS[finding.severity], loc="left")
        if not finding.curves:
            axes.text(0.5, 0.5, "nothing to show", ha="center", va="center", color="#777777", transform=axes.transAxes)
            axes.set_axis_off()
            continue
        draw(axes, finding, output_names)
    return figure


def _decays(axes: Axes, finding, output_names) -> None:
    curves = finding.curves["decays"]
    for time, size in curves:
        axes.semilogy(time, MM * np.maximum(size, 1e-9), color=INK, linewidth=0.7, alpha=max(0.25, 1 / len(curves)))
    largest = MM * max(size.max() for _, size in curves)
    axes.set(xlabel="time (s)", ylabel="distance from rest (mm)", ylim=(1e-4 * largest, 2 * largest))


def _range(axes: Axes, finding, output_names) -> None:
    known, asked = finding.curves["position"]
    column = int(np.argmax(np.ptp(known, axis=0)))
    for label, place, colour in (("training", 0, TRAINING), ("test", 1, TEST)):
        y, v = (finding.curves[name][place][:, column] for name in ("position", "speed"))
        every = max(1, len(y) // MOST_POINTS)
        axes.plot(MM * y[::every], v[::every], ".", markersize=1.5, color=colour, label=label, rasterized=True)
    axes.set(xlabel=f"{output_names[column]} (mm)", ylabel="speed (m/s)")
    axes.margins(y=0.2)
    axes.legend(markerscale=5, loc="upper right", handletextpad=0.1, borderaxespad=0.1, ncols=2, columnspacing=0.6)


def _dither(axes: Axes, finding, output_names) -> None:
    frequencies, power = finding.curves["frequencies"][1:], finding.curves["power"][1:]
    axes.loglog(frequencies, power / power.sum(), color=INK)
    if np.isfinite(finding.curves["mode"]):
        axes.axvline(finding.curves["mode"], color="black", linestyle="--", linewidth=0.9)
        axes.annotate("fastest\nslow mode", (finding.curves["mode"], 0.0), xycoords=("data", "axes fraction"),
                      xytext=(-3, 3), textcoords="offset points", va="bottom", ha="right", fontsize=7)
    axes.set(xlabel="frequency (Hz)", ylabel="share of the input's power (–)")


def _sampling(axes: Axes, finding, output_names) -> None:
    rates, share = finding.curves["rates"], finding.curves["share"]
    frequency = np.abs(rates.imag) / 2 / np.pi
    axes.vlines(frequency, 0, share, color=INK)
    axes.plot(frequency, share, "o", color=INK, markersize=4)
    axes.axvline(finding.numbers["rate_hz"] / 20, color="black", linestyle="--", linewidth=0.9)
    axes.annotate("20 samples\na period", (finding.numbers["rate_hz"] / 20, 1.0), xycoords=("data", "axes fraction"),
                  xytext=(-3, -2), textcoords="offset points", va="top", ha="right", fontsize=7)
    axes.set(xlabel="frequency of the slow modes (Hz)", ylabel="share of the motion (–)", ylim=(0, 1.35),
             xlim=(0, 1.15 * max(frequency.max(), finding.numbers["rate_hz"] / 20)))


def _delay(axes: Axes, finding, output_names) -> None:
    lags, residual = MS * finding.curves["lags"], finding.curves["residual"]
    axes.step(lags, residual, where="mid", color=INK)
    if finding.numbers.get("samples") is not None:
        axes.axvline(MS * finding.numbers["delay_s"], color="black", linestyle="--", linewidth=0.9)
    axes.set(xlabel="inputs used up to this time before (ms)", ylabel="unexplained motion (–)")
    axes.margins(y=0.15)


def _drift(axes: Axes, finding, output_names) -> None:
    slopes, errors = finding.curves["slopes"], finding.curves["errors"]
    places = np.arange(1, len(slopes) + 1)
    for column in range(slopes.shape[1]):
        shift = 0.08 * (column - (slopes.shape[1] - 1) / 2)
        axes.errorbar(places + shift, MM * slopes[:, column], MM * errors[:, column], fmt="o", markersize=3,
                      color=INK, alpha=0.35 + 0.65 / (1 + column), linewidth=0.8)
    axes.axhline(0.0, color="black", linewidth=0.7)
    axes.set(xlabel="controlled run", ylabel="drift within a run (mm)", xlim=(0.5, len(slopes) + 0.5))
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))


PANELS = {"decays": _decays, "range": _range, "dither": _dither, "sampling": _sampling, "delay": _delay,
          "drift": _drift}
