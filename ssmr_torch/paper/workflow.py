"""Jobs on doit: those that are up to date are left, a failure stops only what needs it, every success is noted at once.

A job is up to date while the composed configurations of its steps are what they were, no job that it needs was done
again, and its product is there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from doit.control import TaskControl
from doit.dependency import Dependency, JsonDB
from doit.exceptions import InvalidTask, TaskFailed, UnmetDependency
from doit.runner import MThreadRunner
from doit.task import Task, result_dep
from doit.tools import config_changed
from tqdm import tqdm

from ssmr_torch.paper.job_configuration import configuration
from ssmr_torch.paper.jobs import Job
from ssmr_torch.result_files import save_text


class Notes(JsonDB):
    """doit's notes of what was done, in a file that is never half written."""

    def dump(self) -> None:
        save_text(Path(self.name), self.codec.encode(self._db))


class Runner(MThreadRunner):
    """doit's runner in threads, each of which waits for one job."""

    def select_task(self, node, tasks_dict) -> bool:
        if node.task.meta["partial"]:
            node.bad_deps.clear()
        return super().select_task(node, tasks_dict)

    def process_task_result(self, node, base_fail) -> None:
        super().process_task_result(node, base_fail)
        self.dep_manager.backend.dump()  # doit writes them at the end alone, which a killed command does not reach


class Progress:
    """What doit tells while it runs: a bar, and a sentence for every job that failed or was left out."""

    def __init__(self, names: Sequence[str]):
        self.names = set(names)
        self.bar = tqdm(total=len(self.names), desc="reproduce", unit=" jobs", smoothing=0)
        self.failed: list[str] = []
        self.left_out: list[str] = []

    def execute_task(self, task) -> None:
        self.bar.set_postfix_str(task.name)

    def skip_uptodate(self, task) -> None:
        self.bar.update(task.name in self.names)

    def add_success(self, task) -> None:
        self.bar.update(task.name in self.names)

    def add_failure(self, task, fail) -> None:
        self.bar.update(task.name in self.names)
        if isinstance(fail, UnmetDependency):
            self.left_out.append(task.name)
        else:
            self.failed.append(f"{task.name}: {fail.message}")
            self.bar.write(f"{task.name} failed: {fail.message}")

    def runtime_error(self, message: str) -> None:
        raise ValueError(message)

    def complete_run(self) -> None:
        self.bar.close()

    def sentences(self) -> list[str]:
        few = f"{len(self.left_out)} jobs were left out, as what they need failed: {', '.join(self.left_out[:1])} …"
        return [*self.failed, *([few] if self.left_out else [])]

    def get_status(self, task) -> None:
        """Nothing is said while doit looks whether a task is up to date."""


def run(jobs: Sequence[Job], directory: Path, perform: Callable[[Job], dict], *, workers: int = 1,
        more: Callable[[list[Job]], list[Job]] = lambda done: []) -> list[str]:
    """Do what is not up to date; a sentence for each job that failed, and one for those that were left out.

    jobs: with all that they need. perform: does one job, from a thread, and returns {"failed": a sentence} or what is
    noted of it. workers: jobs at a time. more: further jobs, from those that are then up to date.
    Raises ValueError for a job that needs one which is not among the jobs.
    """
    failures = _dispatch(jobs, jobs, directory, perform, workers)
    further = more(up_to_date(jobs, directory))
    return failures + (_dispatch([*jobs, *further], further, directory, perform, workers) if further else [])


def _dispatch(jobs: Sequence[Job], asked: Sequence[Job], directory: Path, perform: Callable, workers: int) -> list[str]:
    names = [job.name for job in asked]
    try:
        control = TaskControl(_tasks(jobs, directory, perform))
    except InvalidTask as error:
        raise ValueError(str(error)) from error
    control.process(names)
    progress = Progress(names)
    Runner(_notes(directory), progress, continue_=True, num_process=workers).run_all(control.task_dispatcher())
    return progress.sentences()


def up_to_date(jobs: Sequence[Job], directory: Path,
               more: Callable[[list[Job]], list[Job]] = lambda done: []) -> list[Job]:
    """Those whose product is there and is what they would make again, and of `more` as in `run`.

    jobs: each after all that it needs.
    """
    notes, tasks = _notes(directory), {task.name: task for task in _tasks(jobs, directory, lambda job: {})}
    done: dict[str, Job] = {}
    for job in jobs:
        if done.keys() >= set(job.needs) and notes.get_status(tasks[job.name], tasks).status == "up-to-date":
            done[job.name] = job
    further = more(list(done.values()))
    return up_to_date([*jobs, *further], directory) if further else list(done.values())


def _notes(directory: Path) -> Dependency:
    return Dependency(Notes, str(directory / "jobs" / "done.json"))


def _tasks(jobs: Sequence[Job], directory: Path, perform: Callable[[Job], dict]) -> list[Task]:
    def act(job: Job):
        try:
            found = perform(job)
        except Exception as error:  # what ends a worker comes from the executor's library
            found = {"failed": f"its process ended without a word: {type(error).__name__}: {error}"}
        return TaskFailed(found["failed"]) if "failed" in found else found

    return [Task(job.name, [(act, [job])], targets=[directory / job.product], io={"capture": False},
                 meta={"partial": job.partial}, uptodate=[
                     config_changed({"steps": [[step.entry, configuration(step.entry, step.overrides),
                                                dict(step.files)] for step in job.steps]}),
                     *map(result_dep, job.needs)]) for job in jobs]
