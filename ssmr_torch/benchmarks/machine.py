"""What a benchmark ran on: processor, load, threads, and versions of what is measured."""

from __future__ import annotations

import os
import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

LIBRARIES = ("numpy", "scipy", "numba", "proxsuite", "torch", "daqp", "qpsolvers", "casadi", "clarabel", "osqp", "piqp",
             "quadprog")
THREADS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")


def one_thread() -> None:
    """One thread for all libraries, unless the environment says otherwise; before any of them is imported."""
    for name in THREADS:
        os.environ.setdefault(name, "1")


def machine() -> dict:
    """Plain values: processor, cores, load (mean number of running processes in the last minute; None where the system
    does not tell), threads, Python, versions of the installed ones of `LIBRARIES`.
    """
    return {"processor": processor(), "cores": os.cpu_count(), "load": load(),
            "threads": os.environ.get("OMP_NUM_THREADS", "unset"), "python": platform.python_version(),
            "versions": {name: found for name in LIBRARIES if (found := _version(name)) is not None}}


def in_words(found: dict) -> str:
    """`machine` in one line.

    >>> in_words({"processor": "x86_64", "cores": 2, "load": 0.5, "threads": "1", "python": "3.11.2",
    ...           "versions": {"numpy": "2.4.6"}})
    'x86_64, 2 cores, load 0.5, OMP_NUM_THREADS=1, Python 3.11.2, numpy 2.4.6'
    """
    load = "" if found["load"] is None else f"load {found['load']:.1f}, "
    versions = "".join(f", {name} {number}" for name, number in found["versions"].items())
    return (f"{found['processor']}, {found['cores']} cores, {load}OMP_NUM_THREADS={found['threads']}, "
            f"Python {found['python']}{versions}")


def load() -> float | None:
    """Running processes, mean over the last minute."""
    return round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else None


def processor() -> str:
    """The processor's name, or its architecture where the system does not tell."""
    information = Path("/proc/cpuinfo")
    lines = information.read_text(encoding="utf-8", errors="replace").splitlines() if information.is_file() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def _version(library: str) -> str | None:
    try:
        return version(library)
    except PackageNotFoundError:
        return None
