"""The interface of every plant: an analytic robot, a finite-element robot or a real one."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np

from ssmr_torch import data_sheet as sheet
from ssmr_torch.data_sheet import DataSheet


@runtime_checkable
class Plant(Protocol):
    """A robot that is sampled every `timestep` s and holds its input in between.

    An observation is (p,) m, the displacement of the observed points from rest; an input is (m,), in `input_unit`.
    name: of the robot, for reports. input_bounds: (2, m), lowest and highest input. rest: (p,) m, absolute position of
    the observed points at rest.
    A plant may have a `neutral_input` (m,), the input under which it is left alone. Without it, the neutral input is
    the admissible one nearest to zero.
    """

    name: str
    timestep: float
    input_bounds: np.ndarray
    input_unit: str
    output_names: tuple[str, ...]
    input_names: tuple[str, ...]
    rest: np.ndarray

    def reset(self, seed: int | None = None, state: np.ndarray | None = None) -> np.ndarray:
        """Go to `state` (default: rest) and return the observation there. `seed` fixes all later randomness."""

    def step(self, input: np.ndarray) -> np.ndarray:
        """Hold `input` for one timestep and return the observation at its end.

        An input out of bounds is clipped. An input of the wrong size or with non-finite values raises ValueError and
        leaves the state as it was.
        """

    @property
    def state(self) -> np.ndarray:
        """The full state. `reset(state=...)` returns to it exactly."""

    @property
    def displacement(self) -> np.ndarray:
        """(p,) m, the true displacement of the observed points; for an ideal plant it equals the observation."""


class PlantSheet(DataSheet):
    """The data sheet that a plant prints of itself."""

    def data_sheet(self) -> tuple[str, dict]:
        lowest, highest = self.input_bounds
        entries = {"sampling time": sheet.period(self.timestep),
                   "outputs": f"{sheet.listed(self.output_names)}; displacement from rest, m",
                   "inputs": sheet.spans(self.input_names, lowest, highest, sheet.unit_of(self.input_unit)),
                   "rest": f"{sheet.listed(sheet.number(1e3 * x) for x in self.rest)} mm"}
        sizes = f"{len(self.input_names)} inputs, {len(self.output_names)} outputs"
        return f"{type(self).__name__} {self.name!r}: {sizes}", entries


def finite_vector(value: np.ndarray, size: int, name: str) -> np.ndarray:
    """A copy of an argument as (size,) float64. Raises ValueError for another shape or non-finite values."""
    vector = np.array(value, dtype=np.float64)
    if vector.shape != (size,):
        raise ValueError(f"{name} has shape {vector.shape}; expected ({size},)")
    if not np.isfinite(vector).all():
        raise ValueError(f"{name} is {vector.tolist()}; expected {size} finite numbers")
    return vector


def input_range(bounds, count: int, unit: str) -> np.ndarray:
    """Bounds (2,) or (2, m) as (2, m). Raises ValueError unless they are finite, the lowest below the highest."""
    array = np.array(bounds, dtype=np.float64)
    if array.shape not in ((2,), (2, count)):
        raise ValueError(f"input_bounds has shape {array.shape}; expected (2,) or (2, {count}), "
                         f"lowest and highest force in {unit}")
    array = np.array(np.broadcast_to(array.reshape(2, -1), (2, count)))
    if not (np.isfinite(array).all() and (array[0] < array[1]).all()):
        raise ValueError(f"input_bounds are {array.tolist()} {unit}; expected finite numbers, "
                         "the lowest below the highest")
    return array
