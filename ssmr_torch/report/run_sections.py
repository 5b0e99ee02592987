"""Sections of the report, made from the files that earlier runs wrote into their directories."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from inspect import signature
from pathlib import Path

import numpy as np

from ssmr_torch.closed_loop.record import ClosedLoopRecord
from ssmr_torch.evaluation import figures
from ssmr_torch.evaluation.measured_rollouts import predict_trajectory
from ssmr_torch.evaluation.metrics import closed_loop_metrics
from ssmr_torch.evaluation.open_loop import OpenLoopScore
from ssmr_torch.models.predictors import BASELINES
from ssmr_torch.plants.emulated_rig import Rig
from ssmr_torch.report.html_page import Picture, Section, Table
from ssmr_torch.result_files import read_json

# the number of colours for names without a fixed one
PATHS_PER_FIGURE = len(figures.SPARE_COLOURS)


def prediction_figures(models: Mapping[str, object], scores: Mapping[str, OpenLoopScore], runs: Sequence,
                       output_names: Sequence[str], outputs: Sequence[int], shown: float = 4.0) -> dict:
    """Two figures: the error over the horizon, and the first `shown` s of the rollouts over the longest controlled run.

    The first shows all models that have a colour; names without a fixed colour are limited to six. The second shows
    the first six models, from the common margin of the scores.
    """
    first = next(iter(scores.values()))
    named = [name for name in scores if figures.look(name) is None][PATHS_PER_FIGURE:]
    scores = {name: score for name, score in scores.items() if name not in named}
    models = dict(list(models.items())[:PATHS_PER_FIGURE])
    longest_step = max(model.timestep for model in models.values())

    def needed(run) -> int:
        return first.margin + 1 + round(longest_step / run.timestep)

    run = max(runs, key=lambda run: (run.length >= needed(run), run.kind == "controlled", run.length))
    run = run.part(0, min(run.length, max(needed(run), first.margin + 1 + round(shown / run.timestep)))).read()
    predicted = {}
    for name, model in models.items():
        time, states = predict_trajectory(model, run, margin=first.margin)
        predicted[name] = (time, states[:, outputs])
    horizons = np.array([part.duration for part in first.horizons[:-1]])
    errors = {name: np.array([part.mean for part in score.horizons[:-1]]) for name, score in scores.items()}
    overlay = figures.prediction(run.time, run.observation[:, outputs], predicted, [output_names[i] for i in outputs])
    return {"error_over_horizon": figures.error_over_horizon(horizons, errors), "prediction": overlay}


def training_figures(report: Mapping[str, Mapping], plant: Sequence[tuple[float, float]] | None = None) -> dict:
    """Singular values and eigenvalues of all fits that computed them; singular values of zero are not drawn.

    plant: real and imaginary parts, 1/s, of the plant's own eigenvalues, if they are known; those larger than twice the
    fits' eigenvalues are not drawn.
    """
    drawn = {}
    for fit in report.values():
        values = np.array(fit.get("singular_values") or [])
        values = values[values > 0]
        if len(values) >= max(2, fit["state_dim"] if len(values) else 0):
            drawn["singular_values"] = figures.singular_values(values, fit["state_dim"])
    spectra = {step.replace("_", " "): np.array(fit["eigenvalues"]) @ np.array([1.0, 1.0j])
               for step, fit in report.items() if fit.get("eigenvalues")}
    if spectra:
        known = np.array([complex(*rate) for rate in plant or []], dtype=np.complex128)
        known = known[np.abs(known) <= 2 * max(np.abs(values).max() for values in spectra.values())]
        drawn["eigenvalues"] = figures.eigenvalues(spectra, known if len(known) else None, "plant")
    return drawn


def collect_sections(directory: str | Path) -> list[Section]:
    """Sections for the closed-loop records, open-loop scores and training reports below a directory.

    Records with the same task, plant, rig, noise and control period share a section, one row each.
    Raises ValueError if there are none.
    """
    directory = Path(directory)
    alike: dict[tuple, dict[Path, ClosedLoopRecord]] = {}
    for path in sorted(directory.rglob("record.h5")):
        record = ClosedLoopRecord.load(path)
        alike.setdefault(_setting(record), {})[path] = record
    sections = [closed_loop_section(list(records.values()), _robot_picture(records)) for records in alike.values()]
    sections += [open_loop_section(path) for path in sorted(directory.rglob("scores.json"))]
    sections += [training_section(path) for path in sorted(directory.rglob("report.json"))]
    if not sections:
        raise ValueError(f"there is nothing to report below {directory}: no record.h5, scores.json or report.json. Run "
                         "ssmr train, ssmr evaluate or ssmr control with hydra.run.dir below it")
    return sections


def closed_loop_section(records: Sequence[ClosedLoopRecord], picture: Picture | None = None) -> Section:
    """Tracking table with one row per record, a picture of the robot, and figures of the first six records.

    Equal model names are numbered, and different seeds are shown. A record without errors, because it stopped early or
    is too short, has an empty row and is not drawn; the text says why.
    Raises ValueError if the records differ in task, plant, rig, noise or control period.
    """
    if len({_setting(record) for record in records}) != 1:
        raise ValueError(f"{len(records)} records with {len({_setting(r) for r in records})} different settings (task, "
                         "plant, rig, noise, control period); expected equal settings in one section")
    origin = records[0].provenance
    runs = dict(zip(_unique(record.provenance.get("model", "model") for record in records), records))
    measured, missing = {}, []
    for name, record in runs.items():
        try:
            measured[name] = closed_loop_metrics(record)
        except ValueError as error:
            missing.append(f"{name} has no errors: {error}.")
    drawn = {name: runs[name] for name in list(measured)[:PATHS_PER_FIGURE]}
    parts = [f"Task: {origin['task']}, {records[0].time[-1]:.1f} s, on the plant {origin['plant']}, "
             f"measured with white noise of {1e3 * origin['noise_std']:.3g} mm. The controller runs the exported "
             f"artifact and plans every {1e3 * origin['period']:g} ms. "
             "Errors count after the first second; ISE is the sum of squared errors over the samples.",
             *missing, *_first_of(len(drawn), len(measured), "runs"), _tracking_table(runs, measured)]
    settings = [[key, str(value)] for key, value in _plant_settings(records[0]).items() if key != "_target_"]
    table = [Table(["setting", "value"], settings, f"The {origin['plant']}, SI units.")] if settings else []
    return Section(f"Closed loop: {origin['task']}", [*parts, *([picture] if picture else []),
                                                      *(_tracking_pictures(drawn) if drawn else []), *table])


def open_loop_section(path: Path) -> Section:
    """Tables and figures of one evaluation, with one table per group of runs."""
    stored = read_json(path)
    groups = stored.get("groups") or {}
    shown = groups if len(groups) > 1 else {"": stored["scores"]}
    split = ((stored.get("provenance") or {}).get("configuration") or {}).get("split")
    text = (f"Root mean square error of rollouts from measured starts, without correction, on the "
            f"{split or 'whole'} set, at every sample of the recordings for every model. The starts are the same for "
            "every model, and no rollout crosses from one run into another. Only predicted samples count. A mean with "
            "a diverged rollout is not shown. NMTE: mean error divided by the largest norm of the run. *: best; =: tie "
            "with the best in a paired bootstrap.")
    tables = [_open_loop_table(scores, f"{name}: mean" if name else "Mean") for name, scores in shown.items()]
    scores = stored["scores"]
    starts = next((part["starts"] for score in scores.values() for part in score["horizons"] or []), 0)
    pictures = _stored_pictures(path, [
        ("error_over_horizon", "Mean error over the horizon.", f"{starts} starts", "mm"),
        ("prediction", "A rollout from one start, and the measurement.", "1 run", "mm")])
    more = _first_of(PATHS_PER_FIGURE, len(scores.keys() - BASELINES.keys()), "models") if pictures else []
    return Section("Open loop", [text, *more, *tables, *pictures])


def _open_loop_table(scores: Mapping[str, Mapping], beginning: str) -> Table:
    """Table of one group of runs: a row per model, and a second one for its score with noise."""
    rows = [(name if each is score else f"{name}, noise {1e3 * each['noise']:.3g} mm", each)
            for name, score in scores.items() for each in (score, score.get("noisy")) if each]
    parts = [{part["label"]: part for part in each["horizons"] or []} for _, each in rows]
    labels = list(dict.fromkeys(label for found in parts for label in found))
    last = [label for label in labels if any(found.get(label, {}).get("nmte") is not None for found in parts)][-1:]
    cells = []
    for (name, each), found in zip(rows, parts):
        means = [_marked(_times(1e3, found.get(label, {}).get("mean")), (each.get("marks") or {}).get(label))
                 for label in labels]
        diverged = [part["diverged"] for part in found.values() if part["diverged"] is not None]
        cells.append([name, *means, *(_times(100, found.get(label, {}).get("nmte")) for label in last),
                      _times(100, max(diverged, default=None))])
    header = ["model", *(f"{label} (mm)" for label in labels), *(f"NMTE, {label} (%)" for label in last),
              "diverged (%)"]
    return Table(header, cells, f"{beginning} open-loop error over the horizon.")


def _marked(value: float | None, mark: str | None) -> float | str | None:
    return value if value is None or not mark else f"{value:.4g} {mark}"


def training_section(path: Path) -> Section:
    """Section about one training: scores, regressions, warnings, singular values, eigenvalues."""
    stored = read_json(path)
    fits = {key: value for key, value in stored.items() if key not in ("scores", "cost", "provenance")}
    scores = stored.get("scores") or {}
    errors = [_error(key.removesuffix("/rmse"), scores) for key in scores if key.endswith("/rmse")]
    rows = [[f"{fit}: {regression}".replace("_", " "), values["rows"], values["features"], values["condition"],
             values["ridge"], _times(100, values["relative_residual"])]
            for fit, report in fits.items() for regression, values in (report.get("regressions") or {}).items()]
    parts = [f"Open-loop error over the validation horizon: {'; '.join(errors) or 'none scored'}.",
             *(f"Warning: {warning}" for report in fits.values() for warning in report.get("warnings") or [])]
    if rows:
        parts.append(Table(["regression", "rows", "features", "condition", "ridge", "residual (%)"], rows,
                           "Regressions of the fit."))
    trained = (next(iter(fits.values()), {}).get("trajectories") or {}).items()
    runs = {"decay": "decays", "controlled": "controlled runs"}
    # the rule of the fit: without decays, the controlled runs are used in their place
    kind, count = next(((runs[kind], count) for kind, count in trained if count), ("runs", 0))
    parts += _stored_pictures(path, [
        ("singular_values", f"Singular values of the windows of the {kind}, over the first.", f"{count} {kind}", "1"),
        ("eigenvalues", "Eigenvalues of the reduced dynamics at rest.", f"{count} {kind}", "1/s")])
    return Section(f"Training: {(stored.get('provenance') or {}).get('name') or path.parent.name}", parts)


def _setting(record: ClosedLoopRecord) -> tuple:
    """The settings that must be equal to compare runs: task, plant, rig, noise, period, and the axes of the figures."""
    origin = record.provenance
    return (*(origin[key] for key in ("task", "plant", "noise_std", "period")), record.tracked, record.output_names,
            record.input_names, record.input_unit, record.time.tobytes(), record.reference.tobytes(),
            json.dumps([origin.get("input_bounds"), _plant_settings(record)], sort_keys=True))


def _plant_settings(record: ClosedLoopRecord) -> dict:
    """All settings of the plant, and those of its rig that are not off."""
    configured = record.provenance.get("configuration") or {}
    off = {name: parameter.default for name, parameter in signature(Rig).parameters.items()}
    rig = {f"rig {key}": value for key, value in (configured.get("rig") or {}).items()
           if key in off and value != off[key]}
    return (configured.get("plant") or {}) | rig


def _unique(names: Iterable[str]) -> list[str]:
    """The names; repeated names get a number."""
    unique: list[str] = []
    for name in names:
        candidate, number = name, 2
        while candidate in unique:
            candidate, number = f"{name} {number}", number + 1
        unique.append(candidate)
    return unique


def _tracking_table(runs: Mapping[str, ClosedLoopRecord], measured: Mapping[str, Mapping[str, float]]) -> Table:
    columns = {"ISE (mm²)": ("ise", 1e6), "RMSE (mm)": ("rmse", 1e3), "max (mm)": ("max_error", 1e3),
               "solve (ms)": ("solve_time_median", 1e3), "99 % (ms)": ("solve_time_p99", 1e3)}
    seeds = {name: record.provenance.get("seed") for name, record in runs.items()}
    seeded = len(set(seeds.values())) > 1
    rows = [[name, *([seeds[name]] if seeded else []),
             *(_times(factor, measured.get(name, {}).get(key)) for key, factor in columns.values()),
             int(record.fallback.sum())] for name, record in runs.items()]
    return Table(["model", *(["seed"] if seeded else []), *columns, "fallbacks"], rows,
                 "Tracking in closed loop: errors, median and 99 % solve time, fallbacks.")


def _tracking_pictures(runs: Mapping[str, ClosedLoopRecord]) -> list[Picture]:
    first = next(iter(runs.values()))
    names = tuple(first.output_names[i] for i in first.tracked)
    paths = {name: record.observation[:, list(record.tracked)] for name, record in runs.items()}
    if len(names) == 2:
        drawing = figures.tracking(first.time, first.reference, paths, names)
        caption = "Path in the plane of the task, and tracking error."
    else:
        drawing = figures.prediction(first.time, first.reference,
                                     {name: (first.time, path) for name, path in paths.items()}, names, "reference")
        caption = "Tracked outputs and their reference."
    count = f"{len(first.time)} samples of each run"
    pictures = [Picture(drawing, caption, count, "mm")]
    bounds, period = first.provenance.get("input_bounds"), first.provenance["period"]
    if bounds is not None:
        inputs = figures.inputs(first.time, {name: record.input for name, record in runs.items()}, np.array(bounds),
                                first.input_names, first.input_unit)
        unit = first.input_unit if first.input_unit != "1" else "share of full command"
        pictures.append(Picture(inputs, "Inputs and their bounds.", count, unit))
    times = {name: record.solve_time[np.isfinite(record.solve_time)] for name, record in runs.items()}
    return [*pictures, Picture(figures.solve_times(times, period), "Time in the controller at each control step.",
                               f"{len(next(iter(times.values())))} steps of each run", "ms")]


def _robot_picture(records: Mapping[Path, ClosedLoopRecord]) -> Picture | None:
    """The stills of the first record that has them in its directory."""
    for path, record in records.items():
        caption = (f"The robot controlled with {record.provenance.get('model', 'model')}, with the path of its tip so "
                   "far; pale: the robot at rest.")
        if found := _stored_pictures(path, [("robot", caption, "5 instants of 1 run", "mm")]):
            return found[0]
    return None


def _stored_pictures(path: Path, pictures: Sequence[tuple[str, str, str, str]]) -> list[Picture]:
    """The pictures (name, caption, count, unit) whose files are in the same directory."""
    return [Picture(path.with_name(f"{name}.svg"), *texts) for name, *texts in pictures
            if path.with_name(f"{name}.svg").is_file()]


def _first_of(shown: int, number: int, what: str) -> list[str]:
    return [f"The figures show the first {shown} of {number} {what}."] if number > shown else []


def _error(split: str, scores: Mapping[str, float | None]) -> str:
    """Text with the mean error of a split; an error that is not finite is stored as null."""
    mean, diverged = scores[f"{split}/rmse"], scores.get(f"{split}/diverged")
    if mean is not None:
        return f"{split} {1e3 * mean:.4g} mm"
    return f"{split} not finite" + ("" if diverged is None else f" ({100 * diverged:.3g} % of the rollouts diverged)")


def _times(factor: float, value: float | None) -> float | None:
    return None if value is None else factor * value
