"""Puts the measurements of one run in order, although messages may be lost, late, repeated or reordered."""

from __future__ import annotations

from collections import Counter, deque
from enum import Enum

import numpy as np

from ssmr_torch.wire.messages import Message

# A time stamp is irregular when it differs by more than this share of a timestep from the time of its number.
IRREGULAR = 0.5
# So many numbers that were passed over are remembered, to tell late measurements from repeated ones.
REMEMBERED = 1000
# The clocks of both ends differ by less than this share.
DRIFT = 0.01


class Place(Enum):
    """The place of a measurement in the run."""

    NEXT = "the expected one, or a later one"
    AGAIN = "the newest one once more: answer it once more"
    PAST = "its place is taken"
    LATE = "it came after its place was passed over"
    INVALID = "not a measurement of this robot"
    BEYOND = "so far ahead that too many are missing"


class MeasurementStream:
    """Judges the measurements of a run and counts their faults.

    outputs: p.   timestep: s.   patience: how many samples in a row may be missing.   counts: counts the malformed,
    not_finite, irregular, missing, late (came after the next one was due), reordered (came after a newer one),
    repeated and renumbered measurements.   next: place of the next sample.   begun: whether a measurement has come.

    The place of a sample gives its time, place × timestep. It is the sample's number, plus `shift` for a robot that
    paused and then went on with the next number: the robot's stamps, or measurements that stay late, show it. Only
    differences of time stamps are used; they must grow. A measurement may be further ahead than `patience` where as
    much time has passed since the first one.
    """

    def __init__(self, outputs: int, timestep: float, patience: int, counts: Counter):
        self.outputs, self.timestep, self.patience, self.counts = outputs, timestep, patience, counts
        self.next = self.shift = 0
        self._newest, self._stamp, self._first_stamp = -1, 0.0, np.inf  # the last: of sample 0, by all later ones
        self._missed: deque[int] = deque(maxlen=REMEMBERED)
        self._earliest: float | None = None  # s, of arrival minus nominal time
        self._arrived = 0.0
        self._late_since: tuple[int, float] | None = None  # number and arrival of the last late one

    @property
    def begun(self) -> bool:
        return self._newest >= 0

    @property
    def number(self) -> int:
        """The robot's number of the newest sample."""
        return self.next - 1 - self.shift

    def place(self, message: Message, now: float | None = None) -> Place:
        """The place of a MEASUREMENT of this run; now: s, when it came."""
        if message.values.shape != (self.outputs,) or message.sequence > 2**62:
            self.counts["malformed"] += 1
            return Place.INVALID
        if message.sequence + self.shift < self.next:
            place = self._past(message, now)
            if place is not Place.NEXT:
                return place
        elif self.begun and message.time <= self._stamp:
            self.counts["malformed"] += 1
            return Place.INVALID
        ahead = message.sequence + self.shift - self.next
        return Place.NEXT if ahead <= self.patience or self._took_as_long(message, now) else Place.BEYOND

    def skip(self, samples: int = 1) -> float:
        """Continue without the next measurements; returns the time of the last of them, s."""
        self.counts["missing"] += samples
        self._missed.extend(range(max(self.next, self.next + samples - REMEMBERED), self.next + samples))
        self.next += samples
        return self.timestep * (self.next - 1)

    def take(self, message: Message, now: float | None = None) -> tuple[float, np.ndarray]:
        """(time s, observation (p,) m) of the next measurement; all NaN where one value is not finite."""
        number, observation = message.sequence, message.values
        due = (number - self._newest) * self.timestep
        if self.begun and abs(message.time - self._stamp - due) > IRREGULAR * self.timestep:
            self.counts["irregular"] += 1
        if not np.isfinite(observation).all():
            self.counts["not_finite"] += 1
            observation = np.full(self.outputs, np.nan)
        crept = self._first_stamp + DRIFT * self.timestep * (number - self._newest)
        self._first_stamp = min(crept, message.time - self.timestep * (number + self.shift))
        self._newest, self._stamp, self.next = number, message.time, number + self.shift + 1
        self._late_since = None
        if now is not None:
            ahead = now - self.timestep * (self.next - 1)
            crept = ahead if self._earliest is None else self._earliest + DRIFT * max(now - self._arrived, 0.0)
            self._earliest, self._arrived = min(ahead, crept), now
        return self.timestep * (self.next - 1), observation

    def _took_as_long(self, message: Message, now: float | None) -> bool:
        """Whether so many numbers fit into the time that has passed since the first measurement."""
        if now is None or self._earliest is None:
            return False
        early = self._earliest - (now - self.timestep * (message.sequence + self.shift))
        return early <= self.timestep * self.patience

    def _past(self, message: Message, now: float | None) -> Place:
        place = message.sequence + self.shift
        if place not in self._missed:
            self.counts["repeated"] += 1
            return Place.AGAIN if place == self.next - 1 else Place.PAST
        if message.sequence < self._newest:
            self._missed.remove(place)
            self.counts["reordered"] += 1
            return Place.PAST
        behind = self._behind(message, now)
        if behind:
            self.counts["renumbered"] += 1
            self.shift += behind
            if message.sequence + self.shift >= self.next:
                return Place.NEXT
        self._late_since = message.sequence, 0.0 if now is None else now
        if place in self._missed:
            self._missed.remove(place)
        self.counts["late"] += 1
        return Place.LATE

    def _behind(self, message: Message, now: float | None) -> int:
        """By how many numbers the robot fell behind, at a measurement that comes late."""
        if not self.begun or message.time <= self._stamp:
            return 0
        most = self.next - message.sequence - self.shift
        # Robots that skip numbers are late by less than a timestep, or two on a busy computer.
        stood_still = (message.time - self._first_stamp) / self.timestep - (message.sequence + self.shift)
        if stood_still + DRIFT >= 2.0:
            return int(min(stood_still + DRIFT, most))
        # Stamps that are made of the numbers show no pause. Then two late ones in a row do, if they came apart.
        if self._late_since is None or now is None:
            return 0
        number, came = self._late_since
        apart = message.sequence == number + 1 and now - came > IRREGULAR * self.timestep
        return most if apart and most > 1 else 0
