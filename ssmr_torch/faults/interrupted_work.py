"""Commands that are interrupted at random moments and started again: is anything lost, half written or different?"""

from __future__ import annotations

import os
import re
import resource
import shutil
import signal
import sys
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from ssmr_torch import command
from ssmr_torch.faults.interrupted_products import PRODUCTS, unreadable
from ssmr_torch.lazy import found

# What ends or spoils the work: signals by name, a disk that takes no more, and a directory that is moved away.
WAYS = ("SIGKILL", "SIGTERM", "SIGINT", "SIGHUP", "full disk", "lost directory")
LIMIT = 900.0   # s of wall time for one run
POLLED = 0.002  # s
SMALLEST, LARGEST = 1 << 8, 1 << 20  # bytes of the largest file that a full disk takes
PRELOADED = ("hydra", "torch", "lightning", "optuna", *(f"ssmr_torch.{module}" for module in (
    "fitting.training_run", "fitting.compare_models", "collection.collect", "controller_design.design",
    "closed_loop.artifact_run", "evaluation.figures", "report.html_page", "report.artifact_scores")))

DATA = "data.path=inputs/collect/trajectories.h5"
ARTIFACT = "artifact=inputs/export/artifact"
SMALL = ("trainer.enable_progress_bar=false", "figures=false", "module.stride=40", "module.starts=20")
TRAIN = (DATA, *SMALL, "model=ssmr_stability_guard", "model.state_dim=4", "fit.refinement.epochs=4",
         "fit.refinement.starts=40")


@dataclass(frozen=True)
class Interrupted:
    """A command of small size. needs: the commands that make its inputs.   resume: what is given to go on.

    multirun: whether its directory is that of several jobs.
    """

    name: str
    arguments: tuple[str, ...]
    needs: tuple[str, ...] = ()
    resume: tuple[str, ...] = ()
    multirun: bool = False

    def line(self, directory: str) -> list[str]:
        where = "hydra.sweep.dir" if self.multirun else "hydra.run.dir"
        return [*self.arguments, f"{where}={directory}"]


COMMANDS = {each.name: each for each in (
    Interrupted("collect", ("collect", "excitation.decays.count=4", "excitation.validation_decays=1",
                            "excitation.test_decays=1", "excitation.decay_duration=1.0", "excitation.progress=false",
                            "workers=1")),
    Interrupted("collect in workers", ("collect", "excitation.decays.count=4", "excitation.validation_decays=1",
                                       "excitation.test_decays=1", "excitation.decay_duration=1.0",
                                       "excitation.progress=false", "workers=2")),
    Interrupted("train", ("train", *TRAIN), ("collect",), ("resume=true",)),
    Interrupted("train by gradients", ("train", DATA, *SMALL, "model=ssmr", "model.state_dim=4", "fit=rollout",
                                       "fit.refinement.epochs=4"), ("collect",), ("resume=true",)),
    Interrupted("search", ("train", "-m", "search=own", "model=sssr", DATA, *SMALL, "hydra.sweeper.n_trials=4",
                           "model.state_dim=range(2,7)"), ("collect",), (), True),
    Interrupted("export", ("export", "checkpoint=inputs/train/model.ckpt"), ("train",)),
    Interrupted("evaluate", ("evaluate", ARTIFACT, DATA, "starts=50"), ("export",)),
    Interrupted("compare", ("compare", DATA, "models=[dmd,sssr]", "starts=50"), ("collect",)),
    Interrupted("design", ("design", DATA, "model=dmd", "task=circle", "plant=slow_manifold", "progress=false",
                           "outputs=[tip_x,tip_y,tip_z]", "task.laps=1"), ("collect",)),
    Interrupted("control", ("control", ARTIFACT, "task.laps=1", "progress=false"), ("export",)),
    Interrupted("report", ("report", "directory=inputs"), ("evaluate",)))}


def interrupted(count: int, seed: int) -> list[dict]:
    """`interruptions` of all commands."""
    return interruptions(tuple(COMMANDS), count, seed)


def interruptions(commands: Sequence[str], moments: int, seed: int, ways: Sequence[str] = WAYS,
                  say: Callable[[dict], None] = lambda row: None) -> list[dict]:
    """Interrupt each command at random moments in each way, start it again, and compare with the uninterrupted one.

    Returns a row for each interruption: kind, case, outcome and said; "survived" where nothing was half written, the
    command ended as it should, and the result is that of an uninterrupted command to the last bit. say: gets each row.
    """
    for module in PRELOADED:  # loaded once; each run is a fork of this process
        found(f"{module}:__name__")
    rng, rows = np.random.default_rng(seed), []
    with TemporaryDirectory() as folder:
        place = Path(folder)
        for name in commands:
            bench = Bench(place, COMMANDS[name])
            for way in [way for _ in range(moments) for way in ways]:
                rows.append(bench.trial(way, rng))
                say(rows[-1])
    return rows


class Bench:
    """One command with its inputs and its uninterrupted result."""

    def __init__(self, place: Path, asked: Interrupted):
        self.place, self.asked, self.product = place, asked, PRODUCTS[asked.arguments[0], asked.multirun]
        for need in asked.needs:
            _made(place, need)
        begun = time.monotonic()
        status, said = run(place, asked.line("whole"))
        self.duration = time.monotonic() - begun
        if status:
            raise ValueError(f"{asked.name} ended with status {status}: {said[-500:]}")
        self.expected = self.product(place / "whole")
        shutil.rmtree(place / "whole")

    def trial(self, way: str, rng: np.random.Generator) -> dict:
        directory = self.place / "run"
        shutil.rmtree(directory, ignore_errors=True)
        moment = float(rng.uniform(0.0, self.duration))
        size = int(np.exp(rng.uniform(np.log(SMALLEST), np.log(LARGEST))))
        full = way == "full disk"
        case = f"{self.asked.name}, {f'files of at most {size} bytes' if full else f'after {moment:.2f} s'}"
        status, said = run(self.place, self.asked.line("run"), way, moment, size)
        wrong = _ended_wrong(way, status, said)
        wrong = wrong or unreadable(directory, leftovers=way == "SIGKILL")
        outcome, text = ("traceback" if "Traceback" in said else "hang" if status is None else "wrong", wrong)
        if not wrong:
            outcome, text = self._again(directory)
        return {"kind": f"interrupted by {way}" if not full and way != "lost directory" else way, "case": case,
                "outcome": outcome, "said": text}

    def _again(self, directory: Path) -> tuple[str, str]:
        begun = (directory / "checkpoints" / "training.json").is_file()
        status, said = run(self.place, [*self.asked.line("run"), *(self.asked.resume if begun else ())])
        if status != 0:
            return ("hang" if status is None else "traceback" if "Traceback" in said else "wrong",
                    f"started again, it ended with status {status}: {said[-500:]}")
        wrong = unreadable(directory)
        if not wrong and self.product(directory) != self.expected:
            wrong = "started again, its result differs from the uninterrupted one"
        return ("wrong", wrong) if wrong else ("survived", "")


def _made(place: Path, name: str) -> None:
    """The inputs that a command needs, in place/inputs."""
    for need in COMMANDS[name].needs:
        _made(place, need)
    if not (place / "inputs" / name).is_dir():
        status, said = run(place, COMMANDS[name].line(f"inputs/{name}"))
        if status:
            raise ValueError(f"{name} ended with status {status}: {said[-500:]}")


def _ended_wrong(way: str, status: int | None, said: str) -> str:
    """What is wrong with how an interrupted command has ended; a command that was faster than its signal is right."""
    if status is None:
        return f"it did not end within {LIMIT:g} s"
    if "Traceback" in said or "Error in sys.excepthook" in said:
        return f"a traceback: {said[-1500:]}"
    if status == 0 or way in ("full disk", "lost directory"):
        return "" if status in (0, 1) else f"its status is {status}: {said[-300:]}"
    number = getattr(signal, way)
    if status == -number:  # it came before the command, or it was SIGKILL
        return ""
    if status != 128 + number:
        return f"its status is {status}, not {128 + number}: {said[-300:]}"
    messages = re.findall(r"ended by .*; .+", said)
    return "" if len(messages) == 1 else f"{len(messages)} messages: {said[-300:]}"


def run(place: Path, arguments: Sequence[str], way: str = "", moment: float = 0.0,
        size: int = 0) -> tuple[int | None, str]:
    """Exit status, negative for a signal and None for one that did not end, and standard error of `ssmr ARGUMENTS`."""
    log = place / "said"
    sys.stdout.flush()
    sys.stderr.flush()
    begun = time.monotonic()
    child = os.fork()
    if child == 0:
        _be_command(place, arguments, log, size if way == "full disk" else None)
    waits = way not in ("", "full disk")
    while (since := time.monotonic() - begun) < LIMIT:
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            return os.waitstatus_to_exitcode(status), log.read_text(errors="replace")
        if waits and since >= moment:
            _interrupt(way, child, place)
            waits = False
        time.sleep(POLLED)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return None, log.read_text(errors="replace")


def _interrupt(way: str, child: int, place: Path) -> None:
    if way != "lost directory":
        os.kill(child, getattr(signal, way))
    elif (place / "run").is_dir():
        away = place / "away"
        shutil.rmtree(away, ignore_errors=True)
        os.rename(place / "run", away)


def _be_command(place: Path, arguments: Sequence[str], log: Path, largest: int | None) -> None:
    """In a fork: be the command, from its first line to its end."""
    status = 1
    try:
        os.setsid()
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL)
        os.chdir(place)
        for stream, target in ((1, os.devnull), (2, log)):
            os.dup2(os.open(target, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o666), stream)
        if largest is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (largest, largest))
        sys.argv = ["ssmr", *arguments]
        status = command.main() or 0
    except SystemExit as end:
        status = end.code if isinstance(end.code, int) else 0 if end.code is None else 1
        if isinstance(end.code, str):
            os.write(2, f"{end.code}\n".encode())
    except BaseException:
        os.write(2, traceback.format_exc().encode())
    finally:
        os._exit(status)  # without the ends of this process, whose fork it is
