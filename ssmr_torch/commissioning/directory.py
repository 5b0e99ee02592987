"""The directory of one robot's commissioning: confirmed steps, measurements, recordings. Files appear only complete."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import h5py
import numpy as np

from ssmr_torch import __version__, checksum
from ssmr_torch.closed_loop.record import ClosedLoopRecord
from ssmr_torch.collection.resumption import COMPLETE, FOLDER, discard_recorded
from ssmr_torch.commissioning.robot_card import RobotCard, changed_keys, read_robot_card
from ssmr_torch.plants.base import Plant
from ssmr_torch.result_files import read_json, save_text
from ssmr_torch.trajectory import Trajectory, TrajectoryDataset

CARD, PROGRESS, REPORT = "card.yaml", "progress.json", "commissioning.md"
SOURCE = "commissioning"
RUNS = "collected"  # one folder for each share of the input range


class CommissioningDirectory:
    """The files of one commissioning under one path. Each is written aside and then renamed."""

    def __init__(self, path: str | Path):
        self.path = Path(path)
        self.path.mkdir(parents=True, exist_ok=True)

    def confirmed(self) -> list[dict]:
        """The confirmed steps in order, each with `step`, `time`, `said` and `faults`."""
        path = self.path / PROGRESS
        return read_json(path)["confirmed"] if path.is_file() else []

    def confirm(self, step: str, said: str, faults: Sequence[str]) -> None:
        now = datetime.now(UTC).isoformat(timespec="seconds")
        entry = {"step": step, "time": now, "said": said, "faults": list(faults)}
        self.write_json(PROGRESS, {"package": f"ssmr_torch {__version__}", "confirmed": [*self.confirmed(), entry]})

    def write(self, name: str, text: str) -> Path:
        return save_text(self.path / name, text)

    def write_json(self, name: str, content: dict | list) -> Path:
        sealed = isinstance(content, dict)
        return self.write(name, checksum.sealed_json(content, 1) if sealed else json.dumps(content, indent=1) + "\n")

    def read_json(self, name: str) -> dict | list:
        path = self.path / name
        if not path.is_file():
            raise FileNotFoundError(f"there is no {name} in {self.path}, although its step is confirmed; remove "
                                    f"{PROGRESS} to start again")
        return read_json(path)

    def has(self, name: str) -> bool:
        return (self.path / name).exists()

    def keep_card(self, card: RobotCard) -> None:
        """Write card.yaml. Raises ValueError where the measurements here belong to another card; limits may change."""
        if self.confirmed() and self.has(CARD):
            differences = changed_keys(read_robot_card(self.path / CARD), card)
            if differences:
                raise ValueError(f"{self.path} belongs to another card: {differences[0]}; choose another directory, or "
                                 "remove this one if it is no longer needed")
        self.write(CARD, card.text())

    def keep_runs(self, name: str, runs: Sequence[Trajectory], plant: Plant) -> None:
        """Write the runs of a step as NAME.h5."""
        dataset_of(plant, runs, {}).save(self.path / f"{name}.h5")

    def keep_record(self, step: str, record: ClosedLoopRecord) -> None:
        record.save(self.path / f"{step.replace(' ', '_')}.h5")

    def records(self) -> list[ClosedLoopRecord]:
        """The records of the circles drawn so far, the slow one first."""
        paths = [self.path / f"{speed}_circle.h5" for speed in ("slow", "fast")]
        return [ClosedLoopRecord.load(path) for path in paths if path.is_file()]

    def draw(self, name: str, *shown) -> None:
        """Write NAME.svg with the function of this name in `evaluation.commissioning_figures`."""
        from ssmr_torch.evaluation import commissioning_figures, figures

        figures.save(getattr(commissioning_figures, name)(*shown), self.path / f"{name}.svg")

    def stopped(self, step: str, run: Trajectory | None, plant: Plant, reason: str) -> Path | None:
        """Keep a stopped run as stopped/STEP-N.h5, with the reason in it; None where there is no run."""
        if run is None:
            return None
        folder, name = self.path / "stopped", step.replace(" ", "_")
        number = 1 + len(list(folder.glob(f"{name}-*.h5")))
        marked = dataset_of(plant, [replace(run, name=f"{step} {number}, stopped")], {"stopped": reason})
        return marked.save(folder / f"{name}-{number}.h5")

    def runs_folder(self, share: float) -> Path:
        return self.path / RUNS / f"{share:.4f}"

    def gathered(self, plant: Plant) -> list[Trajectory]:
        """The finished runs of all shares of the input range, those of the largest share first. Where the share is not
        1, it is added to the run's name.
        """
        found = []
        for folder in sorted((self.path / RUNS).glob("*"), reverse=True):
            share = float(folder.name)
            for path in (path for path in sorted((folder / FOLDER).glob("*.h5")) if h5py.is_hdf5(path)):
                for stored in TrajectoryDataset.load(path):
                    run = stored.read()
                    found.append(run if share == 1 else replace(run, name=f"{run.name}, {100 * share:.3g} %"))
        return found

    def keep_trajectories(self, data: TrajectoryDataset) -> None:
        """Write all runs to trajectories.h5."""
        data.save(self.path / COMPLETE)

    def trajectories(self) -> TrajectoryDataset:
        """The runs in trajectories.h5. The files of the single runs are then no longer needed, and are removed.

        Raises ValueError for recordings that do not come from a commissioning.
        """
        data = TrajectoryDataset.load(self.path / COMPLETE)
        if data.provenance.get("source") != SOURCE:
            raise ValueError(f"{self.path / COMPLETE} comes from {data.provenance.get('source')!r}; expected the "
                             "recordings of this commissioning: choose another directory")
        for folder in (self.path / RUNS).glob("*"):
            discard_recorded(folder)
            folder.rmdir()
        if (self.path / RUNS).is_dir():
            (self.path / RUNS).rmdir()
        return data

    def set_aside(self, name: str) -> Path:
        """Rename a file of a declined step, so that it is measured again: NAME becomes declined-N-NAME."""
        number = 1 + len(list(self.path.glob(f"declined-*-{name}")))
        aside = self.path / f"declined-{number}-{name}"
        os.replace(self.path / name, aside)
        return aside


def dataset_of(plant: Plant, runs: Sequence[Trajectory], provenance: dict) -> TrajectoryDataset:
    """Runs of this plant as a dataset. The provenance holds the plant's neutral input."""
    own = {"source": SOURCE, "package": f"ssmr_torch {__version__}", "robot": plant.name,
           "neutral_input": np.asarray(plant.neutral_input).tolist()}
    return TrajectoryDataset(runs, plant.rest, plant.output_names, plant.input_names, plant.input_unit,
                             own | provenance)
