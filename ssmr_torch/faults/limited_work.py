"""Calls a function in a process of its own that is ended when it takes too long."""

from __future__ import annotations

import multiprocessing
import os
from multiprocessing.connection import Connection
from time import sleep as wait
from typing import Any

from ssmr_torch.lazy import found

try:
    import resource
except ImportError:  # Windows has no limits of this kind
    resource = None

MEMORY = 6 << 30  # bytes of a call


class TookTooLong(Exception):
    """The call was ended at its time limit."""


class ProcessEnded(Exception):
    """The process of the call is gone, such as after a crash of compiled code or for want of memory."""


def sleep(seconds: float) -> None:
    """Does nothing for so long; with it the time limit is tried."""
    wait(seconds)


def _serve(pipe: Connection) -> None:
    _limit_memory()
    while True:
        target, arguments = pipe.recv()
        if target is None:
            return
        try:
            pipe.send((True, found(target)(**arguments)))
        except Exception as error:  # whatever it is: the caller judges
            pipe.send((False, f"{type(error).__name__}: {error}"))


def _limit_memory() -> None:
    """A file that asks for everything shall not take it from other programs."""
    if resource is not None:
        _, highest = resource.getrlimit(resource.RLIMIT_DATA)
        limit = MEMORY if highest == resource.RLIM_INFINITY else min(MEMORY, highest)
        resource.setrlimit(resource.RLIMIT_DATA, (limit, highest))


class LimitedWork:
    """One process that answers calls one after another; after a call that took too long another process is started.

    Use it as a context manager; the process is ended with it.
    """

    def __init__(self):
        self._context = multiprocessing.get_context("spawn")
        self._process = self._pipe = None

    def __enter__(self) -> LimitedWork:
        return self

    def __exit__(self, *error) -> None:
        self._end()

    def call(self, target: str, limit: float, **arguments: Any) -> tuple[bool, Any]:
        """(True, result) of the function "module:name", or (False, its exception as text).

        limit: s of wall time. Raises TookTooLong and ProcessEnded.
        """
        if self._process is None:
            self._start()
        self._pipe.send((target, arguments))
        try:
            if not self._pipe.poll(limit):
                self._end()
                raise TookTooLong(f"it was ended after {limit:g} s")
            return self._pipe.recv()
        except EOFError:
            self._process.join()
            code = self._process.exitcode
            self._end()
            raise ProcessEnded(f"its process ended with the code {code}") from None

    def _start(self) -> None:
        os.environ.setdefault("OMP_NUM_THREADS", "1")
        self._pipe, theirs = self._context.Pipe()
        self._process = self._context.Process(target=_serve, args=(theirs,), daemon=False)
        self._process.start()
        theirs.close()

    def _end(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.join()
            self._pipe.close()
            self._process = self._pipe = None
