"""What every plant offers, be it analytic, finite-element or real."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np


@runtime_checkable
class Plant(Protocol):
    """A robot that is sampled every `timestep` s and holds its input in between.

    An observation is (p,), the displacement of the observed points from rest, m; an input is (m,), `input_unit`.
    input_bounds: (2, m), lowest and highest input. rest: (p,) absolute position of the origin of the observation.
    """

    timestep: float
    input_bounds: np.ndarray
    input_unit: str
    output_names: tuple[str, ...]
    input_names: tuple[str, ...]
    rest: np.ndarray

    def reset(self, seed: int | None = None, state: np.ndarray | None = None) -> np.ndarray:
        """Go to `state` (default: rest) and return the observation there; `seed` fixes all randomness after it."""

    def step(self, input: np.ndarray) -> np.ndarray:
        """Hold `input` for one timestep and return the observation at its end.

        An input out of bounds is clipped to them; one of wrong size or with non-finite values raises ValueError and
        leaves the state unharmed.
        """

    @property
    def state(self) -> np.ndarray:
        """The full state; `reset(state=...)` returns to it exactly."""
