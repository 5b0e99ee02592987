"""What the workflow promises of jobs, whatever they do: jobs that only leave a file, done in this process."""

import threading
import time

import pytest

from ssmr_torch.paper import workflow
from ssmr_torch.paper.jobs import Job, Step
from ssmr_torch.paper.workflow import run, up_to_date

JOBS = [Job("data", "data/d.h5", (Step("collect", ("plant=trunk",)),)),
        Job("models/a b", "models/a b/card.json", (Step("train", ("model=ssmr",)), Step("export")), ("data",)),
        Job("models/c", "models/c/card.json", (Step("train", ("model=dmd",)),), ("data",)),
        Job("scores", "scores/s.json", (Step("evaluate"),), ("models/a b", "models/c"), partial=True),
        Job("run", "run/m.json", (Step("control", ("seed=0",)),), ("models/c",))]
NAMES = [job.name for job in JOBS]


class Work:
    """Does jobs by leaving their products; `done` are their names, `failing` those that fail."""

    def __init__(self, directory):
        self.directory, self.done, self.failing = directory, [], {}
        (directory / "jobs").mkdir()

    def __call__(self, job: Job) -> dict:
        if job.name in self.failing:
            return {"failed": self.failing[job.name]}
        (self.directory / job.product).parent.mkdir(parents=True, exist_ok=True)
        (self.directory / job.product).touch()
        self.done.append(job.name)
        return {"at": time.perf_counter_ns()}

    def again(self, jobs=JOBS, **options) -> tuple[list[str], list[str]]:
        """Names of the jobs that were done now, and what was said of the others."""
        self.done = []
        said = run(jobs, self.directory, self, **options)
        return self.done, said


@pytest.fixture
def work(tmp_path, monkeypatch):
    monkeypatch.setattr(workflow, "configuration", lambda entry, overrides: f"{entry} {' '.join(overrides)}")
    return Work(tmp_path)


def test_each_job_is_done_once_after_what_it_needs(work):
    assert work.again() == (NAMES, [])
    assert work.again() == ([], [])


def test_what_has_changed_is_done_again_with_all_that_needs_it(work):
    work.again()
    other = Job("models/c", "models/c/card.json", (Step("train", ("model=dmd", "model.delays=2")),), ("data",))
    assert work.again([*JOBS[:2], other, *JOBS[3:]])[0] == ["models/c", "scores", "run"]
    assert work.again(JOBS)[0] == ["models/c", "scores", "run"]


def test_a_product_that_is_gone_is_made_again(work):
    work.again()
    (work.directory / "data/d.h5").unlink()
    assert work.again()[0] == NAMES


def test_a_failure_stops_what_needs_it_alone_and_the_scores_are_made_of_what_there_is(work):
    work.failing = {"models/c": "no runs to train on"}
    done, said = work.again()
    assert done == ["data", "models/a b", "scores"]
    assert said == ["models/c: no runs to train on", "1 jobs were left out, as what they need failed: run …"]
    assert [job.name for job in up_to_date(JOBS, work.directory)] == ["data", "models/a b"]
    work.failing = {}
    assert work.again() == (["models/c", "scores", "run"], [])


def test_a_worker_that_dies_is_a_failure_of_its_job(work):
    def perform(job: Job) -> dict:
        if job.name == "models/c":
            raise RuntimeError("the process is gone")
        return work(job)

    assert run(JOBS, work.directory, perform)[0] == (
        "models/c: its process ended without a word: RuntimeError: the process is gone")


def test_what_was_done_before_the_command_was_killed_is_kept(work):
    """The notes are on the disk while the next job runs."""
    seen = []

    def perform(job: Job) -> dict:
        seen.append([each.name for each in up_to_date(JOBS, work.directory)])
        return work(job)

    run(JOBS, work.directory, perform)
    assert seen == [[], NAMES[:1], NAMES[:2], NAMES[:3], NAMES[:4]]


def test_two_workers_do_two_jobs_at_a_time_and_no_more(work):
    both, most, lock = threading.Barrier(2, timeout=10), [0], threading.Lock()

    def perform(job: Job) -> dict:
        with lock:
            most[0] += 1
            assert most[0] <= 2
        if job.name.startswith("models/"):
            both.wait()
        with lock:
            most[0] -= 1
        return work(job)

    assert not run(JOBS, work.directory, perform, workers=2)


def test_more_jobs_follow_from_what_is_done_and_no_failed_one_is_tried_twice(work):
    work.failing = {"models/c": "no runs to train on"}
    further = Job("slower", "slower/m.json", (Step("control"),), ("models/a b",))
    known = []

    def more(done: list[Job]) -> list[Job]:
        known.append([job.name for job in done])
        return [further]

    done, said = work.again(more=more)
    assert known == [["data", "models/a b"]] and done == ["data", "models/a b", "scores", "slower"]
    assert len(said) == 2
    assert further in up_to_date(JOBS, work.directory, more) and further not in up_to_date(JOBS, work.directory)


def test_what_depends_on_something_out_of_date_is_not_up_to_date(work):
    work.again()
    other = Job("data", "data/d.h5", (Step("collect", ("plant=diamond",)),))
    assert up_to_date([other, *JOBS[1:]], work.directory) == []
    assert up_to_date(JOBS, work.directory) == JOBS


def test_a_job_whose_need_is_not_planned_is_refused(work):
    with pytest.raises(ValueError, match="'models/c' does not exist"):
        run(JOBS[-1:], work.directory, work)
