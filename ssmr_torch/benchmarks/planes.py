"""Which plane of a robot is drawn in, by its recordings alone, and paths in it that its recordings say can be held.

The plane. The first output is the one with the largest span in the training and validation runs. The second is the one
that is least a function of the first: of which a quadratic regression on the first, over all these samples, leaves the
largest residual (rms). The tip of a planar robot moves along a curve, so that its height would be no second output.

The static reach. A decay begins where constant inputs have held the robot for a second; these points, and rest itself,
are what the recordings show to be held. In the coordinates (first output, residual of the second) they have a mean and
per axis half of a range; a path at 40 % goes from the mean 40 % of that far, per axis. Of all five foreign robots such
paths lie within the convex hull of the points, to 1 % of the box; further out `rehearse` says what is out of
reach (`ssmr.rehearse(controller).floor`). Controlled runs go further by overshoot.

The reach, of which errors are shares: largest displacement of the two outputs in these runs, as in a design.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np

from ssmr_torch.tasks.references import Task, ramped_phase
from ssmr_torch.tasks.symbols import contours
from ssmr_torch.trajectory import TrajectoryDataset

LEAD = 2.0           # s, from rest to where the path begins
RAMP = 1.0           # s, within which a lap's speed is reached, and left
LEAST_DECAYS = 4


@dataclass(frozen=True)
class Plane:
    """outputs: the two.   bend (3,): second ≈ bend · (1, first, first²).   centre, half (2,) m: mean and half
    ranges of (first, residual) where it was held at rest.   reach: m.
    """

    outputs: tuple[str, str]
    bend: tuple[float, ...]
    centre: tuple[float, ...]
    half: tuple[float, ...]
    reach: float

    def outward(self, place: np.ndarray) -> np.ndarray:
        """Outputs (K, 2) m of places (K, 2) in units of the box."""
        first, residual = (np.array(self.centre) + self.half * place).T
        return np.stack([first, residual + _powers(first) @ np.array(self.bend)], axis=1)

    @property
    def resting(self) -> np.ndarray:
        """(2,), the place of zero displacement."""
        return (np.array([0.0, -self.bend[0]]) - self.centre) / self.half


def plane_of(data: TrajectoryDataset) -> Plane:
    """The plane of the recordings. Raises ValueError where too few decays or outputs say what it is."""
    runs = [run.read() for split in ("train", "validation") for run in data.select(split)]
    held = np.array([run.observation[0] for run in runs if run.kind == "decay"])
    if len(held) < LEAST_DECAYS or data.output_dim < 2:
        raise ValueError(f"the recordings have {len(held)} decays and {data.output_dim} outputs; expected "
                         f"{LEAST_DECAYS} decays, which begin at rest under constant inputs, and 2 outputs")
    seen = np.concatenate([run.observation for run in runs])
    seen = seen[np.isfinite(seen).all(axis=1)]
    first = int(np.argmax(np.ptp(seen, axis=0)))
    bends = np.linalg.lstsq(_powers(seen[:, first]), seen, rcond=None)[0]
    left = np.sqrt(np.square(seen - _powers(seen[:, first]) @ bends).mean(axis=0))
    left[first] = -1.0
    second = int(np.argmax(left))
    box = np.stack([held[:, first], held[:, second] - _powers(held[:, first]) @ bends[:, second]], axis=1)
    box = np.concatenate([box, [[0.0, -bends[0, second]]]])
    return Plane((data.output_names[first], data.output_names[second]), tuple(bends[:, second].tolist()),
                 tuple(box.mean(axis=0).tolist()), tuple((0.5 * np.ptp(box, axis=0)).tolist()),
                 float(np.linalg.norm(seen[:, [first, second]], axis=1).max()))


def drawing(plane: Plane, shape: str, *, lap: float, laps: float, share: float) -> Task:
    """A path of the plane: `LEAD` s from rest to its beginning, then the laps of `lap` s, from and to standstill.

    shape: "circle", "eight" or "letter", the outline of an S.   share: of the box, per axis.
    """
    phase, duration = ramped_phase(laps, 1.0 / lap, RAMP)
    return Task(f"{shape}, {lap:g} s a lap, {100 * share:g} %", LEAD + duration, plane.outputs,
                Drawing(plane, shape, share, phase))


@dataclass(frozen=True)
class Drawing:
    """Times (K,) s → (K, 2) m, as `drawing` says."""

    plane: Plane
    shape: str
    share: float
    phase: Callable

    def __call__(self, time: np.ndarray) -> np.ndarray:
        place = self.share * SHAPES[self.shape](self.phase(np.maximum(time - LEAD, 0.0)))
        s = np.clip(time / LEAD, 0.0, 1.0)[:, None]
        arrived = s**3 * (s * (6.0 * s - 15.0) + 10.0)
        return self.plane.outward(arrived * place + (1.0 - arrived) * self.plane.resting)


def _powers(values: np.ndarray) -> np.ndarray:
    return np.stack([np.ones_like(values), values, values**2], axis=1)


def _circle(turn: np.ndarray) -> np.ndarray:
    return np.stack([np.sin(2 * np.pi * turn), -np.cos(2 * np.pi * turn)], axis=1)


def _eight(turn: np.ndarray) -> np.ndarray:
    return np.stack([-np.sin(2 * np.pi * turn), np.sin(4 * np.pi * turn)], axis=1)


def _letter(turn: np.ndarray) -> np.ndarray:
    travelled, corners = _outline()
    return np.stack([np.interp(np.mod(turn, 1.0), travelled, column) for column in corners.T], axis=1)


@cache
def _outline() -> tuple[np.ndarray, np.ndarray]:
    """Share of the way (n,) at each corner (n, 2) of an S that fills [−1, 1]²."""
    corners = contours("S")[0]
    low, high = corners.min(axis=0), corners.max(axis=0)
    corners = 2.0 * (corners - low) / (high - low) - 1.0
    travelled = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1)))
    return travelled / travelled[-1], corners


SHAPES = {"circle": _circle, "eight": _eight, "letter": _letter}
