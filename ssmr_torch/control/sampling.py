"""What a controller does with every call before it decides: its time, missing or unreadable measurements, and range.

`SampleClock` finds the sample of the call. `read` turns any measurement into p numbers. `RecordedRange` tells which of
them can be displacements of the robot. `Sampling` does all three, and tells whether a control step is due.
"""

from __future__ import annotations

import logging
from collections import Counter
from math import isfinite
from typing import NamedTuple

import numpy as np

log = logging.getLogger(__name__)
# Share of a timestep by which a measurement may be early or late and still belong to its sample.
EARLY_OR_LATE = 0.1
# A value of more than this many times the recorded range is not taken as a displacement.
BEYOND = 2.0
# The range of an output is at least this share of the widest range.
NARROWEST = 0.2
BEYOND_THE_RANGE = "beyond the recorded range"


class Interval(NamedTuple):
    """What follows from the time of a call.

    missed: number of samples that were skipped since the last call.   anew: True after a jump in time, when the
    controller must start again at the robot's position.   new: False if there is no new sample since the last call.
    """

    missed: int = 0
    anew: bool = False
    new: bool = True


class SampleClock:
    """Places each call on the grid of the samples, `timestep` s apart.

    An interval of k timesteps means that k − 1 samples were skipped; at most `longest` may be skipped. A call that is
    off the grid by more than `EARLY_OR_LATE` belongs to the nearest sample, and the difference is kept: intervals of
    1.5 timesteps count as one and two in turn. A call within half a timestep of the last one gives no new sample. After
    a jump backwards, or over more than `longest` samples, the clock restarts. A time that is not finite counts as that
    of the next sample.

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
        """The interval for a call at time s."""
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
        regular = abs(since - samples) <= EARLY_OR_LATE
        self._last = time if regular else self._last + samples * self.timestep
        if not regular:
            self.counts["irregular"] += 1
        if samples > 1:
            self.counts["skipped"] += samples - 1
        return Interval(missed=samples - 1)


def seconds(time) -> float:
    """The time as a number; NaN where it is not a number."""
    try:
        return float(time)
    except (TypeError, ValueError, OverflowError):
        return float("nan")


def read(observation, size: int) -> tuple[np.ndarray, bool]:
    """The observation as float64 (size,), a copy, and whether every value in it was a number.

    A masked value, or one that is not a number (None, a text, a complex number), becomes NaN: a missing value.
    Raises ValueError for another shape.
    """
    if type(observation) is np.ndarray and observation.dtype == np.float64:
        found, readable = observation.copy(), True
    else:
        found, readable = _numbers(observation, size)
    if found.shape != (size,):
        raise ValueError(f"the observation has shape {found.shape}; expected ({size},)")
    return found, readable


def _numbers(observation, size: int) -> tuple[np.ndarray, bool]:
    if isinstance(observation, np.ma.MaskedArray):
        values, readable = _numbers(observation.data, size)
        return np.where(np.ma.getmaskarray(observation), np.nan, values), readable
    numeric = not isinstance(observation, np.ndarray) or observation.dtype.kind in "fiub"
    try:
        if numeric:
            return np.array(np.asarray(observation, dtype=np.float64)), True
    except (TypeError, ValueError, OverflowError, RuntimeError):
        pass  # there are other values than numbers: each one is checked below
    try:
        values = np.asarray(observation, dtype=object)
    except (TypeError, ValueError, RuntimeError):  # not convertible to an array
        return np.full(tuple(getattr(observation, "shape", ())), np.nan), False
    return np.array([_number(value) for value in values.ravel()]).reshape(values.shape), False


def _number(value) -> float:
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError):
        return float("nan")


class RecordedRange:
    """How far every output went in the training: |y − w(0)| ≤ r,

        r_j = Σ_i max(|w_j(s_i e_i) − w_j(0)|, |w_j(−s_i e_i) − w_j(0)|),   s = state_scale,

    and at least `NARROWEST` times the widest. center w(0) (p,), limit `BEYOND` r (p,), both m; the limit is the largest
    float where state_scale is unknown.
    """

    def __init__(self, model):
        scale = np.asarray(model.state_scale, dtype=np.float64)
        self.center, self.limit = np.zeros(model.output_dim), np.full(model.output_dim, np.finfo(np.float64).max)
        if not np.isfinite(scale).all():
            return
        with np.errstate(all="ignore"):
            center = model.decode(np.zeros(len(scale)))
            ends = np.abs(model.decode(np.concatenate([np.diag(scale), np.diag(-scale)])) - center)
        reach = ends.reshape(2, len(scale), -1).max(axis=0).sum(axis=0)
        if np.isfinite(reach).all() and np.isfinite(center).all():
            self.center, self.limit = center, BEYOND * np.maximum(reach, NARROWEST * reach.max())

    def holds(self, observation: np.ndarray) -> np.ndarray:
        """(p,), False for an output that is missing or outside the limit."""
        return np.abs(observation - self.center) <= self.limit

    def complaint(self, observation: np.ndarray) -> str:
        """A message about a first measurement outside the limit, with both numbers."""
        excess = np.where(np.isfinite(observation), np.abs(observation - self.center) / self.limit, 0.0)
        worst = int(np.argmax(excess))
        return (f"output {worst} is {1e3 * observation[worst]:.4g} mm at the first measurement; the model was trained "
                f"within {1e3 * self.limit[worst] / BEYOND:.4g} mm. Expected displacements from rest: subtract the "
                "rest position from absolute positions, or record larger motions")


class Sample(NamedTuple):
    """A call: time in s, perhaps not finite; observation (p,) m, not finite where missing; missed, anew and new as in
    `Interval`; due: whether a control step is due.
    """

    time: float
    observation: np.ndarray
    missed: int
    anew: bool
    new: bool
    due: bool


class Sampling:
    """Reads the calls of a controller that decides at every `every`-th sample, with samples `timestep` s apart.

    model: with `state_scale`, `decode` and `output_dim`. longest: samples that may be skipped without a restart.
    A control step that is due at a skipped sample is taken at the next one, and later steps are counted from there.
    A first measurement outside the recorded range, such as an absolute position, is logged once.
    counts: those of `SampleClock`, and measurements that are partly or wholly "missing", "unreadable" (a value was not
    a number), or "beyond the recorded range".
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
        """Whether a control step is due at the next sample, if it comes in time."""
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
