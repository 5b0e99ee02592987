"""runs.csv and models.csv: every closed loop and every model of a reproduction that is up to date."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from ssmr_torch.found_settings import in_words
from ssmr_torch.paper.jobs import Job
from ssmr_torch.result_files import read_json, save_csv

RUN_COLUMNS = ("figure", "robot", "method", "task", "seed", "period", "real_time", "ise", "rmse", "max_error",
               "violation_ratio", "max_violation", "solve_median", "solve_p99", "fallbacks", "record")
MODEL_COLUMNS = ("robot", "method", "state_dim", "parameters", "decays", "controlled_samples", "fit_time", "timestep",
                 "delays", "command")


def write_tables(directory: Path, settings: Mapping, done: Sequence[Job]) -> None:
    """Both tables from what the jobs that are done have left."""
    runs = [run_row(job.about, read_json(directory / job.product), f"{job.name}/record.h5") for job in done
            if "period" in job.about]
    models = [_model(directory, settings, job) for job in done if "model" in job.about]
    save_csv(directory / "runs.csv", runs)
    save_csv(directory / "models.csv", models)


def solve_times(directory: Path, done: Sequence[Job]) -> dict[str, float]:
    """s, 99 % of the solve times by name of the closed loop."""
    return {job.name: read_json(directory / job.product)["solve_time_p99"] for job in done if "period" in job.about}


def _model(directory: Path, settings: Mapping, job: Job) -> dict:
    report = read_json(directory / job.name / "report.json")
    note = note_of(report)
    if own := settings["robots"][job.about["robot"]].get("train", {}).get(job.about["method"]):
        note = " ".join([f"Set by the preset: {' '.join(own)}.", *([f"The rest: {note}"] if note else [])])
    return model_row(job.about, report["cost"], read_json(directory / job.product)["model"], note)


def run_row(about: Mapping, metrics: Mapping[str, float | None], record: str) -> dict:
    """One closed loop, by `RUN_COLUMNS`: SI units; None for what does not exist or is not finite.

    about: figure, robot, method, task, seed, period (s) of the job. metrics: as `closed_loop_metrics` gives them.
    real_time: whether 99 % of the solve times fit into the period. record: path of the record.
    """
    p99 = metrics["solve_time_p99"]
    row = dict(about) | {"real_time": "true" if p99 is not None and p99 <= about["period"] else "false",
                         "solve_median": metrics["solve_time_median"], "solve_p99": p99, "record": record}
    row |= {name: metrics.get(name) for name in ("ise", "rmse", "max_error", "violation_ratio", "max_violation")}
    row["fallbacks"] = int(metrics["fallbacks"])
    return {name: _finite(row[name]) for name in RUN_COLUMNS}


def model_row(about: Mapping, cost: Mapping[str, float], model: Mapping[str, float], command: str) -> dict:
    """One model, by `MODEL_COLUMNS`; times in s.

    about: robot and method of the job. cost: as `cost_of` and the training give it. model: timestep and delays, as on
    an artifact's card. command: how its settings were found.
    """
    counts = {name: int(cost[name]) for name in ("state_dim", "parameters", "decays", "controlled_samples")}
    row = {"robot": about["robot"], "method": about["method"], **counts, "fit_time": cost["fit_time"],
           "timestep": model["timestep"], "delays": model["delays"], "command": command}
    return {name: _finite(row[name]) for name in MODEL_COLUMNS}


def note_of(report: Mapping) -> str:
    """How the settings of a training were found, from its report.json; empty where it took no found settings."""
    found = report["provenance"]["configuration"].get("found")
    return f"{in_words(found)}." if found else ""


def _finite(value):
    return None if isinstance(value, float) and not math.isfinite(value) else value
