"""Running a plant through its plans, in this process or spread over several."""

from __future__ import annotations

import logging
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from ctypes import Array
from dataclasses import replace
from multiprocessing import get_context
from multiprocessing.connection import Connection
from multiprocessing.reduction import ForkingPickler
from multiprocessing.sharedctypes import RawArray
from threading import Thread

import numpy as np

from ssmr_torch.collection.recording_plans import RecordingPlan, naming
from ssmr_torch.plants.base import Plant
from ssmr_torch.trajectory import Trajectory

log = logging.getLogger(__name__)
REPORTED_EVERY = 50  # samples
POLLED_EVERY = 0.5  # s
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS",
           "VECLIB_MAXIMUM_THREADS", "NUMEXPR_NUM_THREADS", "NUMBA_NUM_THREADS")

Report = Callable[[int], None]
_worker: dict = {}  # in a worker process: the plant, and where it counts the samples of each plan


def record(plant: Plant, plan: RecordingPlan, seed: int, report: Report = lambda samples: None) -> Trajectory:
    """Run the plant from rest as planned; the result depends on plant, plan and seed, not on what ran before.

    report: called every `REPORTED_EVERY` samples, and at the end, with the number of samples so far.
    Raises ValueError that names the trajectory when plan and plant do not fit or the plant refuses to go on.
    """
    inputs = plan.signal(plant, seed)
    _, plant_seed, disturbing = plan.seeds(seed)
    with naming(plan):
        observation = _run(plant, inputs, int(plant_seed.generate_state(1)[0]), report)
    first = plan.first_sample(plant.timestep)
    observation, inputs = observation[first:], inputs[first:]
    noise = np.random.default_rng(disturbing).normal(0.0, plan.noise_std, observation.shape)
    return Trajectory(plant.timestep * np.arange(len(inputs)), observation + noise, inputs,
                      plan.kind, plan.split, plan.name)


def _run(plant: Plant, inputs: np.ndarray, seed: int, report: Report) -> np.ndarray:
    observation = np.empty((len(inputs), len(plant.output_names)))
    observation[0] = plant.reset(seed=seed)
    report(1)
    for k in range(len(inputs) - 1):
        try:
            observation[k + 1] = plant.step(inputs[k])
        except ValueError as error:
            raise ValueError(f"{error} (in the step from {k * plant.timestep:g} s after rest)") from error
        if (k + 2) % REPORTED_EVERY == 0:
            report(k + 2)
    report(len(inputs))
    return observation


def available_cores() -> int:
    """Of this process, which may be fewer than the machine has."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def record_all(plant: Plant, plans: Sequence[RecordingPlan], seed: int, workers: int,
               keep: Callable[[Trajectory], None], report: Report) -> None:
    """Record every plan and `keep` each trajectory as soon as it is finished, in any order.

    One worker is this process. report: called with the number of samples so far, all plans together.
    Raises the error of the first plan that fails, after keeping what is finished, and ChildProcessError when a
    worker process dies; no worker outlives the call, nor the process that called.
    """
    if workers > 1 and plans and _can_start_workers():
        return _record_in_workers(plant, plans, seed, workers, keep, report)
    before = 0
    for plan in plans:
        keep(record(plant, plan, seed, lambda samples: report(before + samples)))
        before += plan.samples(plant.timestep)


def _can_start_workers() -> bool:
    """Whether worker processes can share locks and memory here; one line in the log where they cannot."""
    try:
        get_context("spawn").Lock()
        RawArray("q", 1)
    except (OSError, ImportError, NotImplementedError) as error:  # such as a machine without /dev/shm
        log.warning("worker processes cannot share memory here (%s: %s); all is recorded in this process",
                    type(error).__name__, error)
        return False
    return True


def _record_in_workers(plant: Plant, plans: Sequence[RecordingPlan], seed: int, workers: int,
                       keep: Callable[[Trajectory], None], report: Report) -> None:
    plans = sorted(plans, key=lambda plan: plan.samples(plant.timestep), reverse=True)
    context = get_context("spawn")
    handed, counts = _handed_over(plant, plans), RawArray("q", len(plans))
    watched, leash = context.Pipe(duplex=False)
    pool = ProcessPoolExecutor(min(workers, len(plans)), context, _prepare, (handed, counts, watched))
    try:
        with _one_thread_each():
            waiting = {pool.submit(_record_here, index, plan, seed) for index, plan in enumerate(plans)}
        while waiting:
            done, waiting = wait(waiting, POLLED_EVERY, FIRST_COMPLETED)
            report(sum(counts))
            _keep(done, keep)
    except BaseException as error:
        leash.close()  # ends the workers at once, whatever they are doing
        if isinstance(error, BrokenProcessPool):
            raise ChildProcessError(_last_words(plant, plans, counts)) from error
        raise
    finally:
        pool.shutdown(cancel_futures=True)
        leash.close()
        watched.close()


def _keep(done: set[Future], keep: Callable[[Trajectory], None]) -> None:
    """Keep what is finished, then raise the first error."""
    errors = [future.exception() for future in done if future.exception()]
    for future in done:
        if not future.exception():
            keep(replace(future.result()))  # a copy: arrays from another process have lost their write protection
    if errors:
        raise errors[0]


def _last_words(plant: Plant, plans: Sequence[RecordingPlan], counts: Sequence[int]) -> str:
    running = [plan.name for plan, count in zip(plans, counts) if 0 < count < plan.samples(plant.timestep)]
    where = f"while these were recorded: {', '.join(running)}" if running else "before it recorded anything"
    return (f"a worker process died {where}; it was killed, ran out of memory, crashed, or could not import the "
            "plant or the script that started it (a script starts workers under if __name__ == \"__main__\")")


def _handed_over(plant: Plant, plans: Sequence[RecordingPlan]) -> Array:
    """The plant in memory that the workers share: through their pipes they would have to start one by one."""
    try:
        for thing in {id(plan.excitation): plan.excitation for plan in plans}.values():
            ForkingPickler.dumps(thing)
        thing = plant
        pickled = ForkingPickler.dumps(plant)
    except Exception as error:
        raise ValueError(f"{type(thing).__name__} cannot be handed to worker processes ({error}); make it picklable "
                         "(no open files, handles or lambdas; or __getstate__ leaves them out), or record with "
                         "workers=1") from error
    handed = RawArray("B", len(pickled))
    memoryview(handed).cast("B")[:] = pickled
    return handed


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Processes started inside compute with one thread: the libraries read these variables when they are loaded."""
    before = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(dict.fromkeys(THREADS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name) if value is None else os.environ.update({name: value})


def _prepare(handed: Array, counts: Array, watched: Connection) -> None:
    """Begin a worker: Ctrl-C is left to the process that started it, whose end is this one's, too."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    Thread(target=_end_with, args=(watched,), daemon=True).start()
    _worker.update(plant=ForkingPickler.loads(memoryview(handed).cast("B")), counts=counts)


def _end_with(watched: Connection) -> None:
    try:
        watched.recv_bytes()
    except (EOFError, OSError):
        os._exit(1)


def _record_here(index: int, plan: RecordingPlan, seed: int) -> Trajectory:
    def report(samples: int) -> None:
        _worker["counts"][index] = samples

    return record(_worker["plant"], plan, seed, report)
