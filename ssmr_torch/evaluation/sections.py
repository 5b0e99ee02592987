"""The report's sections, made from what runs of the line left in their directories."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ssmr_torch.closed_loop import ClosedLoopRecord
from ssmr_torch.evaluation import figures
from ssmr_torch.evaluation.metrics import closed_loop_metrics
from ssmr_torch.evaluation.open_loop import OpenLoopScore
from ssmr_torch.evaluation.report import Picture, Section, Table
from ssmr_torch.evaluation.rollouts import predict_trajectory


def prediction_figures(models: Mapping[str, object], scores: Mapping[str, OpenLoopScore], runs: Sequence,
                       output_names: Sequence[str], outputs: Sequence[int], shown: float = 4.0) -> dict:
    """Error over the horizon, and the first `shown` s of each model's rollout over the longest controlled run."""
    horizons = np.array([part.duration for part in next(iter(scores.values())).horizons[:-1]])
    errors = {name: np.array([part.mean for part in score.horizons[:-1]]) for name, score in scores.items()}
    run = max(runs, key=lambda trajectory: (trajectory.kind == "controlled", trajectory.length))
    run = run.part(0, min(run.length, max(round(shown / run.timestep), 3 + max(m.delays for m in models.values()))))
    run = run.read()
    predicted = {}
    for name, model in models.items():
        time, states = predict_trajectory(model, run)
        predicted[name] = (time, states[:, outputs])
    overlay = figures.prediction(run.time, run.observation[:, outputs], predicted, [output_names[i] for i in outputs])
    return {"error_over_horizon": figures.error_over_horizon(horizons, errors), "prediction": overlay}


def training_figures(report: Mapping[str, Mapping]) -> dict:
    """Singular values and eigenvalues of the fits that found them."""
    drawn = {}
    for fit in report.values():
        if "singular_values" in fit:
            drawn["singular_values"] = figures.singular_values(np.array(fit["singular_values"]), fit["state_dim"])
    spectra = {step.replace("_", " "): np.array(fit["eigenvalues"]) @ np.array([1.0, 1.0j])
               for step, fit in report.items() if "eigenvalues" in fit}
    if spectra:
        drawn["eigenvalues"] = figures.eigenvalues(spectra)
    return drawn


def collect_sections(directory: str | Path) -> list[Section]:
    """Closed-loop records, open-loop scores and training reports found below a directory, as sections.

    Raises ValueError when there are none.
    """
    directory = Path(directory)
    records = [ClosedLoopRecord.load(path) for path in sorted(directory.rglob("record.h5"))]
    scored = sorted(directory.rglob("scores.json"))
    trained = sorted(directory.rglob("report.json"))
    sections = [closed_loop_section(records)] if records else []
    sections += [open_loop_section(path) for path in scored]
    sections += [training_section(path) for path in trained]
    if not sections:
        raise ValueError(f"nothing to report below {directory}: no record.h5, scores.json or report.json; "
                         "run train.py, evaluate.py or control.py with hydra.run.dir below it")
    return sections


def closed_loop_section(records: Sequence[ClosedLoopRecord]) -> Section:
    """Tracking table and figures; the records share task and plant."""
    by_model = {record.provenance.get("model", f"model {i + 1}"): record for i, record in enumerate(records)}
    first = records[0]
    task, plant, noise = (first.provenance[key] for key in ("task", "plant", "noise_std"))
    rows = []
    for name, record in by_model.items():
        values = closed_loop_metrics(record)
        rows.append([name, 1e6 * values["ise"], 1e3 * values["rmse"], 1e3 * values["max_error"],
                     1e3 * values["solve_time_median"], 1e3 * values["solve_time_p99"], int(values["fallbacks"])])
    period = first.provenance["period"]
    planar = len(first.tracked) == 2
    count = f"{len(first.time)} samples of one run per model"
    parts = [f"Task: {task}, {first.time[-1]:.1f} s, on the plant {plant}, measured with white noise of "
             f"{1e3 * noise:.3g} mm. The controller runs the exported artifact and plans every {1e3 * period:g} ms. "
             "Errors count from 1 s on; ISE is the sum of squared errors over the samples.",
             Table(["model", "ISE (mm²)", "RMSE (mm)", "max (mm)", "solve (ms)", "99 % (ms)", "fallbacks"], rows,
                   "Tracking in closed loop: errors, median and 99 % solve time, fallbacks.")]
    if planar:
        names = tuple(first.output_names[i] for i in first.tracked)
        paths = {name: record.observation[:, list(record.tracked)] for name, record in by_model.items()}
        parts.append(Picture(figures.tracking(first.time, first.reference, paths, names),
                             "Path in the task's plane, and tracking error.", count, "mm"))
    bounds = np.array(first.provenance["input_bounds"])
    parts.append(Picture(figures.inputs(first.time, {n: r.input for n, r in by_model.items()}, bounds,
                                        first.input_names, first.input_unit), "Inputs and their bounds.", count,
                         first.input_unit if first.input_unit != "1" else "share of full command"))
    times = {name: record.solve_time[np.isfinite(record.solve_time)] for name, record in by_model.items()}
    parts.append(Picture(figures.solve_times(times, period), "Time in the controller at each control step.",
                         f"{len(next(iter(times.values())))} steps per model", "ms"))
    return Section("Closed loop", parts)


def open_loop_section(path: Path) -> Section:
    """Table and figures of one evaluation."""
    stored = json.loads(path.read_text())
    scores = stored["scores"]
    horizons = next(iter(scores.values()))["horizons"]
    rows = []
    for name, score in scores.items():
        means = [None if part["mean"] is None else 1e3 * part["mean"] for part in score["horizons"]]
        rows.append([name, *means, 100 * max(part["diverged"] for part in score["horizons"])])
    settings = stored["provenance"]["configuration"]
    text = (f"Root mean square error of rollouts from measured starts, without correction, on the "
            f"{settings['split'] or 'whole'} set; the starts are the same for every model and never cross two runs. "
            "Only predicted samples count; a mean that holds a diverged rollout is not shown.")
    header = ["model", *(f"{part['label']} (mm)" for part in horizons), "diverged (%)"]
    parts = [text, Table(header, rows, "Mean open-loop error over the horizon.")]
    captions = {"error_over_horizon": "Mean error over the horizon.",
                "prediction": "A rollout from one start, beside the measurement."}
    counts = {"error_over_horizon": f"{horizons[0]['starts']} starts", "prediction": "1 run"}
    parts += [Picture(path.with_name(f"{name}.svg"), caption, counts[name], "mm")
              for name, caption in captions.items() if path.with_name(f"{name}.svg").is_file()]
    return Section("Open loop", parts)


def training_section(path: Path) -> Section:
    """What one fit found: scores, regressions, warnings, singular values, eigenvalues."""
    stored = json.loads(path.read_text())
    name = stored["provenance"]["name"]
    fits = {key: value for key, value in stored.items() if key not in ("scores", "provenance")}
    rows = [[f"{fit}: {regression}".replace("_", " "), values["rows"], values["features"], values["condition"],
             values["ridge"], 100 * values["relative_residual"]]
            for fit, report in fits.items() for regression, values in report["regressions"].items()]
    scores = "; ".join(f"{key.removesuffix('/rmse')} {1e3 * value:.4g} mm" for key, value in stored["scores"].items()
                       if key.endswith("/rmse") and value is not None)
    notes = [f"Look here: {warning}" for report in fits.values() for warning in report["warnings"]]
    parts = [f"Open-loop error over the validation horizon: {scores or 'none scored'}.", *notes]
    if rows:
        parts.append(Table(["regression", "rows", "features", "condition", "ridge", "residual (%)"], rows,
                           "What determined the model."))
    for file, caption, unit in (("singular_values", "Singular values of the decays' windows over the first.", "1"),
                                ("eigenvalues", "Eigenvalues of the reduced dynamics at rest.", "1/s")):
        if path.with_name(f"{file}.svg").is_file():
            decays = next(iter(fits.values()))["trajectories"]["decay"]
            parts.append(Picture(path.with_name(f"{file}.svg"), caption, f"{decays} decays", unit))
    return Section(f"Training: {name}", parts)
