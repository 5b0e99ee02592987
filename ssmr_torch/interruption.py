"""Ends by a signal: Ctrl-C, SIGTERM and SIGHUP end a command in order, with one message and the status of a shell."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP")
REPEATED = 1.0  # s; a second signal so soon is the same one, sent to the process and to its group
LIMIT = 10.0    # s, for an end in order
WATCHED_EVERY = 0.5  # s
AGAIN = 0.02    # s, until a signal that was lost is sent again
TOLD_ALREADY = ("Can't decrement id ref count",)  # by h5py, which has raised what was wrong with the file before


class Interrupted(KeyboardInterrupt):
    """What a signal raises in the main thread; what handles Ctrl-C handles it, too. number: of the signal."""

    def __init__(self, number: int):
        super().__init__(f"ended by {signal.Signals(number).name}")
        self.number = number


class End:
    """How the present command ends: the signal that came, what to say then, and how long the end may take.

    remedy: what continues the work.   further: what does once something is kept, see `can_go_on`.   limit: s; None
    where a robot is moved, which takes its time to stop.
    """

    def __init__(self):
        self.command: str | None = None  # None while no command runs
        self.number: int | None = None
        self.remedy, self.further = "the same command starts again", ""
        self.limit: float | None = LIMIT
        self._last, self._lost, self._turn = 0.0, False, object()

    def begin(self, command: str) -> None:
        self.__init__()
        self.command = command

    def come(self, number: int, frame=None) -> None:
        """Raise `Interrupted`, once for each signal."""
        first, since, self._last = self.number is None, time.monotonic() - self._last, time.monotonic()
        again, self._lost = self._lost, False
        if first:
            self.number = number
            if self.limit is not None:
                # daemon: it also ends a process that waits for threads which do not end
                threading.Thread(target=self._force, args=(self.limit,), daemon=True).start()
        if first or again or since > REPEATED:
            raise Interrupted(number)

    def ignored(self, what) -> None:
        """For `sys.unraisablehook`: an `Interrupted` that came in a callback of compiled code is raised again."""
        if isinstance(what.exc_value, Interrupted):
            self._lost = True
            threading.Timer(AGAIN, signal.pthread_kill, (threading.main_thread().ident, what.exc_value.number)).start()
        elif not any(words in str(what.exc_value) for words in TOLD_ALREADY):
            sys.__unraisablehook__(what)

    def can_go_on(self) -> None:
        """Something is kept from now on, with which `further` goes on."""
        self.remedy = self.further or self.remedy

    @property
    def status(self) -> int:
        return 128 + self.number

    def sentence(self) -> str:
        how = "Ctrl-C" if self.number == signal.SIGINT else signal.Signals(self.number).name
        return f"{self.command}: ended by {how}; {self.remedy}"

    def _force(self, limit: float) -> None:
        status, turn = self.status, self._turn
        time.sleep(limit)
        still = self.command is not None and self._turn is turn
        if still:
            print(self.sentence(), file=sys.stderr, flush=True)
        if still or not threading.main_thread().is_alive():  # else a program goes on after the command
            os._exit(status)


END = End()
_parents: set[int] = set()


@contextmanager
def ended_in_order(command: str) -> Iterator[None]:
    """Inside, a signal raises `Interrupted` in the main thread; the command then ends with a message and 128 + number.

    That is so as well where a library has caught the exception. Every file is written aside, so that nothing is half
    written. Signals that are ignored, as SIGHUP under nohup, stay so. Nested, or in another thread, it does nothing.
    """
    if END.command is not None or threading.current_thread() is not threading.main_thread():
        yield
        return
    END.begin(command)
    before = {number: signal.getsignal(number) for number in
              (getattr(signal, name) for name in SIGNALS if hasattr(signal, name))}
    for number, handler in before.items():
        if handler in (signal.SIG_DFL, signal.default_int_handler):
            signal.signal(number, END.come)
    hook, sys.unraisablehook = sys.unraisablehook, END.ignored
    try:
        yield
    except BaseException:
        if END.number is None:
            raise
    finally:
        sys.unraisablehook = hook
        END.command, name = None, END.command
        for number, handler in before.items():
            if handler is not None:
                signal.signal(number, handler)
    if END.number is not None:
        END.command = name
        sentence, END.command = END.sentence(), None
        print(sentence, file=sys.stderr, flush=True)
        raise SystemExit(END.status)


def belong_to(parent: int) -> None:
    """Leave Ctrl-C to the process `parent`, and end at once when that one is no longer there, even if it was killed."""
    if parent in _parents:
        return
    _parents.add(parent)
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_watch, args=(parent,), daemon=True).start()


def _watch(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(WATCHED_EVERY)
    os._exit(1)
