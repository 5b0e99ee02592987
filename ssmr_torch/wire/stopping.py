"""Signals that end a process let it say goodbye first."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager

# Those whose default is to end the process at once, without any `finally`.
DEADLY = tuple(number for name in ("SIGTERM", "SIGHUP") if (number := getattr(signal, name, None)) is not None)


@contextmanager
def ended_by_signals() -> Iterator[None]:
    """While it lasts, SIGTERM and SIGHUP raise SystemExit(128 + number), and SIGINT raises KeyboardInterrupt, once.

    Further ones are ignored, so that they do not interrupt the goodbye. A signal with a handler of somebody else keeps
    it. Outside the main thread, which alone can set handlers, nothing changes.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.getsignal(number) for number in (*DEADLY, signal.SIGINT)}
    ours = [number for number, handler in before.items()
            if handler is (signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL)]

    def end(number, frame):
        for each in ours:
            signal.signal(each, signal.SIG_IGN)
        raise KeyboardInterrupt if number == signal.SIGINT else SystemExit(128 + number)

    for number in ours:
        signal.signal(number, end)
    try:
        yield
    finally:
        for number in ours:
            signal.signal(number, before[number])
