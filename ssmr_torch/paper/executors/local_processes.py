"""executor=local: processes of this machine, by Python alone; workers=1 is one process."""

from __future__ import annotations

import multiprocessing
import os
import threading
from collections.abc import Callable
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool

from ssmr_torch.checked_arguments import checked
from ssmr_torch.paper.executors.worker_process import begin
from ssmr_torch.quantities import WORKERS


class LocalProcesses:
    """A pool of processes. A process that dies takes the jobs that run beside it with it; the next ones get a new pool.

    workers: processes.
    """

    @checked(workers=WORKERS)
    def __init__(self, workers: int = 2):
        self.workers = workers
        self._lock = threading.Lock()

    def __enter__(self) -> LocalProcesses:
        self._pool = self._new_pool()
        return self

    def submit(self, function: Callable, *arguments) -> Future:
        """A future whose result() is function(*arguments), or raises what ended its process."""
        with self._lock:
            try:
                return self._pool.submit(function, *arguments)
            except BrokenProcessPool:
                self._pool = self._new_pool()
                return self._pool.submit(function, *arguments)

    def __exit__(self, *_) -> None:
        for process in multiprocessing.active_children():
            process.kill()
        self._pool.shutdown(cancel_futures=True)

    def _new_pool(self) -> ProcessPoolExecutor:
        return ProcessPoolExecutor(self.workers, multiprocessing.get_context("spawn"), begin, (os.getpid(),))
