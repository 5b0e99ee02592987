"""executor=joblib: processes of this machine, by joblib's loky."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import Future

from joblib.externals.loky import get_reusable_executor

from ssmr_torch.checked_arguments import checked
from ssmr_torch.paper.executors.worker_process import begin
from ssmr_torch.quantities import WORKERS


class JoblibProcesses:
    """joblib's reusable pool, which comes up again after a process has died.

    workers: processes.
    """

    @checked(workers=WORKERS)
    def __init__(self, workers: int = 2):
        self.workers = workers
        self._futures: list[Future] = []

    def __enter__(self) -> JoblibProcesses:
        return self

    def submit(self, function: Callable, *arguments) -> Future:
        """A future whose result() is function(*arguments), or raises what ended its process."""
        self._futures.append(self._pool().submit(function, *arguments))
        return self._futures[-1]

    def __exit__(self, *_) -> None:
        if self._futures:
            self._pool().shutdown(kill_workers=not all(future.done() for future in self._futures))

    def _pool(self):
        return get_reusable_executor(self.workers, timeout=None, initializer=begin, initargs=(os.getpid(),))
