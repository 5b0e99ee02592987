"""runs.csv and models.csv: every closed loop and every model of a reproduction that is up to date."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

from ssmr_torch.paper.jobs import Job
from ssmr_torch.paper.result_rows import model_row, note_of, run_row
from ssmr_torch.result_files import save_csv


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


def read_json(path: Path) -> dict:
    return json.loads(path.read_text())


def _model(directory: Path, settings: Mapping, job: Job) -> dict:
    report = read_json(directory / job.name / "report.json")
    note = note_of(report)
    if own := settings["robots"][job.about["robot"]].get("train", {}).get(job.about["method"]):
        note = " ".join([f"Set by the preset: {' '.join(own)}.", *([f"The rest: {note}"] if note else [])])
    return model_row(job.about, report["cost"], read_json(directory / job.product)["model"], note)
