"""Controllers designed from recordings alone, on robots that no default was made on.

    ssmr benchmark designed folder=FOLDER robots=[tendon_chain,emulated_bench] parts=[nominal,disturbed] seeds=5

No run that is evaluated was seen by a design: `ssmr.design` gets the recording of five minutes, the tracked outputs and
the bounds, and its defaults. One design serves all tasks that track the same outputs.

parts: nominal (40 % of the static reach, slow and fast); far (70 and 100 %); disturbed, where the robot is not the one
that was recorded: by `not told` the controller is the nominal one, by `readjusted` it was readjusted after one fast
letter of 13 s on that robot, by `designed` the recordings were made on that robot; models, nominal with each of several
kinds, designed alike.
Results are kept in FOLDER/results.json as they are made; a result that is there is not made again, unless it failed by
an exception. FOLDER/ROBOT.md gets one table for each part; a remark names the worst robot and task.
"""

from __future__ import annotations

import json
import logging
import pickle
import traceback
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import numpy as np
import torch

import ssmr_torch as ssmr
from ssmr_torch.benchmarks import designed_tables as tables
from ssmr_torch.benchmarks.loop_scores import finite, measured
from ssmr_torch.benchmarks.robots_under_test import NOMINAL, NOT_TOLD, ROBOTS, Condition, Robot, robot_named
from ssmr_torch.checked_arguments import checked
from ssmr_torch.closed_loop.simulation import simulate
from ssmr_torch.control.designed import DesignedController
from ssmr_torch.quantities import PATH, TEXT
from ssmr_torch.ranges import Each, OrNone, Whole
from ssmr_torch.result_files import save_bytes, save_text
from ssmr_torch.trajectory import TrajectoryDataset

PARTS = ("nominal", "far", "disturbed", "models")
MODELS = ("auto", "ssmr", "sssr", "ssmr_control_augmented", "edmd_bilinear", "dmd", "slow_fast")
SEED_OF_OPERATION = 1000           # of the run that a controller is readjusted by, which no evaluated run has


@dataclass(frozen=True)
class Choice:
    """What was asked for, see `rows`."""

    folder: Path
    recordings: Path
    robots: Sequence[str]
    parts: Sequence[str]
    models: Sequence[str]
    conditions: Sequence[str]
    told: Sequence[str]
    tasks: Sequence[str]
    seeds: int

    def __post_init__(self):
        unknown = (set(self.robots) - set(ROBOTS)) | (set(self.parts) - set(PARTS))
        if unknown:
            raise ValueError(f"unknown: {', '.join(sorted(unknown))}; robots are {', '.join(ROBOTS)}, parts "
                             f"{', '.join(PARTS)}")


class NoDesign(Exception):
    """A run that has no controller, with the reason, which was told when the design failed."""


class Results:
    """Rows by their key, in a file that is complete at any time."""

    def __init__(self, path: Path):
        self.path = path
        self.rows: dict[str, dict] = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}

    def add(self, key: str, row: dict) -> None:
        self.rows[key] = row
        save_text(self.path, json.dumps(self.rows, indent=1))  # infinite floors are kept

    def once(self, key: str, make) -> dict:
        """The row of this key, made now where it is missing or failed."""
        if "raised" in self.rows.get(key, {"raised": ""}):
            began = perf_counter()
            try:
                row = make()
            except Exception as error:  # what a design or a loop raises is a result, and the others go on
                if not isinstance(error, NoDesign):
                    traceback.print_exc()
                row = {"raised": f"{type(error).__name__}: {error}"}
            self.add(key, row | {"wall": round(perf_counter() - began, 1)})
            print(key, tables.in_words(self.rows[key]), flush=True)
        return self.rows[key]


class Trial:
    """One robot: its recordings, designs and runs."""

    def __init__(self, robot: Robot, chosen: Choice, results: Results):
        self.robot, self.chosen, self.results = robot, chosen, results
        self._controllers: dict[tuple, DesignedController | Exception] = {}
        plant = robot.plant(NOMINAL)
        self.bounds, self._rest = plant.input_bounds, np.asarray(plant.rest)
        self.nominal = self.recorded(NOMINAL)
        self.plane = robot.plane(self.nominal)

    def plant(self, condition: Condition):
        return self.robot.plant(condition, None if condition == NOMINAL else self._rest)

    def recorded(self, condition: Condition) -> TrajectoryDataset:
        """Of the robot under this condition; made where it is missing."""
        name = self.robot.name if condition == NOMINAL else f"{self.robot.name}, {condition.name}"
        path = self.chosen.recordings / name / "trajectories.h5"
        if not path.is_file():
            began = perf_counter()
            data = self.robot.record(self.plant(condition))
            path.parent.mkdir(parents=True, exist_ok=True)
            data.save(path)
            print(f"{name}: recorded in {perf_counter() - began:.0f} s", flush=True)
        return self.robot.observed(TrajectoryDataset.load(path))

    def designed(self, kind: str, condition: Condition, task) -> DesignedController:
        """For the task's outputs, designed from recordings under this condition; kept."""
        key = f"{self.robot.name}/design/{kind}/{condition.name}/{'-'.join(map(str, task.tracked))}"

        def make() -> tuple[dict, DesignedController]:
            data = self.recorded(condition)
            model = ssmr.fit(data, purpose="control", progress=False) if kind == "slow_fast" else kind
            controller, report = ssmr.design(model, data, task, self.bounds, progress=False)
            save_text(self.chosen.folder / "designs" / f"{key.replace('/', ' ')}.txt",
                      "\n".join([repr(report), "", *report.sentences]) + "\n")
            return {"design": report.facts}, controller

        return self._kept(key, make)

    def controller(self, kind: str, condition: Condition, told: str, task) -> DesignedController:
        """For this task, and for the robot under the condition as far as the controller is told of it."""
        known = (kind, condition.name, told, task.tracked)
        if known not in self._controllers:
            try:
                found = self.designed(kind, condition if told == "designed" else NOMINAL, task)
                if told == "readjusted":
                    found = self._readjusted(kind, condition, found, task)
            except Exception as error:  # once is enough for all tasks
                found = error
            self._controllers[known] = found
        if isinstance(self._controllers[known], Exception):
            raise self._controllers[known]
        return self._controllers[known].changed(task)

    def _readjusted(self, kind: str, condition: Condition, found: DesignedController, task) -> DesignedController:
        """That after one run of operation on the changed robot; kept."""
        key = f"{self.robot.name}/readjustment/{kind}/{condition.name}/{'-'.join(map(str, task.tracked))}"

        def make() -> tuple[dict, DesignedController]:
            working = found.changed(self.robot.operation(self.plane))
            record = simulate(self.plant(condition), working, working.task, seed=SEED_OF_OPERATION)
            changed, answer = working.readjust(record)
            return {"accepted": bool(answer.accepted), "words": answer.words}, changed

        return self._kept(key, make)

    def _kept(self, key: str, make) -> DesignedController:
        """What `make` gives beside a row, in a file; both are made once. Raises NoDesign where that fails."""
        file = self.chosen.folder / "designs" / f"{key.replace('/', ' ')}.pkl"

        def write() -> dict:
            row, found = make()
            save_bytes(file, pickle.dumps(found))
            return row

        if not file.is_file():
            self.results.rows.pop(key, None)
        row = self.results.once(key, write)
        if "raised" in row:
            raise NoDesign(row["raised"])
        return pickle.loads(file.read_bytes())

    def floor(self, kind: str, task) -> dict:
        """What the model says of the task before the run, once."""
        def make() -> dict:
            found = ssmr.rehearse(self.controller(kind, NOMINAL, NOT_TOLD, task))
            return {"floor": found.floor.tolist(), "out of reach": found.out_of_reach, "static ise": found.static_ise,
                    "fastest": found.fastest, "held": found.held, "model's rmse": finite(found.rmse)}

        return self.results.once(f"{self.robot.name}/rehearsal/{kind}/{task.name}", make)

    def run(self, part: str, kind: str, condition: Condition, told: str, task, seed: int) -> None:
        key = "/".join([self.robot.name, part, kind, condition.name, told, task.name, str(seed)])
        if "raised" not in self.results.rows.get(key, {"raised": ""}):
            return
        rehearsed = self.results.rows.get(f"{self.robot.name}/rehearsal/{kind}/{task.name}", {})

        def make() -> dict:
            controller = self.controller(kind, condition, told, task)
            record = simulate(self.plant(condition), controller, task, seed=seed)
            return measured(record, task, controller, self.plane.reach, rehearsed.get("floor"))

        self.results.once(key, make)

    def all(self) -> None:
        """All rows that were asked for."""
        chosen, robot = self.chosen, self.robot
        usual = [task for task in robot.tasks(self.plane) if self._wanted(task)]
        for seed in range(chosen.seeds):
            for kind in chosen.models:
                for task in usual if "nominal" in chosen.parts or "models" in chosen.parts else ():
                    self.floor(kind, task)
                    self.run("nominal", kind, NOMINAL, NOT_TOLD, task, seed)
                for task in robot.far(self.plane) if "far" in chosen.parts else ():
                    if self._wanted(task):
                        self.floor(kind, task)
                        self.run("far", kind, NOMINAL, NOT_TOLD, task, seed)
                for condition, told in robot.disturbances() if "disturbed" in chosen.parts else ():
                    if self._wanted_disturbance(condition, told):
                        for task in usual:
                            self.run("disturbed", kind, condition, told, task, seed)

    def _wanted(self, task) -> bool:
        return not self.chosen.tasks or any(part in task.name for part in self.chosen.tasks)

    def _wanted_disturbance(self, condition: Condition, told: str) -> bool:
        return (not self.chosen.conditions or condition.name in self.chosen.conditions) \
            and (not self.chosen.told or told in self.chosen.told)


@checked(folder=PATH, recordings=OrNone(PATH), robots=OrNone(Each(TEXT, 0, 1000)), parts=Each(TEXT),
         models=OrNone(Each(TEXT, 0, 1000)), conditions=Each(TEXT, 0), told=Each(TEXT, 0), tasks=Each(TEXT, 0),
         seeds=Whole(1, 10_000))
def rows(*, folder: str = "outputs/designed", recordings: str | None = None, robots: Sequence[str] | None = None,
         parts: Sequence[str] = ("nominal", "far", "disturbed"), models: Sequence[str] | None = None,
         conditions: Sequence[str] = (), told: Sequence[str] = (), tasks: Sequence[str] = (),
         seeds: int = 5) -> Iterator[dict | str]:
    """One row per run in closed loop, and a remark with the worst.

    folder: of results, pages and designs.   recordings: FOLDER/ROBOT/trajectories.h5; None: those of folder; they are
    made where they are missing.   robots: see `robots_under_test.py`; None: all.   models: kinds; None: auto, or all
    of `MODELS` for the part models.   conditions, told: of the part disturbed; none: all.   tasks: those with one of
    these in their names; none: all.   seeds: runs of each kind.
    Raises ValueError for a robot or a part that is none.
    """
    logging.getLogger("lightning.pytorch").setLevel(logging.ERROR)
    warnings.filterwarnings("ignore")
    torch.set_num_threads(1)
    kinds = models or (MODELS if "models" in parts else ("auto",))
    chosen = Choice(Path(folder), Path(recordings or folder), robots or list(ROBOTS), parts, kinds, conditions, told,
                    tasks, seeds)
    results = Results(chosen.folder / "results.json")
    for name in chosen.robots:
        robot = robot_named(name)
        Trial(robot, chosen, results).all()
        save_text(chosen.folder / f"{name}.md", tables.page(robot, results.rows))
        yield from tables.runs(name, results.rows)
        yield f"{chosen.folder / f'{name}.md'}"
    yield tables.worst(results.rows)
