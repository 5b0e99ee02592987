"""`TrajectoryDataset`: the measured or simulated trajectories of one robot, in memory or in an HDF5 file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ssmr_torch import data_sheet as sheet
from ssmr_torch.data_sheet import DataSheet
from ssmr_torch.run import JITTER_TOLERANCE, KINDS, SPLITS, Trajectory, own_copy
from ssmr_torch.trajectory_file import StoredTrajectory, format_of, load_runs, save_runs

__all__ = ["JITTER_TOLERANCE", "KINDS", "SPLITS", "StoredTrajectory", "Trajectory", "TrajectoryDataset",
           "format_of", "refuse_other_data"]

@dataclass(frozen=True, eq=False)
class TrajectoryDataset(DataSheet, Sequence):
    """Trajectories of one robot, with the names, units and rest position of their data.

    rest: (p,) absolute position of the origin of `observation`, m.
    output_names, input_names: one label per column. input_unit: "N", or "1" for normalized commands.
    provenance: plain JSON values (source of the data, assumptions of the reader).

    Raises ValueError if two trajectories differ in their numbers of columns, or in sampling time by more than
    `JITTER_TOLERANCE`.

    >>> decay = Trajectory([0.0, 0.1, 0.2], [[0.003], [0.001], [0.0]], np.zeros((3, 1)), "decay", name="decay 1")
    >>> TrajectoryDataset([decay], rest=[0.12], output_names=["tip_z"], input_names=["cable"])
    TrajectoryDataset: 1 run, 3 samples, 0.1 s (10 Hz)
    ├─ runs
    │  └─ decay, train: 1 run, 3 samples
    ├─ outputs: displacement from rest
    │  └─ tip_z: 0 … 3 mm
    ├─ inputs: held from sample to sample
    │  └─ cable: 0 … 0 N
    └─ rest: 120 mm
    """

    trajectories: tuple[Trajectory | StoredTrajectory, ...]
    rest: np.ndarray
    output_names: tuple[str, ...]
    input_names: tuple[str, ...]
    input_unit: str = "N"
    provenance: dict = field(default_factory=dict)

    def __post_init__(self):
        object.__setattr__(self, "trajectories", tuple(self.trajectories))
        object.__setattr__(self, "rest", own_copy(self.rest))
        object.__setattr__(self, "output_names", tuple(self.output_names))
        object.__setattr__(self, "input_names", tuple(self.input_names))
        if not self.trajectories:
            raise ValueError("the dataset contains no trajectory; expected at least one")
        for what, names in (("outputs", self.output_names), ("inputs", self.input_names)):
            twice = sorted({name for name in names if names.count(name) > 1})
            if twice:
                raise ValueError(f"two {what} are named {twice[0]!r}; give each a different name")
        if self.rest.shape != (self.output_dim,):
            raise ValueError(f"rest has shape {self.rest.shape}, but there are {self.output_dim} output names")
        for trajectory in self.trajectories:
            columns = tuple(a.shape[1] for a in trajectory.slice(0, 1))
            if columns != (self.output_dim, self.input_dim):
                raise ValueError(f"trajectory {trajectory.name!r} has {columns[0]} outputs and {columns[1]} inputs; "
                                 f"the dataset declares {self.output_dim} and {self.input_dim}")
            if abs(trajectory.timestep / self.trajectories[0].timestep - 1) > JITTER_TOLERANCE:
                raise ValueError(f"trajectory {trajectory.name!r} is sampled every {trajectory.timestep:.6g} s, but "
                                 f"the first one every {self.trajectories[0].timestep:.6g} s; resample all to one "
                                 "sampling time")

    def __len__(self) -> int:
        return len(self.trajectories)

    def __getitem__(self, index: Any) -> Any:
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
        """Trajectories of this split ("train", "validation", "test") and kind ("decay", "controlled", "static").

        Raises ValueError for a split or a kind that does not exist.
        """
        for what, asked, known in (("split", split, SPLITS), ("kind", kind, KINDS)):
            if asked is not None and asked not in known:
                raise ValueError(f"there is no {what} {asked!r}; expected one of {known}, or None for all")
        return tuple(t for t in self.trajectories
                     if (split is None or t.split == split) and (kind is None or t.kind == kind))

    def columns(self, names: Sequence[str] | None = None) -> list[int]:
        """Column numbers of these outputs, or of all outputs for None. Raises ValueError for an unknown name."""
        names = (names,) if isinstance(names, str) else names
        unknown = [name for name in names or () if name not in self.output_names]
        if unknown:
            raise ValueError(f"there are no outputs {unknown}; the dataset has {list(self.output_names)}")
        return [self.output_names.index(name) for name in (self.output_names if names is None else names)]

    def observing(self, names: Sequence[str] | None) -> TrajectoryDataset:
        """The same runs with only these outputs, in this order; None: all outputs."""
        names = (names,) if isinstance(names, str) else names
        if names is None or tuple(names) == self.output_names:
            return self
        columns = self.columns(names)
        return replace(self, trajectories=tuple(t.observing(columns) for t in self.trajectories),
                       rest=self.rest[columns], output_names=tuple(names))

    def extremes(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest values over all runs: outputs (2, p), m, and inputs (2, m)."""
        found = zip(*(run.extremes() for run in self.trajectories))
        outputs, inputs = (np.stack([np.min([each[0] for each in of_runs], axis=0),
                                     np.max([each[1] for each in of_runs], axis=0)]) for of_runs in map(list, found))
        return outputs, inputs

    def data_sheet(self) -> tuple[str, dict]:
        uses: dict[str, list] = {}
        for run in self.trajectories:
            uses.setdefault(f"{run.kind}, {run.split}", []).append(run.length)
        observation, inputs = self.extremes()
        return f"TrajectoryDataset: {_counted([run.length for run in self])}, {sheet.period(self.timestep)}", {
            "runs": {use: _counted(lengths) for use, lengths in uses.items()},
            "outputs: displacement from rest": sheet.spans(self.output_names, observation[0], observation[1], "mm",
                                                           1e3),
            "inputs: held from sample to sample": sheet.spans(self.input_names, inputs[0], inputs[1],
                                                              sheet.unit_of(self.input_unit)),
            "rest": f"{sheet.listed(sheet.number(1e3 * x) for x in self.rest)} mm",
        } | sheet.origin(self.provenance)

    def save(self, path: str | Path) -> Path:
        """Write all trajectories to one HDF5 file; the file appears only when it is complete."""
        return save_runs(path, self.trajectories, self.rest, {
            "input_unit": self.input_unit, "output_names": self.output_names, "input_names": self.input_names,
            "provenance": self.provenance})

    @classmethod
    def load(cls, path: str | Path) -> TrajectoryDataset:
        """Open a file written by `save`; samples stay on disk until they are asked for.

        Raises FileNotFoundError, and ValueError for a file of another kind or a damaged one. Reading samples after the
        file was replaced by another one raises ValueError, too.
        """
        stored, rest, card = load_runs(path)
        return cls(stored, rest, card["output_names"], card["input_names"], card["input_unit"], card["provenance"])


def _counted(lengths: Sequence[int]) -> str:
    return f"{len(lengths)} {'run' if len(lengths) == 1 else 'runs'}, {sum(lengths)} samples"


def refuse_other_data(data) -> None:
    """Raises TypeError unless data is a `TrajectoryDataset`."""
    if not isinstance(data, TrajectoryDataset):
        raise TypeError(f"data is a {type(data).__name__}; expected a TrajectoryDataset, which read, load and "
                        "trajectories return")
