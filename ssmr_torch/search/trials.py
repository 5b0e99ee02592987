"""A search by Optuna that goes on where it was, in any number of processes."""

from __future__ import annotations

import fcntl
import math
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from uuid import uuid4

import optuna
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend
from optuna.trial import FrozenTrial, TrialState

from ssmr_torch.search.space import overrides_of, space_of

optuna.logging.set_verbosity(optuna.logging.WARNING)
STUDY = "search"
CPU, WORKER, PLACE = "cpu_seconds", "worker", "place"  # attributes of a trial in the journal
OF_ONE_PROCESS = ("save_to=",)  # arguments that change nothing in the search itself


def cpu_seconds() -> float:
    """CPU time of this process and of those that it started and waited for, s."""
    return sum(os.times()[:4])


class Search:
    """Trials of Optuna in a directory, kept in its file search.journal.

    arguments: overrides, those with a range are searched, see `space_of`. sampler: makes a sampler of Optuna, called
    with its seed. A trial has the seed of the sampler plus the trial's place among those that were not interrupted:
    interrupted and resumed, one process tries what it would have tried at once. A trial whose process has ended before
    it is told as failed at the next start, and its values are tried again.
    Raises SystemExit where the directory holds a search with other arguments, or one of version 0.10 or older.
    """

    def __init__(self, directory: str | Path, arguments: Sequence[str], *, direction: str, sampler: Callable):
        self.directory, self.sampler, self.direction = Path(directory), sampler, direction
        self.space, self.fixed = space_of(arguments)
        self.seed = (getattr(sampler, "keywords", None) or {}).get("seed") or 0
        self.name = uuid4().hex
        if (self.directory / "study.db").exists():
            raise SystemExit(f"{self.directory} holds a search of version 0.10 or older (study.db), which this version "
                             "does not read; use another hydra.sweep.dir")
        self.directory.mkdir(parents=True, exist_ok=True)
        with self._alone():
            storage = JournalStorage(Journal(self.directory / "search.journal"))
            self.study = optuna.create_study(study_name=STUDY, storage=storage, direction=direction,
                                             load_if_exists=True)
            self._check_same(sorted(each for each in arguments if not each.startswith(OF_ONE_PROCESS)))

    def run(self, job: Callable[[int, list[str]], float], *, trials: int, minutes: float | None = None) -> None:
        """Call job(number, overrides) → score until so many trials are finished, those of other processes included.

        minutes: no further trial begins when the finished ones have taken so many CPU minutes together, of the
        processes that ran them with those that they started and waited for; so slow and fast models get the same
        effort, on a busy machine the same as on an idle one. None: no limit. Raises what job raises.
        """
        with self._at_work(), self._told_best():
            while len(finished := self.finished()) < trials:
                taken = sum(trial.user_attrs.get(CPU, 0.0) for trial in finished) / 60
                if minutes is not None and taken > minutes:
                    print(f"\nthe {minutes:g} CPU minutes are over after {len(finished)} trials")
                    break
                best = f", best so far {self.study.best_value:.4g}" if finished else ""
                print(f"\ntrial {len(finished) + 1} of {trials}{best}")
                self._try(job)

    def finished(self) -> list[FrozenTrial]:
        return self.study.get_trials(False, (TrialState.COMPLETE,))

    def _try(self, job: Callable[[int, list[str]], float]) -> None:
        trial, begun = self._ask(), cpu_seconds()
        try:
            score = float(job(trial.number, overrides_of(trial.params, self.fixed)))
        except (KeyboardInterrupt, SystemExit, OSError):
            with suppress(OSError), self._alone():  # on a full disk the next start does it
                self._try_again(self.study.get_trials(False)[trial.number])
            raise
        except Exception:
            self.study.tell(trial, state=TrialState.FAIL)
            raise
        trial.set_user_attr(CPU, cpu_seconds() - begun)
        worst = math.inf if self.direction == "minimize" else -math.inf
        self.study.tell(trial, worst if math.isnan(score) else score)

    def _ask(self) -> optuna.Trial:
        """The next trial, with values; by a sampler whose seed depends on the trial's place alone."""
        with self._alone():
            known = self.study.get_trials(False)
            waiting = [trial for trial in known if trial.state is TrialState.WAITING]
            place = waiting[0].user_attrs[PLACE] if waiting else sum(not _again(trial) for trial in known)
            self.study.sampler = self.sampler(seed=self.seed + place)
            trial = self.study.ask(self.space)
            trial.set_user_attr(WORKER, self.name)
            if not waiting:
                trial.set_user_attr(PLACE, place)
            return trial

    def _check_same(self, arguments: list[str]) -> None:
        begun = self.study.user_attrs.get("arguments", arguments)
        if begun != arguments:
            then, now = sorted(set(begun) - set(arguments)), sorted(set(arguments) - set(begun))
            raise SystemExit(f"the search in {self.directory} was begun with {then}, now it is {now}; use another "
                             "hydra.sweep.dir")
        self.study.set_user_attr("arguments", arguments)

    @contextmanager
    def _alone(self) -> Iterator[None]:
        """One process of this search at a time."""
        with _locked(self.directory / "search.lock", wait=True):
            yield

    @contextmanager
    def _at_work(self) -> Iterator[None]:
        """Hold the lock that tells other processes that this one lives; try again what ended with its process."""
        workers = self.directory / "workers"
        workers.mkdir(exist_ok=True)
        with _locked(workers / self.name, wait=False):
            with self._alone():
                for trial in self.study.get_trials(False, (TrialState.RUNNING,)):
                    if not _lives(workers / str(trial.user_attrs.get(WORKER))):
                        self._try_again(trial)
            try:
                yield
            finally:
                (workers / self.name).unlink()


    def _try_again(self, trial: FrozenTrial) -> None:
        """Tell a trial that was interrupted as failed, and have its values tried by the next one."""
        self.study.tell(trial.number, state=TrialState.FAIL)
        self.study.enqueue_trial(trial.params, {PLACE: trial.user_attrs.get(PLACE, trial.number),
                                                "again": trial.number})

    @contextmanager
    def _told_best(self) -> Iterator[None]:
        """Say the best trial where the search is interrupted."""
        try:
            yield
        except (KeyboardInterrupt, SystemExit, OSError):
            finished = self.finished()
            if finished:
                best = self.study.best_trial
                print(f"\nthe best of {len(finished)} finished trials is number {best.number} with {best.value:.4g}: "
                      f"{' '.join(overrides_of(best.params, {}))}", flush=True)
            raise


class Journal(JournalFileBackend):
    """Optuna's journal, from which an end at any moment takes only what was not written yet.

    A line that a full disk or a killed process has left incomplete is removed; its lock is free when its process ends.
    """

    def __init__(self, path: Path):
        self._path, self._lock_of_process = path, _JournalLock(path.with_name(f"{path.name}.lock"))
        super().__init__(str(path), self._lock_of_process)
        self._mend()

    def append_logs(self, logs: list[dict]) -> None:
        try:
            super().append_logs(logs)
        except BaseException:
            self._mend()
            raise

    def _mend(self) -> None:
        self._lock_of_process.acquire()
        try:
            os.truncate(self._path, self._path.read_bytes().rfind(b"\n") + 1)
        finally:
            self._lock_of_process.release()


class _JournalLock:  # with what `BaseJournalFileLock` of Optuna has
    def __init__(self, path: Path):
        self._path, self._handle = path, None

    def acquire(self) -> bool:
        handle = os.open(self._path, os.O_CREAT | os.O_RDWR)
        fcntl.flock(handle, fcntl.LOCK_EX)
        self._handle = handle
        return True

    def release(self) -> None:
        os.close(self._handle)
        self._handle = None


def _again(trial: FrozenTrial) -> bool:
    """Whether a trial repeats one that was interrupted."""
    return "again" in trial.user_attrs


def _lives(lock: Path) -> bool:
    """Whether the process that holds the lock still runs; its kernel lets go of the lock when it ends."""
    if not lock.exists():
        return False
    try:
        with _locked(lock, wait=False):
            lock.unlink()
            return False
    except BlockingIOError:
        return True


@contextmanager
def _locked(path: Path, *, wait: bool) -> Iterator[None]:
    handle = os.open(path, os.O_CREAT | os.O_RDWR)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        yield
    finally:
        os.close(handle)
