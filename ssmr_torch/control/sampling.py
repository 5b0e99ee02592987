"""What every sampled controller does with a call before it decides: its time, its measurement, whether it is due."""

from __future__ import annotations

import logging
from collections import Counter
from typing import NamedTuple

import numpy as np

from ssmr_torch.control.checked_measurement import RecordedRange, read
from ssmr_torch.control.clock import SampleClock, seconds

log = logging.getLogger(__name__)
BEYOND_THE_RANGE = "beyond the recorded range"


class Sample(NamedTuple):
    """A call: time in s, perhaps not finite; observation (p,) m, not finite where missing; missed, anew and new as in
    `Interval`; due: a control step is.
    """

    time: float
    observation: np.ndarray
    missed: int
    anew: bool
    new: bool
    due: bool


class Sampling:
    """Reads the calls of a controller that decides at every `every`-th sample, `timestep` s apart.

    model: with `state_scale`, `decode` and `output_dim`. longest: samples that may be skipped without a fresh start.
    A step that is due at a skipped sample is due at the next one, and the following ones are counted from there.
    A first measurement outside of the recorded range, such as an absolute position, is told to the log, once.
    counts: those of `SampleClock`, and measurements "missing" in part or whole, "unreadable" where a value was no
    number, and "beyond the recorded range".
    """

    def __init__(self, model, timestep: float, every: int, longest: int):
        self.size, self.every = model.output_dim, int(every)
        self.range, self.clock = RecordedRange(model), SampleClock(timestep, longest)
        self.reset()

    @property
    def counts(self) -> Counter[str]:
        return self.clock.counts

    def reset(self) -> None:
        """Forget the calls and the counts."""
        self.clock.reset()
        self._index, self._first = 0, True

    @property
    def due_next(self) -> bool:
        """Whether the next sample, when it comes in time, is that of a control step."""
        return self._index % self.every == 0

    def take(self, time, observation) -> Sample:
        """The next call. Raises ValueError for an observation of another shape."""
        observation, readable = read(observation, self.size)
        time = seconds(time)
        missed, anew, new = self.clock.advance(time)
        if not new:
            return Sample(time, observation, 0, False, False, False)
        self._judge(observation, readable)
        self._index = 0 if anew else self._index + missed
        since = self._index % self.every
        due = since <= missed
        self._index = 1 if due else self._index + 1
        return Sample(time, observation, missed, anew, True, due)

    def _judge(self, observation: np.ndarray, readable: bool) -> None:
        if not readable:
            self.counts["unreadable"] += 1
        held = self.range.holds(observation)
        if held.all():
            self._first = False
            return
        whole = np.isfinite(observation)
        if not whole.all():
            self.counts["missing"] += 1
        if (whole & ~held).any():
            self.counts[BEYOND_THE_RANGE] += 1
            if self._first:
                log.warning(self.range.complaint(observation))
        self._first = self._first and not whole.any()
