"""Robots that no default was made on: the model that is chosen from the data, and all baselines at their best.

Each robot is recorded for five minutes (excitation=five_minutes), or read from FOLDER/ROBOT/trajectories.h5 where that
is, where a new recording is kept as well. The model that is chosen from the data and all baselines at their best are
fitted by defaults and scored on the robot's test runs; FOLDER/ROBOT/comparison.md has all tables. One row per robot;
at the end a remark lists the robots, worst first, by the chosen model's error over a second as a share of the largest
displacement.
"""

from __future__ import annotations

import logging
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path

import torch

from ssmr_torch import configuration
from ssmr_torch import data_sheet as sheet
from ssmr_torch.checked_arguments import checked
from ssmr_torch.evaluation.model_comparison import Comparison
from ssmr_torch.extras import remedy
from ssmr_torch.fitting.compare_models import compare
from ssmr_torch.quantities import PATH, TEXT
from ssmr_torch.ranges import Each, OrNone
from ssmr_torch.result_files import save_text
from ssmr_torch.trajectory import TrajectoryDataset

ROBOTS = ("tendon_chain", "cosserat_rod", "pressure_arm", "isupport", "planar_hsa")
CHOSEN, SMOOTH, FAST = "AUTO", "smooth-test", "double-speed-test"
RIGS = {"pressure_arm": "camera"}  # what stands between robot and recording; others are seen as they are
SHORT = {"decays": 6, "validation_decays": 0, "test_decays": 1, "decay_duration": 2.0}
LABELS = ("50 ms", "200 ms", "1 s")


def recorded(robot: str, *, short: bool = False) -> TrajectoryDataset:
    """A recording of five minutes; short: of 72 s, six decays and four training runs of 8 s, for tests."""
    config = configuration.composed("collect", [f"plant={robot}", f"rig={RIGS.get(robot, 'ideal')}",
                                                "excitation=five_minutes"])
    config.excitation.progress = False
    if short:
        config.excitation.update(SHORT)
        config.excitation.controlled = [run for run in config.excitation.controlled if run.get("split") != "validation"]
        for run in config.excitation.controlled:
            run.duration, run.repeats = 8.0, 4 if run.name == "smooth-train" else 1
    plant = configuration.built(config.rig)(configuration.built(config.plant))
    return configuration.built(config.excitation)(plant)


def kept(robot: str, folder: Path | None) -> TrajectoryDataset:
    """The recording in the folder; a new one where there is none."""
    path = None if folder is None else folder / robot / "trajectories.h5"
    if path is not None and path.is_file():
        return TrajectoryDataset.load(path)
    data = recorded(robot)
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        data.save(path)
    return data


def row(robot: str, found: Comparison) -> dict:
    """Of the smooth test run: errors in mm, % of the reach; the same at double speed; the best baseline's errors."""
    smooth = found.groups[SMOOTH]
    others = [found.best_other(SMOOTH, label, CHOSEN) for label in LABELS]
    behind = [f"{group} {', '.join(late)}" for group, late in found.behind(CHOSEN).items() if late]
    return {"robot": robot, **{f"{label}, mm": float(1e3 * smooth[CHOSEN][label].mean) for label in LABELS},
            "of reach, %": float(100 * found.share_of_reach(CHOSEN, SMOOTH)),
            "double speed, %": float(100 * found.share_of_reach(CHOSEN, FAST)),
            "diverged, %": float(100 * found.diverged(CHOSEN)),
            **{f"best baseline, {label}": f"{sheet.number(1e3 * smooth[other][label].mean)} {other}"
               for other, label in zip(others, LABELS)},
            "neither best nor tied": "; ".join(behind) or "–"}


@checked(folder=OrNone(PATH), robots=Each(TEXT))
def rows(*, folder: str | None = None, robots: Sequence[str] = ROBOTS) -> Iterator[dict | str]:
    """One row per robot, and a remark for each whose package is not installed.   folder: of the recordings."""
    logging.getLogger("lightning.pytorch").setLevel(logging.ERROR)
    warnings.filterwarnings("ignore")
    torch.set_num_threads(1)
    place, shares = None if folder is None else Path(folder), {}
    for robot in robots:
        try:
            found = compare(kept(robot, place))
        except ModuleNotFoundError as error:
            yield f"{robot} left out: {remedy(error) or error}"
            continue
        shares[robot] = found.share_of_reach(CHOSEN, SMOOTH)
        if place is not None:
            save_text(place / robot / "comparison.md", found.markdown)
        yield row(robot, found)
        yield f"{robot}\n{found}\n"
    yield "worst first: " + ", ".join(f"{robot} {sheet.number(100 * shares[robot], 2)} %"
                                      for robot in sorted(shares, key=lambda robot: -shares[robot]))
