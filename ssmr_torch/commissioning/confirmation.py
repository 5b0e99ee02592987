"""How a person, or a program in their place, agrees to what was found and to what moves next."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

Confirm = Callable[[str, str, Sequence[str]], bool]  # step, what it found and what comes next, faults → go on


def ask(step: str, text: str, faults: Sequence[str]) -> bool:
    """Show the step and wait for y or n at the terminal. Raises ValueError where there is none."""
    print(f"\n{text}")
    while True:
        try:
            answer = input(f"{step}: confirm? [y/n] ").strip().lower()
        except EOFError as error:
            raise ValueError("confirm is ask, but nobody answers at the terminal; start it there, or take "
                             "confirm=yes") from error
        if answer in ("y", "yes", "n", "no"):
            return answer[0] == "y"


def yes(step: str, text: str, faults: Sequence[str]) -> bool:
    """Show the step and agree, unless it has faults: a person must look at those."""
    print(f"\n{text}")
    if faults:
        print(f"{step}: not confirmed, as there is something to look at; mend it, or look and take confirm=ask")
    return not faults


CONFIRMATIONS: dict[str, Confirm] = {"ask": ask, "yes": yes}


def confirmation(confirm: str | Confirm) -> Confirm:
    """The function by its name, "ask" or "yes", or one of one's own. Raises ValueError for anything else."""
    if callable(confirm):
        return confirm
    if confirm in CONFIRMATIONS:
        return CONFIRMATIONS[confirm]
    raise ValueError(f"confirm is {confirm!r}; expected {' or '.join(CONFIRMATIONS)}, or a function (step, text, "
                     "faults) → bool")


@contextmanager
def ended_in_order() -> Iterator[None]:
    """A SIGTERM raises SystemExit inside, so that the robot is led back to its neutral input; only of a main thread."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def end(number, frame):
        raise SystemExit(128 + number)

    before = signal.signal(signal.SIGTERM, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
