"""What every controller offers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np

from ssmr_torch.status import Status

if TYPE_CHECKING:
    from ssmr_torch.control.scp import Plan


@dataclass(frozen=True, eq=False)
class Command:
    """What a controller answers to one measurement.

    input: (m,) to hold until the next sample, finite and inside the bounds, in the plant's input unit.
    plan: the optimization behind it, or None where nothing was optimized.
    fallback: why the plan could not be used, or None where the input is the one intended.
    held: the input of the last control step, repeated because the next control step is not due yet.
    """

    input: np.ndarray
    plan: Plan | None = None
    fallback: Status | None = None
    held: bool = False


@runtime_checkable
class Controller(Protocol):
    """Called once per plant sample; decides anew every `period` s and holds its input in between.

    A controller never raises because of a value that it measured: it falls back and says so in its command.
    """

    period: float

    def reset(self) -> None:
        """Forget all measurements; the same measurements then give the same commands again."""

    def __call__(self, time: float, observation: np.ndarray) -> Command:
        """time in s; observation (p,): displacement from rest, m, before the returned input acts."""


def changed_bounds(bounds, shape: tuple[int, int]) -> np.ndarray:
    """Input bounds (2, m) that take the place of others of this shape; equal ones are those of a dead actuator.

    Raises ValueError, with both numbers, for bounds that are not finite or crossed, and for another shape.
    """
    bounds = np.array(bounds, dtype=np.float64)
    if bounds.shape != shape:
        raise ValueError(f"input_bounds has shape {bounds.shape}; expected {shape}: lowest and highest input")
    for place, (lower, upper) in enumerate(bounds.T):
        if not (np.isfinite(lower) and np.isfinite(upper) and lower <= upper):
            raise ValueError(f"input {place} is bounded by {lower} and {upper}; expected finite numbers, the lower one "
                             "not above the upper one")
    return bounds


def admissible_input(name: str, given, bounds: np.ndarray) -> np.ndarray:
    """The input (m,) that was given; None: that within the bounds (2, m) which is nearest to zero.

    Raises ValueError, with the name of the setting, where it is not m numbers within the bounds.
    """
    lower, upper = bounds
    found = np.clip(0.0, lower, upper) if given is None else np.array(given, dtype=np.float64)
    if found.shape != lower.shape or not ((lower <= found) & (found <= upper)).all():
        raise ValueError(f"{name} is {found.tolist()}; expected {len(lower)} numbers between {lower.tolist()} and "
                         f"{upper.tolist()}")
    return found
