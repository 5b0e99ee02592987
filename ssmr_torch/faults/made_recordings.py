"""Recordings of a made robot, whose truth is known: any number of modes, markers and inputs, written with a card."""

from __future__ import annotations

from collections.abc import Iterable
from copy import deepcopy
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import numpy as np
import yaml
from scipy.linalg import expm

from ssmr_torch.result_files import save_text

TIMESTEP, NOISE, HELD = 0.01, 0.02, 12  # s; mm; samples
DECAYS, CONTROLLED = 6, ("c1", "c2", "c3", "test")
RESTS = ((5.0, -3.0, 120.0), (4.0, -2.0, 60.0), (-8.0, 11.0, 30.0))  # mm, of the markers
COORDINATES = "xyz"
ACTUATION = np.array([[30.0, 5.0], [10.0, -20.0], [-8.0, 40.0], [25.0, 12.0]])  # mm/s
SHAPES = (np.array([[1.0, 0.2, 0.3, -0.1], [-0.2, 0.9, 0.1, 0.6], [0.25, -0.3, 0.2, 0.1]]),
          np.array([[0.5, 0.3, 0.1, 0.2], [-0.1, 0.4, 0.3, 0.3], [0.1, -0.2, 0.4, 0.1]]),
          np.array([[0.3, -0.4, 0.2, 0.5], [0.6, 0.1, -0.3, 0.2], [-0.2, 0.5, 0.1, 0.3]]))  # of the markers


@dataclass(frozen=True)
class Robot:
    """ẋ = A x + B u, y = C x + rest: damped oscillations that the inputs drive.

    modes: pairs of states; decays from 1.5 1/s on, frequencies from 12.5 rad/s on. markers: three coordinates each.
    """

    modes: int = 2
    markers: int = 1
    inputs: int = 2
    seed: int = 0

    @property
    def rest(self) -> np.ndarray:
        """Of all markers, mm, (3 markers,)."""
        return np.concatenate([RESTS[marker % len(RESTS)] for marker in range(self.markers)])

    def matrices(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """A (n, n), B (n, m), C (p, n)."""
        rng = np.random.default_rng(self.seed)
        states = 2 * self.modes
        A = np.zeros((states, states))
        for mode in range(self.modes):
            decay, frequency = 1.5 + 0.3 * mode + rng.uniform(-0.1, 0.1), 12.5 + 2.5 * mode + rng.uniform(-0.3, 0.3)
            A[2 * mode:2 * mode + 2, 2 * mode:2 * mode + 2] = [[-decay, frequency], [-frequency, -decay]]
        B = np.resize(ACTUATION, (states, self.inputs)) * rng.uniform(0.8, 1.2, (states, self.inputs))
        C = np.resize(np.vstack(SHAPES[:self.markers]), (3 * self.markers, states))
        return A, B, C + rng.uniform(-0.1, 0.1, C.shape)

    def positions(self, inputs: np.ndarray, start: np.ndarray, timestep: float = TIMESTEP) -> np.ndarray:
        """Positions of the markers without noise under held inputs (T, m), mm, (T, p)."""
        A, B, C = self.matrices()
        states, count = len(A), inputs.shape[1]
        step = expm(timestep * np.block([[A, B], [np.zeros((count, states + count))]]))
        x, found = start, []
        for u in inputs:
            found.append(C @ x)
            x = step[:states, :states] @ x + step[:states, states:] @ u
        return np.array(found) + self.rest


@dataclass
class MadeRun:
    """time (T,) s; y (T, p) positions in mm; u (T, m)."""

    time: np.ndarray
    y: np.ndarray
    u: np.ndarray

    def __len__(self) -> int:
        return len(self.time)

    def keep(self, rows) -> None:
        """Only these rows, in this order."""
        self.time, self.y, self.u = self.time[rows], self.y[rows], self.u[rows]


@dataclass
class MadeRecordings:
    """Runs by name and the card that describes them; a fault changes either. digits: that are written."""

    robot: Robot
    runs: dict[str, MadeRun]
    card: dict = field(default_factory=dict)
    digits: int = 6

    @property
    def observation(self) -> list[str]:
        return self.card["columns"]["observation"]

    @property
    def input(self) -> list[str]:
        return self.card["columns"]["input"]

    def controlled(self) -> list[str]:
        """Names of the training runs with inputs."""
        return [name for name in self.runs if name.startswith("c")]

    def decays(self) -> list[str]:
        return [name for name in self.runs if name.startswith("d")]

    def training(self) -> list[str]:
        return [name for name in self.runs if name != "test"]

    def copy(self) -> MadeRecordings:
        return deepcopy(self)

    def as_displacements(self) -> None:
        """Positions from rest, which the card then says."""
        for run in self.runs.values():
            run.y = run.y - self.robot.rest
        self.card["rest"] = [0.0] * len(self.robot.rest)

    def table(self, name: str) -> np.ndarray:
        """Columns t, outputs, inputs, (T, 1 + p + m)."""
        run = self.runs[name]
        return np.column_stack([run.time, run.y, run.u])

    @property
    def clock(self) -> str | None:
        """Name of the column of stamps or of frame numbers."""
        return self.card["columns"].get("time") or self.card["columns"].get("frame")

    def header(self) -> list[str]:
        return [*([self.clock] if self.clock else []), *self.observation, *self.input]

    def rows(self, name: str) -> list[str]:
        """The rows of a run as text of comma separated values, without the header."""
        table = self.table(name) if self.clock else self.table(name)[:, 1:]
        clock = ["%.10g"] if self.clock else []
        forms = [*clock, *[f"%.{self.digits}g"] * (table.shape[1] - len(clock))]
        return [",".join("" if np.isnan(value) else text % value for text, value in zip(forms, row)) for row in table]

    def write(self, folder: Path, names: Iterable[str] | None = None) -> Path:
        """One file of comma separated values for each run, and the card; the path of the card."""
        for name in self.runs if names is None else names:
            save_text(folder / f"{name}.csv", "\n".join([",".join(self.header()), *self.rows(name)]) + "\n")
        return self.write_card(folder)

    def write_card(self, folder: Path) -> Path:
        return save_text(folder / "card.yaml", yaml.safe_dump(self.card, sort_keys=False))


@cache
def _base(robot: Robot, seconds: float, decay_seconds: float, timestep: float, noise: float,
          seed: int) -> MadeRecordings:
    rng, states = np.random.default_rng([seed, 1]), 2 * robot.modes
    runs = {}
    for index in range(DECAYS):
        still = np.zeros((round(decay_seconds / timestep), robot.inputs))
        runs[f"d{index + 1}"] = (still, rng.normal(size=states) * 12.0)
    held = round(HELD * TIMESTEP / timestep)
    for name in CONTROLLED:
        count = round(seconds / timestep)
        levels = 2.0 * rng.uniform(-1, 1, (count // held + 2, robot.inputs))
        runs[name] = (np.repeat(levels, held, axis=0)[:count], np.zeros(states))
    made = {}
    for name, (u, start) in runs.items():
        y = robot.positions(u, start, timestep)
        made[name] = MadeRun(timestep * np.arange(len(u)), y + noise * rng.normal(size=y.shape), u)
    return MadeRecordings(robot, made, card_of(robot, list(made)))


def made_recordings(robot: Robot | None = None, *, seconds: float = 15.0, decay_seconds: float = 3.0,
                    timestep: float = TIMESTEP, noise: float = NOISE, seed: int = 0) -> MadeRecordings:
    """Six decays d1 … d6, the controlled runs c1, c2, c3 and a test run, all absolute in mm; a copy to be spoilt.

    seconds: of a controlled run, under inputs within ±2 that are held for 0.12 s. noise: standard deviation, mm.
    """
    return _base(robot or Robot(), seconds, decay_seconds, timestep, noise, seed).copy()


def card_of(robot: Robot, names: list[str]) -> dict:
    """The card of recordings in files NAME.csv, mm, normalized inputs, s."""
    axes = [f"m{marker + 1}{axis}" if robot.markers > 1 else axis for marker in range(robot.markers)
            for axis in COORDINATES]
    return {"files": [f"{name}.csv" for name in names],
            "columns": {"time": "t", "observation": axes, "input": [f"u{k + 1}" for k in range(robot.inputs)]},
            "units": {"length": "mm", "input": "1", "time": "s"}, "rest": robot.rest.tolist(),
            "decays": [name for name in names if name.startswith("d")], "split": {"test": ["test"]}}


def small_recordings(rows: int = 20) -> MadeRecordings:
    """One run m that anyone can check by hand: t = k/100, x = 5 + 0.1 k, y = −3, z = 120 mm, u1 = 0.01 k, u2 = 0."""
    k = np.arange(rows)
    run = MadeRun(k / 100, np.column_stack([5 + 0.1 * k, np.full(rows, -3.0), np.full(rows, 120.0)]),
                  np.column_stack([0.01 * k, np.zeros(rows)]))
    card = card_of(Robot(), ["m"])
    return MadeRecordings(Robot(), {"m": run}, card | {"decays": [], "split": {}, "rest": [5.0, -3.0, 120.0]})
