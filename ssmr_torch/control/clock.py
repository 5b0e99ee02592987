"""Time as a fact: what lies between two calls of a controller, in samples."""

from __future__ import annotations

from collections import Counter
from math import isfinite
from typing import NamedTuple

# Share of a timestep by which a measurement may come early or late and still belong to its sample.
TOLERANCE = 0.1


class Interval(NamedTuple):
    """What the time of a call says.

    missed: samples that were skipped since the last call.   anew: the time says nothing about the last call, the
    controller begins again from where the robot is.   new: False where the sample of the last call is still the newest.
    """

    missed: int = 0
    anew: bool = False
    new: bool = True


class SampleClock:
    """Places each call on the grid of the samples, `timestep` s apart.

    An interval of k timesteps tells of k − 1 skipped samples, up to `longest` of them. What lies beside the grid by
    more than `TOLERANCE` goes to the nearest sample, and the rest is carried along, so that intervals of 1.5 timesteps
    are one and two in turn. A call within half a timestep of the last one brings nothing new. A jump backwards, or over
    more than `longest` samples, begins anew. A time that is not finite is taken for the next sample.

    counts: "skipped" samples, "irregular" intervals, "repeated" calls, calls "without time", "restarted" by a jump.
    """

    def __init__(self, timestep: float, longest: int):
        self.timestep, self.longest = float(timestep), int(longest)
        self.counts: Counter[str] = Counter()
        self.reset()

    def reset(self) -> None:
        """Forget the last call and the counts."""
        self.counts.clear()
        self._last: float | None = None

    def advance(self, time: float) -> Interval:
        """time in s, of this call."""
        since = 0.0 if self._last is None else (time - self._last) / self.timestep
        if not (isfinite(time) and isfinite(since)):
            self.counts["without time"] += 1
            self._last = None if self._last is None else self._last + self.timestep
            return Interval()
        if self._last is None:
            self._last = time
            return Interval()
        return self._placed(time, since)

    def _placed(self, time: float, since: float) -> Interval:
        samples = round(since)
        if samples == 0:
            self.counts["repeated"] += 1
            return Interval(new=False)
        if samples < 0 or samples - 1 > self.longest:
            self.counts["restarted"] += 1
            self._last = time
            return Interval(anew=True)
        regular = abs(since - samples) <= TOLERANCE
        self._last = time if regular else self._last + samples * self.timestep
        if not regular:
            self.counts["irregular"] += 1
        if samples > 1:
            self.counts["skipped"] += samples - 1
        return Interval(missed=samples - 1)


def seconds(time) -> float:
    """time as a number, not one where it is none."""
    try:
        return float(time)
    except (TypeError, ValueError, OverflowError):
        return float("nan")
