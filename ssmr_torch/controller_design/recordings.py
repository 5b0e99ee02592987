"""The recordings as a design sees them: runs to train on, runs held out, and the units that belong to the robot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ssmr_torch.control.actuator import Actuator
from ssmr_torch.trajectory import Trajectory, TrajectoryDataset

HELD_OUT = 4        # every so many-th controlled run is held out where none is marked for validation
LEAST_HELD = 3.0    # s of controlled runs that must be held out
CONSTANT = 1e-3     # of its range: an input that moves less tells nothing


class Piece(NamedTuple):
    """observation (T, p), m; input (T, m), the command or what acts; decay: whether it is a decay."""

    observation: np.ndarray
    input: np.ndarray
    decay: bool


@dataclass(frozen=True, eq=False)
class Recordings:
    """train, held: pieces with commands; held are controlled runs that no fit sees. timestep: s.
    bounds: (2, m), of the commands. tracked: columns of the outputs that the task prescribes.
    reach: m, largest displacement of the tracked outputs.
    """

    train: list[Piece]
    held: list[Piece]
    timestep: float
    bounds: np.ndarray
    tracked: tuple[int, ...]
    output_names: tuple[str, ...]
    input_names: tuple[str, ...]

    @cached_property
    def reach(self) -> float:
        columns = list(self.tracked)
        return float(max(np.linalg.norm(piece.observation[:, columns], axis=1).max() for piece in self.all))

    @property
    def all(self) -> list[Piece]:
        return [*self.train, *self.held]

    @property
    def controlled(self) -> list[Piece]:
        """Controlled runs of the training."""
        return [piece for piece in self.train if not piece.decay]

    @property
    def minutes(self) -> float:
        """Of all recordings that the design uses."""
        return sum(len(piece.input) for piece in self.all) * self.timestep / 60.0

    @property
    def input_range(self) -> np.ndarray:
        """(m,) highest minus lowest command."""
        return self.bounds[1] - self.bounds[0]

    @property
    def output_dim(self) -> int:
        return len(self.output_names)

    @property
    def input_dim(self) -> int:
        return len(self.input_names)

    @property
    def neutral(self) -> np.ndarray:
        """(m,), the admissible command nearest to zero."""
        return np.clip(0.0, *self.bounds)

    @cached_property
    def usual_input(self) -> np.ndarray:
        """(m,), mean input of the controlled runs: around it the recordings are dense."""
        return np.concatenate([piece.input for piece in self.controlled]).mean(0)

    @cached_property
    def usual_outputs(self) -> tuple[np.ndarray, np.ndarray]:
        """(p,) mean and (p,) standard deviation of the outputs in the controlled runs, m."""
        outputs = np.concatenate([piece.observation for piece in self.controlled])
        return outputs.mean(0), np.maximum(outputs.std(0), 1e-6 * self.reach)

    def under(self, actuator: Actuator) -> Recordings:
        """The same with acting inputs in place of commands."""
        def acted(pieces):
            return [piece._replace(input=actuator.acting(piece.input)) for piece in pieces]

        return replace(self, train=acted(self.train), held=acted(self.held))


def recordings_of(data: TrajectoryDataset, tracked: Sequence[int], bounds: npt.ArrayLike) -> Recordings:
    """Of the dataset's training and validation runs; test runs are never looked at.

    Raises ValueError where nothing can be told from them: no controlled run, none that could be held out, an input
    that is constant or leaves the bounds.
    """
    bounds = np.asarray(bounds, dtype=np.float64)
    if bounds.shape != (2, data.input_dim) or not (np.isfinite(bounds).all() and (bounds[0] < bounds[1]).all()):
        raise ValueError(f"bounds are {bounds.tolist()}; expected (2, {data.input_dim}) finite numbers, lowest and "
                         "highest input, lowest below highest")
    train, held = _split(data)
    found = Recordings([_piece(run) for run in train], [_piece(run) for run in held], data.timestep, bounds,
                       tuple(tracked), data.output_names, data.input_names)
    _check(found)
    return found


def held_out(data: TrajectoryDataset) -> list[Trajectory]:
    """The controlled runs that no fit of a design sees."""
    return _split(data)[1]


def _split(data: TrajectoryDataset) -> tuple[list[Trajectory], list[Trajectory]]:
    """Runs to train on, and controlled ones held out: those for validation, or every `HELD_OUT`-th."""
    runs = [run.read() for split in ("train", "validation") for run in data.select(split) if run.kind != "static"]
    controlled = [run for run in runs if run.kind == "controlled"]
    held = [run for run in controlled if run.split == "validation"] or controlled[HELD_OUT - 1::HELD_OUT] \
        or controlled[1:][-1:]
    return [run for run in runs if not any(run is other for other in held)], held


def _piece(run: Trajectory) -> Piece:
    return Piece(np.array(run.observation), np.array(run.input), run.kind == "decay")


def _check(found: Recordings) -> None:
    if not found.controlled:
        raise ValueError("the data hold no controlled run to train on; a controller needs recordings under inputs that "
                         "change: record some minutes with dither (excitation=five_minutes), or by ssmr commission")
    seconds = sum(len(piece.input) for piece in found.held) * found.timestep
    if seconds < LEAST_HELD:
        raise ValueError(f"{seconds:.3g} s of controlled runs could be held out; expected {LEAST_HELD:g} s or more, "
                         "from which delay, noises and weights are judged: record two controlled runs or more, or mark "
                         "one split='validation'")
    inputs = np.concatenate([piece.input for piece in found.controlled])
    span = np.ptp(inputs, axis=0) / found.input_range
    still = [name for name, share in zip(found.input_names, span) if share < CONSTANT]
    if still:
        raise ValueError(f"the inputs {', '.join(still)} never change in the controlled runs; what they do cannot be "
                         "told: record runs in which every input moves")
    lowest, highest = inputs.min(0), inputs.max(0)
    slack = 1e-6 * found.input_range
    outside = [name for k, name in enumerate(found.input_names)
               if lowest[k] < found.bounds[0, k] - slack[k] or highest[k] > found.bounds[1, k] + slack[k]]
    if outside:
        raise ValueError(f"the recorded inputs {', '.join(outside)} go from {lowest.tolist()} to {highest.tolist()}, "
                         f"outside of the bounds {found.bounds.tolist()}; give bounds in the unit of the recordings")
