"""Everything of the paper, from data to report: the plan on the workflow, then the tables, then the report."""

from __future__ import annotations

import fcntl
import os
import shutil
import uuid
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path

from ssmr_torch.paper import workflow
from ssmr_torch.paper.executors.worker_process import SINGLE
from ssmr_torch.paper.job_run import perform
from ssmr_torch.paper.jobs import Job, Plan
from ssmr_torch.paper.report_sections import report_sections
from ssmr_torch.paper.result_tables import solve_times, write_tables
from ssmr_torch.provenance import provenance
from ssmr_torch.report.html_page import write_report
from ssmr_torch.result_files import save_text

TITLE = "Discovering dominant dynamics for nonlinear continuum robot control: what comes out"


def reproduce(plan: Plan, directory: Path, executor, groups: Sequence[str] = ()) -> list[str]:
    """Do what is missing below directory and write runs.csv and models.csv; a sentence for every job that failed.

    executor: one of paper/executors. groups: folders of --config-dir.
    Raises ValueError, before any work, for a package that is not installed, and for a directory in which another
    command works.
    """
    for module, install in plan.settings.get("needs", {}).items():
        if find_spec(module) is None:
            raise ValueError(f"{module} is not installed: {install}")
    os.environ.update(SINGLE)
    with _alone_in(directory) as turn, executor:
        def done(job: Job) -> dict:
            return executor.submit(perform, job, str(directory), turn, groups).result()

        def slower(known: list[Job]) -> list[Job]:
            return plan.slower(solve_times(directory, known))

        failures = workflow.run(plan.jobs, directory, done, workers=executor.workers, more=slower)
        write_tables(directory, plan.settings, workflow.up_to_date(plan.every, directory, slower))
    return failures


def report(directory: Path, figures: Sequence[str]) -> Path:
    """Write report.html of these figures from what lies in the directory; its path."""
    origin = {name: str(value) for name, value in provenance().items()}
    return write_report(directory, TITLE, report_sections(directory, figures), origin)


@contextmanager
def _alone_in(directory: Path) -> Iterator[str]:
    """One command at a time below a directory; what is left of an interrupted one is removed.

    Yields this command's turn: jobs of an earlier one that still wait in a cluster's queue see that theirs is over.
    """
    jobs = directory / "jobs"
    jobs.mkdir(parents=True, exist_ok=True)
    (jobs / "lock").touch()
    with open(jobs / "lock", "rb") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise ValueError(f"another command works in {directory}; wait, or take another hydra.run.dir") from error
        turn = uuid.uuid4().hex
        save_text(jobs / "turn", turn)
        shutil.rmtree(directory / "unfinished", ignore_errors=True)
        try:
            yield turn
        finally:
            (jobs / "turn").unlink()
            for left in (directory / "unfinished", jobs / "submitit"):
                shutil.rmtree(left, ignore_errors=True)
