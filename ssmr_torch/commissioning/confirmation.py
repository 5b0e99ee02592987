"""How a person or a program confirms a step: its result, and the motion that comes next."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

Confirm = Callable[[str, str, Sequence[str]], bool]  # step, its result and what comes next, faults → continue or not


def ask(step: str, text: str, faults: Sequence[str]) -> bool:
    """Show the step and wait for y or n at the terminal. Raises ValueError where there is no terminal."""
    print(f"\n{text}")
    while True:
        try:
            answer = input(f"{step}: confirm? [y/n] ").strip().lower()
        except EOFError as error:
            raise ValueError("confirm is ask, but there is no terminal for the answer; start it in a terminal, or use "
                             "confirm=yes") from error
        if answer in ("y", "yes", "n", "no"):
            return answer[0] == "y"


def yes(step: str, text: str, faults: Sequence[str]) -> bool:
    """Show the step and agree, unless it has faults: a person must check those."""
    print(f"\n{text}")
    if faults:
        print(f"{step}: not confirmed, because of the faults above; repair them, or check them and use confirm=ask")
    return not faults


CONFIRMATIONS: dict[str, Confirm] = {"ask": ask, "yes": yes}


def confirmation(confirm: str | Confirm) -> Confirm:
    """The function "ask" or "yes" by name, or your own function. Raises ValueError for anything else."""
    if callable(confirm):
        return confirm
    if confirm in CONFIRMATIONS:
        return CONFIRMATIONS[confirm]
    raise ValueError(f"confirm is {confirm!r}; expected {' or '.join(CONFIRMATIONS)}, or a function (step, text, "
                     "faults) → bool")


@contextmanager
def ended_in_order() -> Iterator[None]:
    """Inside, SIGTERM raises SystemExit, so that the robot goes back to its neutral input; only in the main thread."""
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
