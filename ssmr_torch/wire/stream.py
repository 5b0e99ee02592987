"""Puts the measurements of one run in order, although messages may be lost, late, repeated or reordered."""

from __future__ import annotations

from collections import Counter
from enum import Enum

import numpy as np

from ssmr_torch.wire.messages import Message

# A time stamp is irregular when it differs by more than this share of a timestep from the time of its number.
IRREGULAR = 0.5


class Place(Enum):
    """The place of a measurement in the run."""

    NEXT = "the expected one, or a later one"
    AGAIN = "the newest one once more: answer it once more"
    PAST = "its place is taken"
    INVALID = "not a measurement of this robot"
    BEYOND = "so far ahead that too many are missing"


class MeasurementStream:
    """Judges the measurements of a run and counts their faults.

    outputs: p.   timestep: s.   patience: how many samples in a row may be missing.   counts: counts the malformed,
    not_finite, irregular, missing, late (came after the next one was due), reordered (came after a newer one) and
    repeated measurements.   next: number of the next sample.   begun: whether a measurement has come.
    The number of a sample gives its time, number × timestep. Only differences of time stamps are used; they must grow.
    """

    def __init__(self, outputs: int, timestep: float, patience: int, counts: Counter):
        self.outputs, self.timestep, self.patience, self.counts = outputs, timestep, patience, counts
        self.next = 0
        self._newest, self._stamp = -1, 0.0
        self._missed: set[int] = set()

    @property
    def begun(self) -> bool:
        return self._newest >= 0

    def place(self, message: Message) -> Place:
        """The place of a MEASUREMENT of this run."""
        if message.values.shape != (self.outputs,):
            self.counts["malformed"] += 1
            return Place.INVALID
        if message.sequence < self.next:
            return self._past(message.sequence)
        if self.begun and message.time <= self._stamp:
            self.counts["malformed"] += 1
            return Place.INVALID
        return Place.BEYOND if message.sequence - self.next > self.patience else Place.NEXT

    def skip(self) -> float:
        """Continue without the next measurement; returns its time, s."""
        self.counts["missing"] += 1
        self._missed.add(self.next)
        self._missed.discard(self.next - 4 * self.patience)
        self.next += 1
        return self.timestep * (self.next - 1)

    def take(self, message: Message) -> tuple[float, np.ndarray]:
        """(time s, observation (p,) m) of the next measurement; all NaN where one value is not finite."""
        number, observation = message.sequence, message.values
        due = (number - self._newest) * self.timestep
        if self.begun and abs(message.time - self._stamp - due) > IRREGULAR * self.timestep:
            self.counts["irregular"] += 1
        if not np.isfinite(observation).all():
            self.counts["not_finite"] += 1
            observation = np.full(self.outputs, np.nan)
        self._newest, self._stamp, self.next = number, message.time, number + 1
        return self.timestep * number, observation

    def _past(self, number: int) -> Place:
        if number in self._missed:
            self._missed.discard(number)
            self.counts["reordered" if number < self._newest else "late"] += 1
            return Place.PAST
        self.counts["repeated"] += 1
        return Place.AGAIN if number == self.next - 1 else Place.PAST
