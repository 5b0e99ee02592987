"""executor=submitit: jobs of a Slurm cluster, or, without one, processes that submitit starts here."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import submitit

from ssmr_torch.checked_arguments import checked
from ssmr_torch.quantities import PATH, TEXT, WORKERS
from ssmr_torch.ranges import Number, OrNone, Whole


class SubmititJobs:
    """One job of the cluster for each job, with one CPU.

    workers: jobs at a time; the workflow asks for no more. cluster: slurm or local. folder: what submitit writes, on a
    file system that the nodes share. timeout_min: min. mem_gb: GB. partition: of Slurm; null for its default.
    """

    @checked(folder=PATH, workers=WORKERS, cluster=TEXT, timeout_min=Whole(1, 100_000), mem_gb=Number(0.1, 1e5, "GB"),
             partition=OrNone(TEXT))
    def __init__(self, folder: str, workers: int = 2, cluster: str = "slurm", timeout_min: int = 240,
                 mem_gb: float = 4, partition: str | None = None):
        if cluster not in ("slurm", "local"):
            raise ValueError(f"executor.cluster is {cluster!r}; expected slurm or local")
        self.workers = workers
        self._settings = {"cpus_per_task": 1, "timeout_min": timeout_min, "mem_gb": mem_gb}
        if partition is not None:
            self._settings["slurm_partition"] = partition
        self._where = (Path(folder), cluster)
        self._jobs: list[submitit.Job] = []

    def __enter__(self) -> SubmititJobs:
        return self

    def submit(self, function: Callable, *arguments) -> submitit.Job:
        """A job whose result() is function(*arguments), or raises what ended its process."""
        folder, cluster = self._where
        executor = submitit.AutoExecutor(folder=folder, cluster=cluster)
        executor.update_parameters(**self._settings)
        job = executor.submit(function, *arguments)
        self._jobs.append(job)
        return job

    def __exit__(self, *_) -> None:
        running = [job for job in self._jobs if not job.done(force_check=True)]
        for job in running:
            job.cancel()
        for job in running:
            with suppress(Exception):
                job.wait()
