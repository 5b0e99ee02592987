"""Reads recordings that were spoilt, fits a model to them as `ssmr train` does, and judges by the known answer."""

from __future__ import annotations

import json
import logging
import re
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from ssmr_torch.data.card_reader import custom
from ssmr_torch.data.refusals import check_learnable
from ssmr_torch.faults.made_recordings import MadeRecordings, Robot, made_recordings
from ssmr_torch.faults.outcome import REFUSALS, Expected, refusal_faults
from ssmr_torch.trajectory import TrajectoryDataset

MM = 1e3


@dataclass
class Read:
    """What became of recordings. error: test RMSE of the fit, m; None where no fit was asked for."""

    data: TrajectoryDataset
    lines: list[tuple[int, str]]
    error: float | None = None

    @property
    def warnings(self) -> list[str]:
        return [text for level, text in self.lines if level >= logging.WARNING]


class _Kept(logging.Handler):
    def __init__(self):
        super().__init__(logging.INFO)
        self.lines: list[tuple[int, str]] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.lines.append((record.levelno, record.getMessage()))


@contextmanager
def log_lines():
    """Collects what the package logs, (level, text) each."""
    logger, handler = logging.getLogger("ssmr_torch"), _Kept()
    level, propagate = logger.level, logger.propagate
    logger.addHandler(handler)
    logger.setLevel(logging.INFO)
    logger.propagate = False
    try:
        yield handler.lines
    finally:
        logger.removeHandler(handler)
        logger.setLevel(level)
        logger.propagate = propagate


def read_and_fit(card: Path, states: int | None) -> Read:
    """The data that a card describes, and, where states are given, a linear model of so many fitted to them.

    Raises what the package raises.
    """
    with log_lines() as lines:
        data = custom(card)
        error = None
        if any(run.name == "test" for run in data):
            check_learnable(data)
        if states is not None:
            from ssmr_torch.fitting.fit import fit

            error = fit(data, "sssr", state_dim=states, progress=False).scores["test/rmse"]
    return Read(data, lines, error)


@cache
def clean_error(robot: Robot, decay_seconds: float = 3.0, timestep: float = 0.01, seed: int = 0) -> float:
    """Test RMSE of the fit to the recordings without any fault, m."""
    with TemporaryDirectory() as folder:
        made = made_recordings(robot, decay_seconds=decay_seconds, timestep=timestep, seed=seed)
        return read_and_fit(made.write(Path(folder)), 2 * robot.modes).error


def judged(card: Path, made: MadeRecordings, expected: Expected, seed: int = 0) -> tuple[str, str]:
    """(outcome, what was said or what is wrong) of reading the recordings of a card."""
    try:
        found = read_and_fit(card, 2 * made.robot.modes if expected.error is not None else None)
    except REFUSALS as refusal:
        return _refusal(str(refusal), expected)
    except ModuleNotFoundError as missing:
        return "refused", str(missing)
    except Exception as error:  # whatever it is: that is what is looked for
        return "traceback", f"{type(error).__name__}: {error}"
    wrong = _wrong(found, made, expected, seed)
    if wrong:
        return "wrong", "; ".join(wrong)
    if not (expected.said or expected.rows):
        return "survived", ""
    return "bridged", " ".join(found.warnings)


def _refusal(message: str, expected: Expected) -> tuple[str, str]:
    if expected.refused is False:
        return "wrong", f"refused, but should be read: {message}"
    missing = [pattern for pattern in expected.remedy if not re.search(pattern, message, re.IGNORECASE)]
    if missing:
        return "wrong", f"the refusal lacks {', '.join(missing)}: {message}"
    long = refusal_faults(message)
    return ("wrong", long) if long else ("refused", message)


def _wrong(found: Read, made: MadeRecordings, expected: Expected, seed: int) -> list[str]:
    """What is wrong with data that were read."""
    if expected.refused:
        return [f"read, but should be refused; said: {' | '.join(found.warnings) or 'nothing'}"]
    wrong, log, origin = [], "\n".join(found.warnings), json.dumps(found.data.provenance, ensure_ascii=False)
    wrong += [f"the log lacks {pattern!r}" for pattern in expected.said if not re.search(pattern, log, re.IGNORECASE)]
    for row in expected.rows:
        near = {int(number) for number in re.findall(r"\d+", log)}
        if not any(abs(row - number) <= expected.near for number in near):
            wrong.append(f"the log does not name row {row}")
        if not any(abs(row - int(number)) <= expected.near for number in re.findall(r"\d+", origin)):
            wrong.append(f"the provenance does not name row {row}")
    if expected.silent and found.warnings:
        wrong.append(f"warned without a fault: {' | '.join(found.warnings)}")
    wrong += _wrong_data(found.data, expected)
    if expected.unchanged:
        wrong += _changed(found.data, made)
    if expected.error is not None:
        limit = expected.error * clean_error(made.robot, seed=seed)
        if not found.error <= limit:
            wrong.append(f"RMSE {MM * found.error:.3g} mm, the limit is {MM * limit:.3g} mm")
    said = " | ".join(found.warnings)
    return [*wrong, f"said: {said[:300] or 'nothing'}"] if wrong else []


def _wrong_data(data: TrajectoryDataset, expected: Expected) -> list[str]:
    lengths: dict[str, int] = {}
    for run in data:
        name = run.name if run.name in expected.samples else re.sub(r"/\d+$", "", run.name)
        lengths[name] = lengths.get(name, 0) + run.length
    wrong = [f"{name} has {lengths.get(name, 0)} samples, expected {count}" for name, count in expected.samples.items()
             if abs(lengths.get(name, 0) - count) > expected.near]
    runs = {run.name: run for run in data}
    missing = [name for name in expected.names if name not in runs]
    wrong += [f"no run {missing}, the runs are {sorted(runs)}"] if missing else []
    for name, column, row, value, tolerance in expected.values:
        run = runs.get(name)
        got = None if run is None else float(run.read().observation[row, column])
        if got is None or not abs(got - value) <= tolerance:
            wrong.append(f"{name}: output {column} of sample {row} is {got}, expected {value:g} m")
    if expected.timestep is not None and abs(next(iter(data)).timestep / expected.timestep - 1) > 0.01:
        wrong.append(f"the timestep is {next(iter(data)).timestep:g} s, expected {expected.timestep:g} s")
    return wrong


def _changed(data: TrajectoryDataset, made: MadeRecordings) -> list[str]:
    """Runs that differ from what was written, by more than its digits."""
    read, wrong = {run.name: run.read() for run in data}, []
    for name, run in made.runs.items():
        got = read.get(name)
        if got is None or got.length != len(run):
            wrong.append(f"{name} has {got and got.length} samples, written were {len(run)}")
            continue
        truth = run.y - np.array(made.card["rest"], dtype=float)
        off = max(np.abs(MM * got.observation - truth).max(), np.abs(got.input - run.u).max())
        wrong += [f"{name} differs by {off:.3g} from what was written"] if off > 2e-3 else []
    return wrong
