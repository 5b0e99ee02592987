"""From measurements to the reduced state: the chart, applied to the window of the last samples."""

from __future__ import annotations

from typing import Protocol

import numpy as np


class Estimator(Protocol):
    """Called once for each measurement, in order."""

    def reset(self) -> None:
        """Forget all measurements."""

    def measure(self, observation: np.ndarray, last_input: np.ndarray) -> None:
        """observation (p,) m, not finite where a value is missing; last_input (m,): held since the one before."""

    def state(self) -> tuple[np.ndarray, np.ndarray | None, np.ndarray | None]:
        """z (n,), not finite where it is not known; offsets of the input (m,) and of the output (p,), m, or None."""


class ChartEstimator:
    """z = v(window): the reduced state is what the chart makes of the newest n_d + 1 samples.

    model: with `encode`, `delays`, `input_dim`, `output_dim`. stride: measurements from one sample of the window to the
    next. Before the first measurement the robot is taken to have rested where it is.
    """

    def __init__(self, model, stride: int):
        self.model, self.stride = model, int(stride)
        length = model.delays * self.stride
        self._observations = np.empty((length + 1, model.output_dim))
        self._inputs = np.empty((length, model.input_dim))
        self.reset()

    def reset(self) -> None:
        self._begun = False

    def measure(self, observation: np.ndarray, last_input: np.ndarray) -> None:
        """The newest sample enters the window, the oldest leaves it."""
        if not self._begun:
            self._observations[:], self._inputs[:] = observation, last_input
            self._begun = True
            return
        self._observations[:-1] = self._observations[1:]
        self._observations[-1] = observation
        if len(self._inputs):
            self._inputs[:-1] = self._inputs[1:]
            self._inputs[-1] = last_input

    def window(self) -> tuple[np.ndarray, np.ndarray]:
        """Views of the delay window (n_d + 1, p), oldest first, and of the inputs (n_d, m) set at all samples but the
        newest.
        """
        return self._observations[::self.stride], self._inputs[::self.stride]

    def state(self) -> tuple[np.ndarray, None, None]:
        return self.model.encode(*self.window()), None, None  # which is not finite where the window is not
