"""executor=ray: tasks of a Ray cluster, or of a Ray on this machine."""

from __future__ import annotations

import logging
import os
import signal
from collections.abc import Callable
from concurrent.futures import Future

import ray

from ssmr_torch.checked_arguments import checked
from ssmr_torch.paper.executors.worker_process import SINGLE
from ssmr_torch.quantities import TEXT, WORKERS
from ssmr_torch.ranges import OrNone


class RayTasks:
    """One task with one CPU for each job.

    workers: jobs at a time, and CPUs of a Ray that is started here. address: of a running cluster ("auto",
    "ray://HOST:10001"), whose nodes share the file system and have the package; null starts a Ray on this machine,
    which ends with the command.
    """

    @checked(workers=WORKERS, address=OrNone(TEXT))
    def __init__(self, workers: int = 2, address: str | None = None):
        self.workers = workers
        self._cluster = {"num_cpus": workers, "include_dashboard": False} if address is None else {
            "address": address, "runtime_env": {"env_vars": SINGLE}}
        self._running: dict[int, ray.ObjectRef] = {}

    def __enter__(self) -> RayTasks:
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        before = signal.getsignal(signal.SIGTERM)
        ray.init(**self._cluster, log_to_driver=False, logging_level=logging.CRITICAL)
        signal.signal(signal.SIGTERM, before)  # Ray has put its own in place
        return self

    def submit(self, function: Callable, *arguments) -> Future:
        """A future whose result() is function(*arguments), or raises what ended its process."""
        task = ray.remote(num_cpus=1, max_retries=0)(_call).remote(function, *arguments)
        future = task.future()
        self._running[id(future)] = task
        future.add_done_callback(lambda done: self._running.pop(id(done), None))
        return future

    def __exit__(self, *_) -> None:
        while self._running:
            ray.cancel(self._running.popitem()[1], force=True)
        ray.shutdown()


def _call(function: Callable, *arguments):
    """Ray takes functions that are written in Python; this one calls any."""
    return function(*arguments)
