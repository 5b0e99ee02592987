"""Everything of the paper, from data to report: the plan on the workflow, then the tables, then the report."""

from __future__ import annotations

import fcntl
import os
import shutil
import signal
import sys
import uuid
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path

from ssmr_torch.paper import workflow
from ssmr_torch.paper.executors.worker_process import SINGLE
from ssmr_torch.paper.job_run import perform
from ssmr_torch.paper.jobs import Job, chosen, plan, slower_runs, with_recordings
from ssmr_torch.paper.report_sections import report_sections
from ssmr_torch.paper.result_tables import solve_times, write_tables
from ssmr_torch.provenance import provenance
from ssmr_torch.report.html_page import write_report

TITLE = "Discovering dominant dynamics for nonlinear continuum robot control: what comes out"


def reproduce(settings: Mapping, figures: str | Sequence[str], directory: Path, executor, *,
              recordings: str | None = None, groups: Sequence[str] = ()) -> tuple[Path, list[str]]:
    """Do what is missing below directory; the path of report.html, and a sentence for every job that failed.

    settings: a preset (conf/preset), plain. figures: all, or names. executor: one of paper/executors.
    recordings: folder of the paper's recordings of the real robot. groups: folders of --config-dir.
    Raises ValueError, before any work, for a figure, robot or method that the settings do not have, a package that is
    not installed, recordings that are no folder, and a directory in which another command works.
    """
    settings = with_recordings(settings, _folder(recordings))
    shown, jobs = chosen(settings, figures), plan(settings, figures)
    for module, install in settings.get("needs", {}).items():
        if find_spec(module) is None:
            raise ValueError(f"{module} is not installed: {install}")
    os.environ.update(SINGLE)
    with _alone_in(directory) as turn, _ended_by_signals(), executor:
        def done(job: Job) -> dict:
            return executor.submit(perform, job, str(directory), turn, groups).result()

        failures = workflow.run(jobs, directory, done, workers=executor.workers)
        slower = _slower(settings, jobs, directory)
        failures += workflow.run([*jobs, *slower], directory, done, workers=executor.workers,
                                 only=[job.name for job in slower]) if slower else []
        everything = plan(settings)
        everything += _slower(settings, everything, directory)
        write_tables(directory, settings, workflow.up_to_date(everything, directory))
        origin = {name: str(value) for name, value in provenance().items()}
        return write_report(directory, TITLE, report_sections(directory, shown), origin), failures


def _slower(settings: Mapping, jobs: Sequence[Job], directory: Path) -> list[Job]:
    """The closed loops that are to be run once more at a longer period."""
    runs = workflow.up_to_date(jobs, directory)
    return slower_runs(settings, [job for job in runs if "period" in job.about], solve_times(directory, runs))


def _folder(recordings: str | None) -> str | None:
    """Its absolute path, which jobs read from wherever they run."""
    if recordings is None:
        return None
    found = Path(recordings).expanduser().resolve()
    if not found.is_dir():
        raise ValueError(f"recordings={recordings} is no folder; expected the one with decays.mat and "
                         "controlled_2022.mat of the real robot, or null to leave it out")
    return str(found)


@contextmanager
def _alone_in(directory: Path) -> Iterator[str]:
    """One command at a time below a directory; what is left of an interrupted one is removed.

    Yields this command's turn: jobs of an earlier one that still wait in a cluster's queue see that theirs is over.
    """
    jobs = directory / "jobs"
    jobs.mkdir(parents=True, exist_ok=True)
    with open(jobs / "lock", "w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise ValueError(f"another command works in {directory}; wait, or take another hydra.run.dir") from error
        turn = uuid.uuid4().hex
        (jobs / "turn.part").write_text(turn)
        os.replace(jobs / "turn.part", jobs / "turn")
        shutil.rmtree(directory / "unfinished", ignore_errors=True)
        try:
            yield turn
        finally:
            (jobs / "turn").unlink()
            for left in (directory / "unfinished", jobs / "submitit"):
                shutil.rmtree(left, ignore_errors=True)


@contextmanager
def _ended_by_signals() -> Iterator[None]:
    """SIGINT and SIGTERM end the command with a sentence, and its executor with it."""
    def end(*_):
        sys.exit("reproduce: ended by a signal; the same command goes on")

    before = {number: signal.signal(number, end) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
