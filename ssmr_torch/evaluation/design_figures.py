"""Figures of a controller design: actuator, held-out errors, innovations, sensitivity, errors on the twin."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from ssmr_torch.evaluation.figures import WIDTH, panels, save, styled

FREQUENCIES = 60


def draw(report, folder: Path) -> list[Path]:
    """Write actuator.png, model.png, innovations.png, sensitivity.png and twin.png. Returns the paths of those written.
    """
    made = []
    for name, painter in (("actuator", _actuator), ("model", _model), ("innovations", _innovations),
                          ("sensitivity", _sensitivity), ("twin", _twin)):
        figure = painter(report)
        if figure is not None:
            path = folder / f"{name}.png"
            save(figure, path)
            made.append(path)
    return made


@styled
def _actuator(report) -> Figure | None:
    """Held-out error over delay, lag and friction; in each panel the other two keep their found values."""
    found = report.identification
    if not found.by_delay:
        return None
    figure, grid = panels(WIDTH, 2.2, 1, 3)
    axes = list(np.ravel(grid))
    h = found.actuator.timestep
    _profile(axes[0], [1e3 * h * delay for delay in found.by_delay], found.by_delay.values(),
             1e3 * h * found.actuator.delay, "delay (ms)")
    _profile(axes[1], [1e3 * lag for lag in found.by_lag], found.by_lag.values(), 1e3 * found.actuator.lag, "lag (ms)")
    for name, label in (("play", "play (half, % of range)"), ("friction", "cable friction (μθ, %)")):
        values = {value: error for (kind, value), error in found.by_friction.items() if kind == name}
        if values:
            axes[2].plot([100 * value for value in values], [100 * error for error in values.values()], "o-",
                         label=label)
    axes[2].set_xlabel("hysteresis (%)")
    axes[2].legend(loc="upper center", bbox_to_anchor=(0.5, 1.3))
    axes[0].set_ylabel("held-out error (% of the reach)")
    for axis in axes:
        axis.set_ylim(bottom=0.0)
    return figure


def _profile(axis, values, errors, chosen: float, label: str) -> None:
    axis.plot(list(values), [100 * error for error in errors], "o-")
    axis.axvline(chosen, color="0.6", linestyle="--", linewidth=1)
    axis.set_xlabel(label)


@styled
def _model(report) -> Figure | None:
    """Held-out errors of all predictive models that were tried, by number of states."""
    if not report.model.tried:
        return None
    figure, axis = panels(0.5 * WIDTH, 2.4)
    for degree, marker in ((1, "s"), (2, "o"), (3, "^")):
        points = [(form.states, 100 * error) for form, error in report.model.tried if form.degree == degree]
        if points:
            axis.plot(*zip(*points), marker, alpha=0.6, linestyle="none", label=f"degree {degree}")
    axis.axhline(100 * report.model.error, color="0.6", linestyle="--", linewidth=1)
    axis.set(xlabel="states", ylabel="held-out error (% of the reach)", yscale="log")
    axis.legend()
    return figure


@styled
def _innovations(report) -> Figure:
    """Distribution of the innovations of the held-out runs in standard deviations, with the normal distribution."""
    likelihood, names = report.likelihood, report.recordings.output_names
    observer = likelihood.observer(report.noises)
    errors = likelihood.innovations(observer).reshape(-1, len(names)) / np.sqrt(np.diag(observer.covariance))
    figure, axis = panels(0.5 * WIDTH, 2.4)
    bins = np.linspace(-6, 6, 61)
    for column in report.recordings.tracked:
        axis.hist(np.clip(errors[:, column], -6, 6), bins, density=True, histtype="step", label=names[column])
    axis.plot(bins, np.exp(-0.5 * bins**2) / np.sqrt(2 * np.pi), color="0.4", linestyle="--", label="normal")
    axis.set(xlabel="innovation (standard deviations)", ylabel="density")
    axis.legend()
    return figure


@styled
def _sensitivity(report) -> Figure:
    """Largest singular value of the tracked outputs' sensitivity over frequency, for every operating point that was
    checked for margins.
    """
    best, h = report.search.best, report.recordings.timestep
    frequencies = np.geomspace(0.01, 0.98 * np.pi, FREQUENCIES)
    figure, axis = panels(0.5 * WIDTH, 2.4)
    for point in report.search.points:
        axis.plot(frequencies / (2 * np.pi * h), point.sensitivity(best.observer, best.weights, frequencies), alpha=0.8)
    axis.axhline(1.0, color="0.6", linewidth=1)
    axis.set(xlabel="frequency (Hz)", ylabel="σ_max(S)", xscale="log")
    return figure


@styled
def _twin(report) -> Figure | None:
    """Tracking error on the disturbed twin, by case."""
    errors = report.search.best.against_twin
    if not errors:
        return None
    figure, axis = panels(0.6 * WIDTH, 2.4)
    shown = [100 * error if np.isfinite(error) else np.nan for error in errors.values()]
    axis.barh(list(errors), shown)
    axis.axvline(100 * report.search.best.predicted, color="0.4", linestyle="--", linewidth=1,
                 label="predicted, as it is")
    for place, error in enumerate(shown):
        if np.isnan(error):
            axis.text(0.0, place, " lost", va="center")
    axis.invert_yaxis()
    axis.set_xlabel("RMS tracking error (% of the reach)")
    axis.legend()
    return figure
