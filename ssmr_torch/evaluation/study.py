"""Studies: scores of many trained models over a quantity that varies from job to job, or from test run to test run."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from ssmr_torch.evaluation.open_loop import HORIZONS, compare_open_loop

# column of a study, and of the metrics of a training
SCORES = {"50 ms": "rmse_50ms", "200 ms": "rmse_200ms", "1 s": "rmse"}
MARGIN = 0.2  # s before every start, enough for the windows of every model


def score_runs(name: str, model, runs: Sequence, training: Sequence, *, starts: int = 500, seed: int = 0,
               outputs: Sequence[int] | None = None) -> list[dict]:
    """Scores of a model and of persistence on each run by itself, and how far the run leaves the training data.

    runs, training: trajectories; outputs: the scored columns, default all. Rows of "model", "run"; "amplitude" and
    "speed": rms of ‖y‖ and of ‖dy/dt‖ over the run, divided by those over the training; "50 ms", "200 ms", "1 s": mean
    error over the horizon, m, None where a rollout diverged; "diverged": the share of those over 1 s.
    Starts lie 0.2 s or more after the beginning of a run, the same ones for every model whose window is not longer.
    """
    if not runs:
        return []
    runs, known = [run.read() for run in runs], _motion([run.read() for run in training], outputs)
    rows = []
    for run in runs:
        amplitude, speed = np.array(_motion([run], outputs)) / known
        scores = compare_open_loop({name: model}, [run], horizons=HORIZONS, starts=starts, seed=seed, outputs=outputs,
                                   margin=round(MARGIN / run.timestep))
        for scored in (name, "persistence"):
            parts = {label: scores[scored][label].as_dict() for label in SCORES}
            rows.append({"model": scored, "run": run.name, "amplitude": float(amplitude), "speed": float(speed)}
                        | {label: part["mean"] for label, part in parts.items()}
                        | {"diverged": parts["1 s"]["diverged"]})
    return rows


def study_rows(results: Iterable[Mapping], axis: str) -> list[dict]:
    """One row per point of a study, from the jobs' results: "model", the axis, "50 ms", "200 ms", "1 s" (m).

    results: {"name", "overrides", "metrics", "runs"} of each job. axis: the key of an override, which the metrics
    belong to (those of the test runs, or of validation where nothing was tested), or a column of `score_runs`; every
    baseline is kept once.
    """
    rows = []
    for result in results:
        if "failed" in result["metrics"]:
            continue
        if result.get("runs"):
            rows += [{"model": row["model"], axis: row[axis]} | row for row in result["runs"]]
            continue
        given = dict(override.lstrip("+").partition("=")[::2] for override in result["overrides"])
        if axis in given:
            metrics = result["metrics"]
            part = "test" if "test/rmse" in metrics else "validation"
            rows.append({"model": result["name"], axis: float(given[axis])}
                        | {label: metrics.get(f"{part}/{column}") for label, column in SCORES.items()}
                        | {"diverged": metrics.get(f"{part}/diverged")})
    kept = {(row["model"], row[axis]): row for row in rows if row["model"] == "persistence"}
    rows = [*kept.values(), *(row for row in rows if row["model"] != "persistence")]
    return sorted(rows, key=lambda row: (row["model"], row[axis]))


def _motion(runs: Sequence, outputs: Sequence[int] | None) -> tuple[float, float]:
    """Rms of ‖y‖ (m) and of ‖dy/dt‖ (m/s) over all samples."""
    columns = slice(None) if outputs is None else list(outputs)
    seen = [run.observation[:, columns] for run in runs]
    rates = [np.diff(observation, axis=0) / run.timestep for observation, run in zip(seen, runs)]
    return tuple(float(np.sqrt((np.concatenate(rows) ** 2).sum(axis=1).mean())) for rows in (seen, rates))
