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
