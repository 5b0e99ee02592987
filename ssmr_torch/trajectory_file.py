"""The HDF5 file of trajectories: written whole, checked whole when it is opened, then read slice by slice."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import h5py
import numpy as np

from ssmr_torch import checksum
from ssmr_torch.hdf5_file import card_of, new_hdf5, numbers, open_hdf5, text
from ssmr_torch.run import JITTER_TOLERANCE, KINDS, SPLITS, STRETCH, Run, Trajectory

OF_A_RUN = 2 ** 14  # bytes in the file beside the samples of a run
FORMAT = "ssmr_torch trajectories 2"
BEFORE = "ssmr_torch trajectories 1"  # of versions up to 0.11, without a checksum
CARD = {"length_unit": str, "time_unit": str, "input_unit": str, "output_names": list, "input_names": list,
        "provenance": dict}


@dataclass(frozen=True)
class StoredTrajectory(Run):
    """A trajectory in an HDF5 file that is read slice by slice, so that memory does not grow with its length.

    identity: of the file's content. When the file was replaced by another one, reading raises ValueError.
    """

    path: Path
    key: str
    kind: str
    split: str
    name: str
    length: int
    timestep: float
    first: int = 0
    columns: tuple[int, ...] | None = None
    identity: str = ""

    def slice(self, start: int, stop: int) -> tuple[np.ndarray, np.ndarray]:
        """Observations and inputs of the samples start ≤ k < stop."""
        start, stop, _ = slice(start, stop).indices(self.length)
        rows = slice(self.first + start, self.first + max(start, stop))
        group = _opened(self.path, self.identity)[self.key]
        return self._observed(group["observation"][rows]), group["input"][rows]

    def observing(self, columns: Sequence[int]) -> StoredTrajectory:
        """The same run with only these columns of the observation."""
        available = range(self.slice(0, 1)[0].shape[1]) if self.columns is None else self.columns
        return replace(self, columns=tuple(available[column] for column in columns))

    def _observed(self, observation: np.ndarray) -> np.ndarray:
        return observation if self.columns is None else observation[:, list(self.columns)]

    def part(self, start: int, stop: int | None = None, **changes) -> StoredTrajectory:
        """The samples start ≤ k < stop as a separate trajectory, with other fields changed by name."""
        start, stop, _ = slice(start, stop).indices(self.length)
        if stop - start < 2:
            raise ValueError(f"{self.name or 'trajectory'}: {max(stop - start, 0)} samples; expected at least 2")
        return replace(self, first=self.first + start, length=stop - start, **changes)

    def read(self) -> Trajectory:
        rows = slice(self.first, self.first + self.length)
        group = _opened(self.path, self.identity)[self.key]
        return Trajectory(group["time"][rows], self._observed(group["observation"][rows]), group["input"][rows],
                          self.kind, self.split, self.name)


def save_runs(path: str | Path, runs: Sequence[Trajectory | StoredTrajectory], rest: np.ndarray,
              card: Mapping) -> Path:
    """Write runs, their rest position (p,) m, and their card to one HDF5 file, which appears only when it is complete.
    """
    stated = json.dumps({"format": FORMAT, "length_unit": "m", "time_unit": "s", **card})
    size = sum(run.length for run in runs) * 8 * (1 + len(card["output_names"]) + len(card["input_names"]))
    with new_hdf5(path, size + OF_A_RUN * (1 + len(runs)), sealed=True) as file:
        file.attrs["card"] = stated
        file["rest"] = rest
        for index, stored in enumerate(runs):
            run = stored.read()
            group = file.create_group(f"trajectories/{index:05d}")
            for attribute in ("time", "observation", "input"):
                group[attribute] = getattr(run, attribute)
            group.attrs.update(kind=run.kind, split=run.split, name=run.name, timestep=run.timestep)
    return Path(path)


def load_runs(path: str | Path) -> tuple[tuple[StoredTrajectory, ...], np.ndarray, dict]:
    """The runs in a file of `save_runs`, their rest position and their card. Every value is checked once.

    Raises FileNotFoundError, ValueError for a file of another kind, and `checksum.Damaged` for one that is damaged.
    """
    path = Path(path).resolve()
    if not path.is_file():
        raise FileNotFoundError(f"there is no trajectory file at {path}; make one with ssmr collect")
    sealed = checksum.check(path) is not None
    if not h5py.is_hdf5(path):
        raise ValueError(f"{path} is not an HDF5 file; expected one written by ssmr collect")
    with open_hdf5(path) as file:
        if "card" not in file.attrs or "trajectories" not in file:
            raise ValueError(f"{path} is not a trajectory file of this package; read other HDF5 files with a "
                             "recording card: data=custom data.card=FILE.yaml")
        card = card_of(file, path)
        if card.get("format") not in (FORMAT, BEFORE):
            raise ValueError(f"{path} has the format {card.get('format')!r}; this version reads {FORMAT!r} and "
                             f"{BEFORE!r}")
        checksum.refuse_unsealed(path, sealed, card["format"], BEFORE)
        _refuse_card(path, card)
        try:
            identity = _identity(path)
            runs = tuple(_stored(path, file, f"trajectories/{key}", identity) for key in sorted(file["trajectories"]))
            rest = numbers(file, "rest", (len(card["output_names"]),))
        except (KeyError, AttributeError, TypeError, OSError, RuntimeError) as error:
            raise checksum.Damaged(f"{path} is damaged ({error}); copy or collect it again") from error
        except ValueError as error:
            raise checksum.Damaged(f"{path}: {error}; copy or collect it again") from error
    return runs, rest, card


def format_of(path: str | Path) -> str:
    """The format that an HDF5 file names in its attribute "card"; empty for a file of another kind."""
    if not h5py.is_hdf5(path):
        return ""
    with open_hdf5(path) as file:
        return str(card_of(file, path).get("format", "HDF5 without a card")) if "card" in file.attrs else \
            "HDF5 without a card"


def _refuse_card(path: Path, card: dict) -> None:
    wrong = [name for name, kind in CARD.items() if not isinstance(card.get(name), kind)]
    wrong += [name for name in ("output_names", "input_names") if name not in wrong
              and not all(isinstance(each, str) for each in card[name])]
    wrong += [name for name, unit in (("length_unit", "m"), ("time_unit", "s")) if card.get(name) != unit]
    if wrong:
        raise checksum.Damaged(f"{path} has no valid {', '.join(dict.fromkeys(wrong))} in its card; copy or collect it "
                               "again")


def _stored(path: Path, file: h5py.File, key: str, identity: str) -> StoredTrajectory:
    """One run of the file, after each of its values was read. Raises ValueError for values that no run has."""
    group = file[key]
    name, kind, split = (text(group, what) for what in ("name", "kind", "split"))
    named, timestep = name or key, float(group.attrs["timestep"])
    if kind not in KINDS or split not in SPLITS:
        raise ValueError(f"{named} has the kind {kind!r} and the split {split!r}; expected one of {KINDS} and one of "
                         f"{SPLITS}")
    length = len(group["time"])
    shapes = {"time": (length,), "observation": (length, None), "input": (length, None)}
    for what, shape in shapes.items():
        given = group[what]
        if given.dtype.kind != "f" or given.ndim != len(shape) or given.shape[0] != length or length < 2:
            raise ValueError(f"{named}: {what} has the shape {given.shape} and the type {given.dtype}; expected "
                             f"{length if length > 1 else 'at least 2'} rows of numbers")
        for start in range(0, length, STRETCH):
            finite = np.isfinite(given[start:start + STRETCH]).reshape(-1, *(() if what == "time" else given.shape[1:]))
            if not finite.all():
                first = start + int(np.argmin(finite.reshape(len(finite), -1).all(axis=1)))
                raise ValueError(f"{named}: sample {first} of {what} is not finite")
    _refuse_times(group["time"], named, timestep)
    return StoredTrajectory(path, key, kind, split, name, length, timestep, identity=identity)


def _refuse_times(time: h5py.Dataset, named: str, timestep: float) -> None:
    """Raises ValueError unless the times increase by the timestep (s), within `JITTER_TOLERANCE`."""
    if not 0 < timestep < np.inf:
        raise ValueError(f"{named} is sampled every {timestep} s; expected a positive number")
    for start in range(0, len(time) - 1, STRETCH):
        off = np.abs(np.diff(time[start:start + STRETCH + 1]) / timestep - 1.0) > 2 * JITTER_TOLERANCE
        if off.any():
            raise ValueError(f"{named}: the time after sample {start + int(np.argmax(off))} does not follow "
                             f"{timestep:.6g} s later, as the file says")


def _identity(path: Path) -> str:
    """What a file of other content does not have: its checksum, or its size and time where it has none."""
    given = checksum.noted(path)
    if given is not None:
        return given
    status = os.stat(path)
    return f"{status.st_size} bytes of {status.st_mtime_ns}"


def _opened(path: Path, identity: str) -> h5py.File:
    """The file, which stays open for reading, because opening takes fifty times longer than reading a window."""
    status = os.stat(path)
    return _open_once(path, status.st_ino, status.st_mtime_ns, os.getpid(), identity)


@lru_cache(maxsize=4)
def _open_once(path: Path, inode: int, modified: int, process: int, identity: str) -> h5py.File:
    if identity and _identity(path) != identity:
        raise ValueError(f"{path} was replaced since its trajectories were loaded; load it again")
    return h5py.File(path, "r")  # its content was checked when it was loaded
