"""executor=ray: tasks of a Ray cluster, or of a Ray on this machine."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future

import ray

from ssmr_torch.paper.executors.worker_process import SINGLE


class RayTasks:
    """One task with one CPU for each job.

    workers: CPUs of a Ray that is started on this machine. address: of a running cluster ("auto", "ray://HOST:10001"),
    whose nodes share the file system and have the package; null starts one here, which ends with the command.
    """

    def __init__(self, workers: int = 2, address: str | None = None):
        own = {"num_cpus": workers, "include_dashboard": False} if address is None else {}
        self._arguments = own | {"address": address, "log_to_driver": False, "logging_level": "warning",
                                 "runtime_env": {"env_vars": SINGLE}}
        self._running: dict[int, ray.ObjectRef] = {}

    def submit(self, function: Callable, *arguments) -> Future:
        """A future whose result() is function(*arguments), or raises what ended its process."""
        if not ray.is_initialized():
            ray.init(**self._arguments)
        task = ray.remote(num_cpus=1, max_retries=0)(function).remote(*arguments)
        future = task.future()
        self._running[id(future)] = task
        future.add_done_callback(lambda done: self._running.pop(id(done), None))
        return future

    def close(self) -> None:
        """End what still runs, and the Ray that was started here."""
        if ray.is_initialized():
            for task in list(self._running.values()):
                ray.cancel(task, force=True)
            ray.shutdown()
