"""The interface of every controller."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np

from ssmr_torch.status import Status

if TYPE_CHECKING:
    from ssmr_torch.control.scp import Plan


@dataclass(frozen=True, eq=False)
class Command:
    """The answer of a controller to one measurement.

    input: (m,) to hold until the next sample, finite and inside the bounds, in the plant's input unit.
    plan: the optimization result; None where nothing was optimized.
    fallback: why the plan could not be used; None where the input is the intended one.
    held: True for the input of the last control step, which is repeated until the next control step is due.
    """

    input: np.ndarray
    plan: Plan | None = None
    fallback: Status | None = None
    held: bool = False


@runtime_checkable
class Controller(Protocol):
    """Called once per plant sample. It decides every `period` s and holds its input in between.

    A controller raises no error for any measured value: it falls back, and its command says so.
    """

    period: float

    def reset(self) -> None:
        """Forget all measurements; the same measurements then give the same commands again."""

    def __call__(self, time: float, observation: np.ndarray) -> Command:
        """The command at time s for an observation (p,), m: the displacement from rest before this input acts."""
