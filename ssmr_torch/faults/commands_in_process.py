"""A command in this process, as the command line starts it, with a limit of time, and what came of it."""

from __future__ import annotations

import contextlib
import io
import signal
import traceback
from collections.abc import Iterator, Sequence
from pathlib import Path
from time import monotonic
from typing import NamedTuple

from ssmr_torch.command import module_of
from ssmr_torch.configuration import as_in_a_job, of_groups
from ssmr_torch.short_refusals import OF_THE_COMMAND_LINE, in_one_sentence


class Ended(NamedTuple):
    """How a command ended: "done", "refused", "traceback" or "late"; what it said, and after how many seconds."""

    how: str
    said: str
    seconds: float


class Late(BaseException):
    """The limit of time has passed."""


def run_command(command: str, overrides: Sequence[str], directory: Path, limit: float) -> Ended:
    """Run a command with these overrides in a directory, for at most `limit` s.

    A refusal is what the command line would print. An exception that no entry point explains is a "traceback".
    """
    begun, heard = monotonic(), io.StringIO()
    try:
        with limited(limit), contextlib.redirect_stdout(heard), contextlib.redirect_stderr(heard):
            task = _task(command)
            try:
                config = as_in_a_job(command, overrides, directory)
            except (*OF_THE_COMMAND_LINE, ValueError) as error:
                raise SystemExit(f"{command}: {in_one_sentence(error, of_groups(overrides))}") from error
            directory.mkdir(parents=True, exist_ok=True)
            task(config)
        how, said = "done", ""
    except SystemExit as end:
        how, said = ("refused", str(end.code)) if end.code else ("done", "")
    except Late:
        how, said = "late", f"still at work after {limit:g} s"
    except Exception:
        how, said = "traceback", traceback.format_exc(limit=-6)
        if monotonic() - begun >= limit:  # `Late` may leave a library as an exception of its own
            how, said = "late", f"still at work after {limit:g} s"
    return Ended(how, said, monotonic() - begun)


def _task(command: str):
    """What Hydra calls with the configuration: the entry point without its reading of the command line."""
    script = module_of(command)
    if command == "benchmark":
        script.offer("benchmark", {name: script.settings_of(name) for name in script.NAMES})
    layers = [script.run if command == "benchmark" else script.main]
    while hasattr(layers[-1], "__wrapped__"):
        layers.append(layers[-1].__wrapped__)
    return layers[-2]


@contextlib.contextmanager
def limited(seconds: float) -> Iterator[None]:
    """Raise `Late` in this block after so many seconds; only in the main thread of a process."""
    def late(*_):
        raise Late

    before = signal.signal(signal.SIGALRM, late)
    signal.setitimer(signal.ITIMER_REAL, seconds, 0.5)  # again: a callback of a compiler may swallow one
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
