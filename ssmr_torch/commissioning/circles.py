"""Test circles around the rest position, with a radius that the recordings show to be within reach."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from ssmr_torch.tasks.curves import OutAndRound
from ssmr_torch.tasks.references import Task, ramped_phase
from ssmr_torch.trajectory import TrajectoryDataset

DIRECTIONS = 24
USUAL = 99.0  # percentile of the distance in a direction; it leaves overshoot out


def reach(data: TrajectoryDataset, outputs: Sequence[str], centre: np.ndarray) -> float:
    """How far, in m, the controlled runs get from `centre` (2,) to every side in two outputs: the smallest over 24
    directions of the 99th percentile of the distance in that direction.
    """
    columns = data.columns(outputs)
    runs = data.select(kind="controlled") or tuple(data)
    away = np.concatenate([run.read().observation[:, columns] for run in runs]) - centre
    angles = 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    distances = np.percentile(away @ np.stack([np.cos(angles), np.sin(angles)]), USUAL, axis=0)
    return float(max(distances.min(), 0.0))


def tracked_outputs(data: TrajectoryDataset, rest: np.ndarray) -> tuple[str, str]:
    """The two outputs in which the robot reaches furthest to all sides of `rest` (p,), m. Raises ValueError where there
    is only one output.
    """
    names = data.output_names
    if len(names) < 2:
        raise ValueError(f"the robot has the outputs {list(names)}; a circle needs two or more")
    pairs = list(combinations(range(len(names)), 2))
    found = [reach(data, [names[column] for column in pair], rest[list(pair)]) for pair in pairs]
    return tuple(names[column] for column in pairs[int(np.argmax(found))])


def circle_about(centre: np.ndarray, radius: float, lap: float, laps: int, outputs: Sequence[str], name: str,
                 approach: float = 2.0) -> Task:
    """centre + r(t) (cos θ, sin θ): out to the radius (m) in `approach` s, `laps` laps of `lap` s each, and back.

    θ is the phase of `ramped_phase`, with ramps of a quarter of a lap. Raises ValueError unless the radius is positive.
    """
    if not radius > 0:
        raise ValueError(f"the radius of {name!r} is {radius} m; expected a positive length. The recordings reach only "
                         "to one side of rest: name two other outputs as tracked in the card")
    phase, turning = ramped_phase(2 * np.pi * laps, 2 * np.pi / lap, 0.25 * lap)

    return Task(name, turning + 2 * approach, tuple(outputs),
                OutAndRound(centre, radius, approach, turning, phase))
