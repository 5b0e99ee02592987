"""Exports of measurement systems: each is read with its names, rate and unit, or refused with a remedy."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ssmr_torch.faults import tool_files as made
from ssmr_torch.faults.outcome import REFUSALS, Found, refusal_faults
from ssmr_torch.recording_files.reading import read_tables

FIRST = 1_700_000_000_000_000_000  # ns


@dataclass(frozen=True)
class FileTrial:
    """write(folder) → the file. columns: (pattern of a name, values (T,)); unit of the first of them; interval in s;
    runs: number of tables. refused: patterns of a refusal that is right as well; only: nothing but it is right.
    """

    kind: str
    name: str
    write: Callable[[Path], Path]
    columns: tuple[tuple[str, np.ndarray], ...] = ()
    interval: float | None = None
    unit: str | None = None
    runs: int | None = None
    refused: tuple[str, ...] | None = None
    only: bool = False
    tolerance: float = 1e-6
    harmless: Callable[[Path], bool] = field(default=lambda folder: True)

    def run(self, folder: Path, seed: int = 0) -> Found:
        """Write the file into an empty folder, read it and judge."""
        path = self.write(folder)
        try:
            tables = read_tables(path)
            outcome, said = self._judge(tables)
        except REFUSALS as refusal:
            outcome, said = self._judge_refusal(str(refusal))
        except ModuleNotFoundError as missing:
            outcome, said = "refused", str(missing)
        except Exception as error:  # whatever it is: that is what is looked for
            outcome, said = "traceback", f"{type(error).__name__}: {error}"
        if not self.harmless(folder):
            outcome, said = "wrong", "the file ran code of its own"
        return Found(self.kind, self.name, outcome, said)

    def _judge_refusal(self, message: str) -> tuple[str, str]:
        if self.refused is None:
            return "wrong", f"refused, but should be read: {message}"
        missing = [pattern for pattern in self.refused if not re.search(pattern, message, re.IGNORECASE)]
        long = refusal_faults(message)
        if missing or long:
            return "wrong", long or f"the refusal lacks {', '.join(missing)}: {message}"
        return "refused", message

    def _judge(self, tables) -> tuple[str, str]:
        if self.only:
            return "wrong", f"read, but should be refused: {[list(table.columns)[:8] for table in tables]}"
        wrong = []
        if self.runs is not None and len(tables) != self.runs:
            wrong.append(f"{len(tables)} runs, expected {self.runs}")
        for place, (pattern, values) in enumerate(self.columns):
            found = [(table, name) for table in tables for name in table.columns if re.fullmatch(pattern, name)]
            if not found:
                wrong.append(f"no column {pattern}; the columns are {[list(table.columns) for table in tables]}"[:300])
                continue
            table, name = found[0]
            column = np.asarray(table.columns[name], dtype=np.float64)
            same = len(column) == len(values) and np.allclose(column, values, atol=self.tolerance, equal_nan=True)
            wrong += [] if same else [f"{name} is {column[:3]} …, {len(column)} rows; expected {values[:3]} …"]
            if place == 0 and self.unit and table.units.get(name) != self.unit:
                wrong.append(f"the unit of {name} is {table.units.get(name)!r}; expected {self.unit!r}")
            if place == 0 and self.interval and (table.interval is None or abs(table.interval - self.interval) > 1e-9):
                wrong.append(f"the interval is {table.interval}; expected {self.interval} s")
        return ("wrong", "; ".join(wrong)) if wrong else ("survived", "")


def hidden(column: np.ndarray, row: int) -> np.ndarray:
    column = column.copy()
    column[row] = np.nan
    return column


def _at(name: str, write: Callable[..., None], **options) -> Callable[[Path], Path]:
    def written(folder: Path) -> Path:
        write(folder / name, **options)
        return folder / name

    return written


def _bag(**topics) -> Callable[[Path], Path]:
    return lambda folder: made.rosbag(folder / "bag", topics["topics"])


def _poses() -> list[tuple[int, bytes]]:
    return [(FIRST + 10_000_000 * k + 900, made.pose_stamped(FIRST + 10_000_000 * k, y))
            for k, y in enumerate(made.positions())]


def _commands(period: int = 20_000_000) -> list[tuple[int, bytes]]:
    return [(FIRST + 3_000_000 + period * k, made.float_array([0.1 * k, 0.0])) for k in range(10)]


def _joints() -> list[tuple[int, bytes]]:
    return [(FIRST + 10_000_000 * k, made.joint_state(FIRST + 10_000_000 * k, ["j1", "j2"], [0.1 * k, 1.0]))
            for k in range(20)]


Y = made.positions()
TIP = tuple((rf".*tip.*{axis}.*", Y[:, k]) for k, axis in enumerate(("[xX]", "[yY]", "[zZ]")))
TIP_EXACT = tuple((f"tip_{axis}", Y[:, k]) for k, axis in enumerate("XYZ"))
MOTIVE, QUALISYS, VICON = "motion capture: Motive", "motion capture: Qualisys", "motion capture: Vicon"
POSE = "geometry_msgs/msg/PoseStamped"

TRIALS = [
    FileTrial(MOTIVE, "version 1.23, two markers", _at("m.csv", made.motive), TIP_EXACT, 0.01, "mm"),
    FileTrial(MOTIVE, "a rigid body with quaternions before the markers", _at("m.csv", made.motive, body=True),
              TIP_EXACT,
              0.01, "mm"),
    FileTrial(MOTIVE, "a rigid body with Euler angles", _at("m.csv", made.motive, body=True, rotation="XYZ"), TIP_EXACT,
              0.01, "mm"),
    FileTrial(MOTIVE, "version 1.25 with a row of parents", _at("m.csv", made.motive, version="1.25", body=True),
              TIP_EXACT,
              0.01, "mm"),
    FileTrial(MOTIVE, "in metres", _at("m.csv", made.motive, units="Meters", scale=1e-3),
              (("tip_X", Y[:, 0] / 1e3),), 0.01, "m"),
    FileTrial(MOTIVE, "the tip hidden in row 7", _at("m.csv", made.motive, hidden=7), (("tip_X", hidden(Y[:, 0], 7)),),
              0.01),
    FileTrial(QUALISYS, "with rows of later versions", _at("m.tsv", made.qualisys, extra=True), TIP_EXACT, 0.01, "mm"),
    FileTrial(QUALISYS, "with Frame and Time", _at("m.tsv", made.qualisys, numbered=True), TIP_EXACT, 0.01, "mm"),
    FileTrial(QUALISYS, "with decimal frequency, named .txt",
              _at("m.txt", made.qualisys, frequency="100.0", extra=True),
              TIP_EXACT, 0.01, "mm"),
    FileTrial(QUALISYS, "6D, rigid bodies", _at("m.tsv", made.qualisys, six=True), refused=("6D",), only=True),
    FileTrial(VICON, "from frame 501 on", _at("m.csv", made.vicon, first=501), TIP_EXACT, 0.01, "mm"),
    FileTrial(VICON, "a section of devices before", _at("m.csv", made.vicon, devices=True), TIP_EXACT, 0.01, "mm"),
    FileTrial(VICON, "a section of model outputs before", _at("m.csv", made.vicon, model=True), TIP_EXACT, 0.01, "mm"),
    FileTrial(VICON, "the tip hidden in row 3", _at("m.csv", made.vicon, hidden=3), (("tip_X", hidden(Y[:, 0], 3)),),
              0.01),
    FileTrial("C3D", "two points", _at("m.c3d", made.c3d), TIP, 0.01, "mm", tolerance=1e-4),
    FileTrial("C3D", "an analog channel of ten times the rate", _at("m.c3d", made.c3d, analog=10), TIP, 0.01,
              tolerance=1e-4),
    FileTrial("C3D", "an invalid point in row 5", _at("m.c3d", made.c3d, invalid=5),
              ((".*tip.*[xX].*", hidden(Y[:, 0], 5)),),
              tolerance=1e-4),
    FileTrial("C3D", "in metres", _at("m.c3d", made.c3d, units="m"), TIP, unit="m", tolerance=1e-4),
    FileTrial("rosbag2", "poses, SQLite", _bag(topics={"/tip/pose": (POSE, _poses())}),
              ((r".*position.*x", Y[:, 0]), (r".*position.*z", Y[:, 2]))),
    FileTrial("rosbag2", "poses and arrays on two topics", _bag(topics={
        "/tip/pose": (POSE, _poses()), "/cmd": ("std_msgs/msg/Float64MultiArray", _commands())}),
        ((r".*position.*x", Y[:, 0]), (r".*data.*0.*", 0.1 * np.arange(10))), runs=2),
    FileTrial("rosbag2", "joint states without velocities", _bag(topics={"/joints": (
        "sensor_msgs/msg/JointState", _joints())}),
        ((r".*(position.*j1|j1.*position|position.*0).*", 0.1 * np.arange(20)),)),
    FileTrial("rosbag2", "a type that nobody knows",
              _bag(topics={"/odd": ("my_msgs/msg/Odd", [(FIRST, b"\0\1\0\0abcd")])}),
              refused=("my_msgs|Odd|type",), only=True),
    FileTrial("rosbag2", "messages that are cut",
              _bag(topics={"/tip/pose": (POSE, [(s, d[:30]) for s, d in _poses()])}),
              refused=("tip|pose|message",), only=True),
]
