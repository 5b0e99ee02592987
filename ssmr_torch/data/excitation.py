"""Input signals that excite a robot inside its bounds.

An excitation is called as excitation(rng, samples, timestep, bounds) → (samples, m), with bounds (2, m) the
lowest and highest input; row k is held from k·timestep to (k + 1)·timestep. Levels are fractions of the way
from lowest to highest. Equal generators give equal signals.

SciPy's modules are imported where they are used: they take a second, and every process that records would wait for it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.random import Generator


class Excitation(Protocol):
    def __call__(self, rng: Generator, samples: int, timestep: float, bounds: np.ndarray) -> np.ndarray:
        """Inputs (samples, m) inside bounds (2, m)."""


@runtime_checkable
class Release(Excitation, Protocol):
    """An excitation that lets go after `hold` s and leaves every input at its lowest from then on."""

    hold: float


@dataclass(frozen=True)
class Ramp:
    """Ramp from the lowest input to `levels` within `ramp` s, hold until `hold` s, then release at once.

    levels: (m,) fractions.
    """

    levels: Sequence[float]
    ramp: float = 0.6
    hold: float = 1.0

    def __post_init__(self):
        _check_fractions("levels", self.levels)
        _check_ramp(self.ramp, self.hold)

    def __call__(self, rng: Generator, samples: int, timestep: float, bounds: np.ndarray) -> np.ndarray:
        levels = np.asarray(self.levels, dtype=np.float64)
        if levels.shape != bounds[0].shape:
            raise ValueError(f"{len(levels)} levels for {bounds.shape[1]} inputs; give one level per input")
        return _scale(_ramp_profile(samples, timestep, self.ramp, self.hold)[:, None] * levels, bounds)


@dataclass(frozen=True)
class RandomOnOffRamp:
    """A `Ramp` with each cable on with `probability`, at a level U(0, share), at least one of them on."""

    share: float = 1.0
    probability: float = 0.5
    ramp: float = 0.6
    hold: float = 1.0

    def __post_init__(self):
        _check_share(self.share)
        _check_ramp(self.ramp, self.hold)
        if not 0 < self.probability <= 1:
            raise ValueError(f"probability is {self.probability}; expected 0 < probability ≤ 1")

    def __call__(self, rng: Generator, samples: int, timestep: float, bounds: np.ndarray) -> np.ndarray:
        on = np.zeros(bounds.shape[1], dtype=bool)
        while not on.any():
            on = rng.random(bounds.shape[1]) < self.probability
        levels = np.where(on, rng.uniform(0, self.share, bounds.shape[1]), 0.0)
        return Ramp(levels, self.ramp, self.hold)(rng, samples, timestep, bounds)


def latin_hypercube_ramps(count: int, inputs: int, seed: int, share: float = 1.0,
                          ramp: float = 0.6, hold: float = 1.0) -> list[Ramp]:
    """`count` ramps whose levels are a Latin hypercube on [0, share]^inputs: every input is spread evenly."""
    return [Ramp(levels, ramp, hold) for levels in _latin_hypercube(count, inputs, seed, share)]


@dataclass(frozen=True)
class SmoothRandom:
    """Cubic spline through levels U(lowest, 1)·share, a knot every `knot_interval` s, clipped to the bounds.

    A negative `lowest` leaves each cable slack for part of the time.
    """

    knot_interval: float = 0.4
    share: float = 1.0
    lowest: float = -0.3

    def __post_init__(self):
        _check_share(self.share)
        _check_positive("knot_interval", self.knot_interval)
        if not -np.inf < self.lowest < 1:
            raise ValueError(f"lowest is {self.lowest}; expected a finite fraction below 1")

    def __call__(self, rng: Generator, samples: int, timestep: float, bounds: np.ndarray) -> np.ndarray:
        from scipy.interpolate import CubicSpline

        time = np.arange(samples) * timestep
        intervals = max(1, int(np.ceil(time[-1] / self.knot_interval)))
        levels = self.share * rng.uniform(self.lowest, 1, (intervals + 1, bounds.shape[1]))
        spline = CubicSpline(np.arange(intervals + 1) * self.knot_interval, levels)
        return _scale(np.clip(spline(time), 0, self.share), bounds)


@dataclass(frozen=True)
class RandomSteps:
    """Levels U(0, share) drawn anew every `hold` s, with jumps in between."""

    hold: float = 1.0
    share: float = 1.0

    def __post_init__(self):
        _check_share(self.share)
        _check_positive("hold", self.hold)

    def __call__(self, rng: Generator, samples: int, timestep: float, bounds: np.ndarray) -> np.ndarray:
        index = _interval(samples, timestep, self.hold)
        levels = rng.uniform(0, self.share, (index[-1] + 1, bounds.shape[1]))
        return _scale(levels[index], bounds)


@dataclass(frozen=True)
class SetPoints:
    """The rows of `levels` (K, m), one after the other for `hold` s each; the last is held to the end."""

    levels: Sequence[Sequence[float]]
    hold: float = 3.0

    def __post_init__(self):
        _check_fractions("levels", self.levels)
        _check_positive("hold", self.hold)

    @property
    def duration(self) -> float:
        """Until the last set point was held as long as the others, s."""
        return len(self.levels) * self.hold

    def __call__(self, rng: Generator, samples: int, timestep: float, bounds: np.ndarray) -> np.ndarray:
        levels = np.asarray(self.levels, dtype=np.float64)
        if levels.ndim != 2 or levels.shape[1] != bounds.shape[1]:
            raise ValueError(f"levels have shape {levels.shape}; expected (K, {bounds.shape[1]}), "
                             "one row per set point")
        return _scale(levels[np.minimum(_interval(samples, timestep, self.hold), len(levels) - 1)], bounds)


def latin_hypercube_set_points(count: int, inputs: int, seed: int, share: float = 1.0,
                               hold: float = 2.0) -> SetPoints:
    """`count` set points, a Latin hypercube on [0, share]^inputs: every input is spread evenly."""
    return SetPoints(tuple(_latin_hypercube(count, inputs, seed, share)), hold)


@dataclass(frozen=True)
class Chirp:
    """Sines about share/2 that sweep logarithmically from `slowest` to `fastest` Hz, at random phases."""

    slowest: float = 0.1
    fastest: float = 3.0
    share: float = 1.0

    def __post_init__(self):
        _check_share(self.share)
        if not 0 < self.slowest < self.fastest < np.inf:
            raise ValueError(f"the sweep goes from {self.slowest} to {self.fastest} Hz; "
                             "expected 0 < slowest < fastest")

    def __call__(self, rng: Generator, samples: int, timestep: float, bounds: np.ndarray) -> np.ndarray:
        from scipy.signal import chirp

        if self.fastest >= 0.5 / timestep:
            raise ValueError(f"fastest is {self.fastest} Hz, but a signal held for {timestep} s carries less "
                             f"than {0.5 / timestep:g} Hz; lower it or the timestep")
        time = np.arange(samples) * timestep
        phases = rng.uniform(0, 360, bounds.shape[1])
        sweep = np.stack([chirp(time, self.slowest, samples * timestep, self.fastest, "logarithmic", phi)
                          for phi in phases], axis=-1)
        return _scale(np.clip(0.5 * self.share * (1 + sweep), 0, self.share), bounds)


def _scale(fractions: np.ndarray, bounds: np.ndarray) -> np.ndarray:
    return np.clip(bounds[0] + fractions * (bounds[1] - bounds[0]), bounds[0], bounds[1])


def _latin_hypercube(count: int, inputs: int, seed: int, share: float) -> list[tuple[float, ...]]:
    """`count` rows of levels; each input has one in each of `count` equal intervals of [0, share]."""
    from scipy.stats import qmc

    _check_share(share)
    if count < 0:
        raise ValueError(f"count is {count}; expected a whole number, 0 or more")
    levels = share * qmc.LatinHypercube(inputs, rng=np.random.default_rng(seed)).random(count)
    return [tuple(row.tolist()) for row in levels]


def _interval(samples: int, timestep: float, hold: float) -> np.ndarray:
    """Which interval of `hold` s each sample lies in; rounding never opens one early or late."""
    return np.floor(np.arange(samples) * timestep / hold + 1e-9).astype(int)


def _ramp_profile(samples: int, timestep: float, ramp: float, hold: float) -> np.ndarray:
    time = np.arange(samples) * timestep
    rise = np.minimum(time / ramp, 1.0) if ramp > 0 else np.ones(samples)
    return np.where(np.arange(samples) < round(hold / timestep), rise, 0.0)


def _check_share(share: float) -> None:
    if not 0 < share <= 1:
        raise ValueError(f"share is {share}; expected 0 < share ≤ 1, a fraction of the input range")


def _check_positive(name: str, value: float) -> None:
    if not 0 < value < np.inf:
        raise ValueError(f"{name} is {value} s; expected a positive finite time")


def _check_ramp(ramp: float, hold: float) -> None:
    if not 0 <= ramp <= hold < np.inf:
        raise ValueError(f"the ramp ends at {ramp} s and the hold at {hold} s; expected 0 ≤ ramp ≤ hold")


def _check_fractions(name: str, levels: Sequence) -> None:
    array = np.asarray(levels, dtype=np.float64)
    if array.size == 0 or not ((array >= 0) & (array <= 1)).all():
        raise ValueError(f"{name} are {array.tolist()}; expected fractions of the input range, 0 to 1")
