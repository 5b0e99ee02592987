"""The chart as an estimator: it gives the reduced state from the window of the last samples."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from ssmr_torch.control.missing_measurements import mend
from ssmr_torch.control.sampling import RecordedRange

# Number of samples before the window that are kept, to fill gaps in it.
BEFORE = 6


class Estimator(Protocol):
    """Estimates the state. It is called once for each sample, in order; a skipped sample is a missing measurement.

    It may have `forget()`, which is `reset` without the counts, and `counts`, a Counter of events by name.
    """

    def reset(self) -> None:
        """Forget all measurements."""

    def measure(self, observation: np.ndarray, last_input: np.ndarray) -> None:
        """observation: (p,) m, not finite where a value is missing.   last_input: (m,), held since the last sample."""

    def state(self) -> tuple[np.ndarray, np.ndarray | None, np.ndarray | None]:
        """z (n,), not finite where it is unknown; offsets of the input (m,) and of the output (p,), m, or None."""


class ChartEstimator:
    """z = v(window): the reduced state is the chart of the newest n_d + 1 samples.

    model: with `encode`, `decode`, `state_scale`, `delays`, `input_dim`, `output_dim`. stride: measurements from one
    sample of the window to the next. The robot is assumed to have rested at its first measurement before. Values that
    are missing or outside the recorded range are replaced in the window when the next good one comes; see `mend`.
    """

    def __init__(self, model, stride: int):
        self.model, self.stride = model, int(stride)
        length = model.delays * self.stride
        self._observations = np.empty((length + 1 + (BEFORE if length else 0), model.output_dim))
        self._first = len(self._observations) - length - 1
        self._inputs = np.empty((length, model.input_dim))
        self._range = RecordedRange(model)
        self.reset()

    def reset(self) -> None:
        self._begun = False
        self._gaps: np.ndarray | None = None  # (p,) rows since the last good value of each output; None: all zero

    def measure(self, observation: np.ndarray, last_input: np.ndarray) -> None:
        """The newest sample enters the window, the oldest leaves it."""
        good = self._range.holds(observation)
        if not self._begun:
            self._observations[:], self._inputs[:] = observation, last_input
            self._begun = True
            self._gaps = None if good.all() else np.where(good, 0, len(self._observations))
            return
        self._observations[:-1] = self._observations[1:]
        self._observations[-1] = observation
        if len(self._inputs):
            self._inputs[:-1] = self._inputs[1:]
            self._inputs[-1] = last_input
        if self._gaps is not None or not good.all():
            self._gaps = mend(self._observations, self._gaps, good)

    def window(self) -> tuple[np.ndarray, np.ndarray]:
        """Views of the delay window (n_d + 1, p), oldest first, and of the inputs (n_d, m) at all samples but the
        newest one.
        """
        return self._observations[self._first::self.stride], self._inputs[::self.stride]

    def state(self) -> tuple[np.ndarray, None, None]:
        return self.model.encode(*self.window()), None, None  # not finite where the window is not finite
