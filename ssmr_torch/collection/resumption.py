"""What a collection has recorded so far: one file per finished trajectory, so that a kill loses none of them."""

from __future__ import annotations

import logging
import reprlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from urllib.parse import quote

import h5py

from ssmr_torch.checksum import Damaged
from ssmr_torch.trajectory import Trajectory, TrajectoryDataset

COMPLETE = "trajectories.h5"
FOLDER = "recorded"
COMMON = ("source", "package", "seed", "plant")  # provenance that all trajectories of a collection share
log = logging.getLogger(__name__)
REMEDY = "choose another directory, or remove it if it is no longer needed"


@dataclass(frozen=True)
class Recorded:
    """directory/recorded/NAME.h5 for every finished trajectory, until all are in directory/trajectories.h5.

    provenance: of the collection that is asked for, with its "plans". Files of another one raise ValueError.
    """

    directory: Path
    provenance: dict

    @property
    def folder(self) -> Path:
        return self.directory / FOLDER

    def complete(self) -> TrajectoryDataset | None:
        """The dataset in trajectories.h5, where there is one."""
        path = self.directory / COMPLETE
        if not path.exists():
            return None
        dataset = TrajectoryDataset.load(path)
        found = self._refuse_another(path, dataset)
        missing = [plan["name"] for plan in self.provenance["plans"] if plan["name"] not in found]
        if missing:
            raise ValueError(f"{path} holds {len(found)} trajectories but not {missing[0]}; {REMEDY}")
        return dataset

    def take(self) -> dict[str, Trajectory]:
        """The finished trajectories by name; files that were not written to their end are left out."""
        finished = {}
        for path in sorted(self.folder.glob("*.h5")):
            if not h5py.is_hdf5(path):
                continue
            try:
                dataset = TrajectoryDataset.load(path)
                finished |= {stored.name: stored.read() for stored in dataset}
            except Damaged as error:
                log.warning("%s; it is recorded again", error)
                continue
            self._refuse_another(path, dataset)
        return finished

    def keep(self, dataset: TrajectoryDataset) -> None:
        """Write the one trajectory of this dataset."""
        name = dataset[0].name
        plans = [plan for plan in self.provenance["plans"] if plan["name"] == name]
        part = replace(dataset, provenance=self.provenance | {"plans": plans})
        part.save(self.folder / f"{quote(name, safe='')}.h5")

    def _refuse_another(self, path: Path, dataset: TrajectoryDataset) -> dict[str, dict]:
        """The origin of each trajectory in the file, each as it is asked for."""
        found, asked = _origins(dataset.provenance), _origins(self.provenance)
        for name in found or {trajectory.name: None for trajectory in dataset}:
            if name not in asked:
                raise ValueError(f"{path} holds {name}, which is not part of this collection; {REMEDY}")
            if found.get(name) != asked[name]:
                raise ValueError(f"{path} holds {name} of another collection: "
                                 f"{_difference(found.get(name), asked[name])}; {REMEDY}")
        return found


def discard_recorded(directory: str | Path) -> None:
    """Remove the files of single trajectories; to be called when all of them are in trajectories.h5."""
    folder = Path(directory) / FOLDER
    for pattern in ("*.h5", "*.part"):
        for path in folder.glob(pattern):
            path.unlink()
    if folder.is_dir() and not any(folder.iterdir()):
        folder.rmdir()


def _origins(provenance: Mapping) -> dict[str, dict]:
    """What each trajectory depends on, by name."""
    common = {key: provenance.get(key) for key in COMMON}
    return {plan["name"]: common | {"plan": plan} for plan in provenance.get("plans", ())}


def _difference(was: object, now: object, at: str = "origin") -> str:
    """The first setting in which two origins differ, with both values."""
    if isinstance(was, dict) and isinstance(now, dict):
        key = next(key for key in [*was, *now] if was.get(key) != now.get(key))
        return _difference(was.get(key), now.get(key), key if at == "origin" else f"{at}.{key}")
    return f"{at} was {reprlib.repr(was)}, now it is {reprlib.repr(now)}"
