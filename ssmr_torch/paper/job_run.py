"""One job of the reproduction, done by the commands of the package in the process that an executor gives it."""

from __future__ import annotations

import os
import shutil
import time
import traceback
from collections.abc import Sequence
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

from ssmr_torch import command
from ssmr_torch.configuration import composed
from ssmr_torch.paper.jobs import Job, Step, quoted

# Results appear at once and are moved into place at the end; these two leave nothing half done by themselves.
IN_PLACE = {"collect": lambda target: target, "evaluate": lambda target: target.parent}


def perform(job: Job, root: str, turn: str, groups: Sequence[str] = ()) -> dict:
    """Do the steps of a job below root; what they print goes to root/jobs/NAME.log.

    turn: text of root/jobs/turn while the command that asked for the job still waits for it. groups: folders of
    --config-dir. Returns {"seconds", "cpu_seconds"}, or {"failed": a sentence}; no error leaves it.
    """
    place = Path(root)
    log = place / "jobs" / f"{job.name}.log"
    begun, busy = time.perf_counter(), time.process_time()
    try:
        _expected(place, turn)
        log.parent.mkdir(parents=True, exist_ok=True)
        with open(log, "w", buffering=1, encoding="utf-8") as text, redirect_stdout(text), redirect_stderr(text):
            _do(job, place, turn, groups)
    except (Exception, SystemExit) as error:
        return {"failed": _sentence(error, log)}
    return {"seconds": time.perf_counter() - begun, "cpu_seconds": time.process_time() - busy}


def _do(job: Job, root: Path, turn: str, groups: Sequence[str]) -> None:
    target, entry = root / job.name, job.steps[0].entry
    aside = root / "unfinished" / str(os.getpid()) / job.name
    place = IN_PLACE[entry](target) if entry in IN_PLACE else aside
    place.mkdir(parents=True, exist_ok=True)
    try:
        for step in job.steps:
            _follow(step, job, root, place, groups)
    except (Exception, SystemExit):
        traceback.print_exc()
        raise
    if place == aside:
        _expected(root, turn)
        shutil.rmtree(target, ignore_errors=True)
        target.parent.mkdir(parents=True, exist_ok=True)
        os.replace(aside, target)
    if not (root / job.product).is_file():
        raise FileNotFoundError(f"it left no {job.product}")


def _follow(step: Step, job: Job, root: Path, directory: Path, groups: Sequence[str]) -> None:
    """Start the step's command with a directory of its own; the open loops of many models are no command."""
    paths = {key: directory / path[2:] if path.startswith("./") else root / path for key, path in step.files.items()}
    overrides = [*step.overrides, *(f"{key}={quoted(str(path))}" for key, path in paths.items())]
    if step.entry == "evaluate":
        from ssmr_torch.paper.workspace_errors import write_open_loop_map

        artifacts = {Path(need).name: root / need / "artifact" for need in job.needs if need.startswith("models/")}
        config = composed(step.entry, overrides, config_dir=groups[0] if groups else None)
        return write_open_loop_map(config, directory / Path(job.name).name, artifacts)
    # with it Hydra hands errors on; without it, it prints them and ends the process
    os.environ["HYDRA_FULL_ERROR"] = "1"
    status = command.start(step.entry, [
        *overrides, f"hydra.run.dir={quoted(str(directory))}", "hydra.output_subdir=null",
        "hydra/job_logging=stdout", *(word for folder in groups for word in ("--config-dir", folder))])
    if status:
        raise RuntimeError(f"ssmr {step.entry} ended with status {status}")
    return None


def _expected(root: Path, turn: str) -> None:
    """Raises InterruptedError for a job that is asked for by a command which has ended, as in a queue of a cluster."""
    path = root / "jobs" / "turn"
    if not path.is_file() or path.read_text(encoding="utf-8") != turn:
        raise InterruptedError("the command that asked for this job has ended")


def _sentence(error: BaseException, log: Path) -> str:
    if isinstance(error, SystemExit):
        return str(error.code) if isinstance(error.code, str) else f"it ended with status {error.code}; see {log}"
    cause = error.__cause__ or error
    kind = "" if isinstance(cause, (ValueError, OSError)) else f"{type(cause).__name__}: "
    return f"{kind}{cause}"
