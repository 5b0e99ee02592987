"""Measured or simulated trajectories, and their file.

A trajectory is one uninterrupted, uniformly sampled run: a seam (a restart, a glued recording) is never inside.
"""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path

import h5py
import numpy as np

KINDS = ("decay", "controlled", "static")
SPLITS = ("train", "validation", "test")
JITTER_TOLERANCE = 1e-3
FORMAT = "ssmr_torch trajectories 1"


@dataclass(frozen=True, eq=False)
class Trajectory:
    """One run of a robot.

    time: (T,) s, strictly increasing, uniform within `JITTER_TOLERANCE` of its step.
    observation: (T, p) displacement from the rest position, m.
    input: (T, m); input[k] is held from time[k] to time[k+1], so observation[k] does not feel it yet.
    Raises ValueError when the arrays disagree in length, hold non-finite numbers, or time is not uniform.
    """

    time: np.ndarray
    observation: np.ndarray
    input: np.ndarray
    kind: str = "controlled"
    split: str = "train"
    name: str = ""

    def __post_init__(self):
        for attribute in ("time", "observation", "input"):
            object.__setattr__(self, attribute, _own(getattr(self, attribute)))
        _validate(self)

    @property
    def length(self) -> int:
        return len(self.time)

    @property
    def timestep(self) -> float:
        """Sampling time in s."""
        return float((self.time[-1] - self.time[0]) / (self.length - 1))

    def slice(self, start: int, stop: int) -> tuple[np.ndarray, np.ndarray]:
        """Observations and inputs of the samples start ≤ k < stop."""
        return self.observation[start:stop], self.input[start:stop]

    def read(self) -> Trajectory:
        return self

    def observing(self, columns: Sequence[int]) -> Trajectory:
        """The same run seen through these columns of the observation."""
        return replace(self, observation=self.observation[:, list(columns)])

    def part(self, start: int, stop: int | None = None, **changes) -> Trajectory:
        """The samples start ≤ k < stop as a trajectory of their own, with other fields changed by name."""
        kept = slice(start, stop)
        return replace(self, time=self.time[kept], observation=self.observation[kept], input=self.input[kept],
                       **changes)


@dataclass(frozen=True)
class StoredTrajectory:
    """A trajectory in an HDF5 file, read slice by slice: memory does not grow with its length."""

    path: Path
    key: str
    kind: str
    split: str
    name: str
    length: int
    timestep: float
    first: int = 0
    columns: tuple[int, ...] | None = None

    def slice(self, start: int, stop: int) -> tuple[np.ndarray, np.ndarray]:
        """Observations and inputs of the samples start ≤ k < stop."""
        start, stop, _ = slice(start, stop).indices(self.length)
        rows = slice(self.first + start, self.first + max(start, stop))
        group = _opened(self.path)[self.key]
        return self._observed(group["observation"][rows]), group["input"][rows]

    def observing(self, columns: Sequence[int]) -> StoredTrajectory:
        """The same run seen through these columns of the observation."""
        available = range(self.slice(0, 1)[0].shape[1]) if self.columns is None else self.columns
        return replace(self, columns=tuple(available[column] for column in columns))

    def _observed(self, observation: np.ndarray) -> np.ndarray:
        return observation if self.columns is None else observation[:, list(self.columns)]

    def part(self, start: int, stop: int | None = None, **changes) -> StoredTrajectory:
        """The samples start ≤ k < stop as a trajectory of their own, with other fields changed by name."""
        start, stop, _ = slice(start, stop).indices(self.length)
        if stop - start < 2:
            raise ValueError(f"{self.name or 'trajectory'}: {max(stop - start, 0)} samples; at least 2 are needed")
        return replace(self, first=self.first + start, length=stop - start, **changes)

    def read(self) -> Trajectory:
        rows = slice(self.first, self.first + self.length)
        group = _opened(self.path)[self.key]
        return Trajectory(group["time"][rows], self._observed(group["observation"][rows]), group["input"][rows],
                          self.kind, self.split, self.name)


@dataclass(frozen=True, eq=False)
class TrajectoryDataset(Sequence):
    """Trajectories of one robot, with what is needed to read them.

    rest: (p,) absolute position of the origin of `observation`, m.
    output_names, input_names: one label per column. input_unit: "N", or "1" for normalized commands.
    provenance: plain JSON values (where the data came from, what the reader assumed).
    Raises ValueError when two trajectories differ in their numbers of columns, or in sampling time by more than
    `JITTER_TOLERANCE`.
    """

    trajectories: tuple[Trajectory | StoredTrajectory, ...]
    rest: np.ndarray
    output_names: tuple[str, ...]
    input_names: tuple[str, ...]
    input_unit: str = "N"
    provenance: dict = field(default_factory=dict)

    def __post_init__(self):
        object.__setattr__(self, "trajectories", tuple(self.trajectories))
        object.__setattr__(self, "rest", _own(self.rest))
        object.__setattr__(self, "output_names", tuple(self.output_names))
        object.__setattr__(self, "input_names", tuple(self.input_names))
        if not self.trajectories:
            raise ValueError("the dataset holds no trajectory; at least one is needed")
        if self.rest.shape != (self.output_dim,):
            raise ValueError(f"rest has shape {self.rest.shape}, but there are {self.output_dim} output names")
        for trajectory in self.trajectories:
            columns = tuple(a.shape[1] for a in trajectory.slice(0, 1))
            if columns != (self.output_dim, self.input_dim):
                raise ValueError(f"trajectory {trajectory.name!r} has {columns[0]} outputs and {columns[1]} inputs; "
                                 f"the dataset declares {self.output_dim} and {self.input_dim}")
            if abs(trajectory.timestep / self.trajectories[0].timestep - 1) > JITTER_TOLERANCE:
                raise ValueError(f"trajectory {trajectory.name!r} is sampled every {trajectory.timestep:.6g} s, the "
                                 f"first one every {self.trajectories[0].timestep:.6g} s; resample them alike")

    def __len__(self) -> int:
        return len(self.trajectories)

    def __getitem__(self, index):
        return self.trajectories[index]

    @property
    def output_dim(self) -> int:
        return len(self.output_names)

    @property
    def input_dim(self) -> int:
        return len(self.input_names)

    @property
    def timestep(self) -> float:
        """Median sampling time in s."""
        return float(np.median([trajectory.timestep for trajectory in self.trajectories]))

    def select(self, split: str | None = None, kind: str | None = None) -> tuple:
        """Trajectories of this split ("train", "validation", "test") and kind ("decay", "controlled", "static")."""
        return tuple(t for t in self.trajectories
                     if (split is None or t.split == split) and (kind is None or t.kind == kind))

    def columns(self, names: Sequence[str] | None = None) -> list[int]:
        """Positions of these outputs, of all where none are named. Raises ValueError for an unknown name."""
        unknown = [name for name in names or () if name not in self.output_names]
        if unknown:
            raise ValueError(f"no outputs {unknown}; the dataset has {list(self.output_names)}")
        return [self.output_names.index(name) for name in (self.output_names if names is None else names)]

    def observing(self, names: Sequence[str] | None) -> TrajectoryDataset:
        """The same runs seen through these outputs only, in this order; all of them where none are named."""
        if names is None or tuple(names) == self.output_names:
            return self
        columns = self.columns(names)
        return replace(self, trajectories=tuple(t.observing(columns) for t in self.trajectories),
                       rest=self.rest[columns], output_names=tuple(names))

    def save(self, path: str | Path) -> Path:
        """Write all trajectories to one HDF5 file; the file appears only when it is complete."""
        path = Path(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        aside, card = path.with_name(path.name + ".part"), json.dumps(self._card())
        with h5py.File(aside, "w") as file:
            file.attrs["card"] = card
            file["rest"] = self.rest
            for index, stored in enumerate(self.trajectories):
                trajectory = stored.read()
                group = file.create_group(f"trajectories/{index:05d}")
                for attribute in ("time", "observation", "input"):
                    group[attribute] = getattr(trajectory, attribute)
                group.attrs.update(kind=trajectory.kind, split=trajectory.split, name=trajectory.name,
                                   timestep=trajectory.timestep)
        os.replace(aside, path)
        return path

    def _card(self) -> dict:
        return {"format": FORMAT, "length_unit": "m", "time_unit": "s",
                "input_unit": self.input_unit, "output_names": self.output_names,
                "input_names": self.input_names, "provenance": self.provenance}

    @classmethod
    def load(cls, path: str | Path) -> TrajectoryDataset:
        """Open a file written by `save`; samples stay on disk until they are asked for.

        Raises FileNotFoundError, ValueError for a file of another kind, OSError for a truncated one.
        """
        path = Path(path).resolve()
        if not path.is_file():
            raise FileNotFoundError(f"no trajectory file at {path}; make one with experiments/collect.py")
        if not h5py.is_hdf5(path):
            raise ValueError(f"{path} is not an HDF5 file; expected one written by experiments/collect.py")
        with h5py.File(path, "r") as file:
            if "card" not in file.attrs or "trajectories" not in file:
                raise ValueError(f"{path} is not a trajectory file of this package (no card); "
                                 "read foreign HDF5 with a card: data=custom data.card=FILE.yaml")
            card = json.loads(file.attrs["card"])
            if card.get("format") != FORMAT:
                raise ValueError(f"{path} is of format {card.get('format')!r}; this version reads {FORMAT!r}")
            stored = tuple(
                StoredTrajectory(path, f"trajectories/{key}", group.attrs["kind"], group.attrs["split"],
                                 group.attrs["name"], len(group["time"]), float(group.attrs["timestep"]))
                for key, group in sorted(file["trajectories"].items()))
            rest = file["rest"][:]
        return cls(stored, rest, card["output_names"], card["input_names"], card["input_unit"],
                   card["provenance"])


def _own(array) -> np.ndarray:
    """A read-only copy: what the caller does with the original later changes nothing here."""
    copy = np.array(array, dtype=np.float64)
    copy.setflags(write=False)
    return copy


def _opened(path: Path) -> h5py.File:
    """The file, kept open for reading: opening takes fifty times as long as reading a window."""
    status = os.stat(path)
    return _open_once(path, status.st_ino, status.st_mtime_ns, os.getpid())


@lru_cache(maxsize=4)
def _open_once(path: Path, inode: int, modified: int, process: int) -> h5py.File:
    return h5py.File(path, "r")


def _validate(trajectory: Trajectory) -> None:
    name = trajectory.name or "trajectory"
    time, observation, inputs = trajectory.time, trajectory.observation, trajectory.input
    if time.ndim != 1 or observation.ndim != 2 or inputs.ndim != 2:
        raise ValueError(f"{name}: expected time (T,), observation (T, p), input (T, m); "
                         f"got {time.shape}, {observation.shape}, {inputs.shape}")
    if not len(time) == len(observation) == len(inputs):
        raise ValueError(f"{name}: {len(time)} times, {len(observation)} observations and {len(inputs)} inputs; "
                         "the three must be equally many")
    if len(time) < 2:
        raise ValueError(f"{name}: {len(time)} samples; at least 2 are needed")
    if trajectory.kind not in KINDS or trajectory.split not in SPLITS:
        raise ValueError(f"{name}: kind {trajectory.kind!r} and split {trajectory.split!r}; "
                         f"expected one of {KINDS} and one of {SPLITS}")
    for label, array in (("time", time), ("observation", observation), ("input", inputs)):
        bad = np.flatnonzero(~np.isfinite(array.reshape(len(array), -1)).all(axis=1))
        if len(bad):
            raise ValueError(f"{name}: {len(bad)} of {len(array)} samples of {label} are not finite, "
                             f"the first is sample {bad[0]}; drop or repair them")
    steps = np.diff(time)
    if (steps <= 0).any():
        raise ValueError(f"{name}: time does not increase at sample {int(np.argmax(steps <= 0)) + 1}")
    jitter = np.abs(steps / trajectory.timestep - 1).max()
    if jitter > JITTER_TOLERANCE:
        raise ValueError(f"{name}: the sampling interval deviates by up to {100 * jitter:.3g} % from "
                         f"{trajectory.timestep:.6g} s, more than {100 * JITTER_TOLERANCE:g} %; "
                         "resample onto a uniform grid first")
