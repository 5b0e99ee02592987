"""Input signals that excite a robot inside its bounds.

An excitation is called as excitation(rng, samples, timestep, bounds) → (samples, m), with bounds (2, m) the
lowest and highest input; row k is held from k·timestep to (k + 1)·timestep. Equal generators give equal signals.

A robot rests under the input 0, clipped into the bounds: r. One that has a neutral input of its own, such as a
pretension, is excited about that: its signals are those of the bounds less that input, plus that input. A share s of
the range is what lies between r + s (lowest − r) and r + s (highest − r), and levels 0 to s are fractions of the
range, counted from the lower end of that share. So cables that only pull rest at level 0, and signed inputs (−1 to 1)
move to both sides of their rest.

SciPy's modules are imported where they are used: they take a second, and every process that records would wait for it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.random import Generator

from ssmr_torch.checked_arguments import checked
from ssmr_torch.quantities import HELD, OF_RANGE, SEED, STAY
from ssmr_torch.ranges import Number, Whole


class Excitation(Protocol):
    def __call__(self, rng: Generator, samples: int, timestep: float, bounds: np.ndarray) -> np.ndarray:
        """Inputs (samples, m) inside bounds (2, m)."""


@runtime_checkable
class Release(Excitation, Protocol):
    """An excitation that lets go after `hold` s and leaves every input at rest from then on."""

    hold: float


def resting_input(bounds: np.ndarray) -> np.ndarray:
    """(m,), the input under which a robot rests: 0, clipped into the bounds (2, m)."""
    return np.clip(0.0, bounds[0], bounds[1])


def neutral_input(plant) -> np.ndarray:
    """(m,), the input under which this robot is left alone: its `neutral_input` where it has one, else `resting_input`.

    Raises ValueError for one of the robot's own that is not m finite numbers within its bounds.
    """
    lower, upper = np.asarray(plant.input_bounds, dtype=np.float64)
    own = getattr(plant, "neutral_input", None)
    if own is None:
        return resting_input(np.stack([lower, upper]))
    own = np.asarray(own, dtype=np.float64)
    if own.shape != lower.shape or not ((lower <= own) & (own <= upper)).all():
        raise ValueError(f"the neutral input of {plant.name!r} is {own.tolist()}; expected {len(lower)} numbers "
                         f"between {lower.tolist()} and {upper.tolist()}: correct it or the bounds")
    return own


@checked(ramp=STAY, hold=STAY, share=OF_RANGE)
@dataclass(frozen=True)
class Ramp:
    """Ramp from the resting input to `levels` within `ramp` s, hold until `hold` s, then release at once.

    levels: (m,) fractions of the range, within a share of it.
    """

    levels: Sequence[float]
    ramp: float = 0.6
    hold: float = 1.0
    share: float = 1.0

    def __post_init__(self):
        _check_share(self.share)
        _check_fractions("levels", self.levels, self.share)
        _check_ramp(self.ramp, self.hold)

    def __call__(self, rng: Generator, samples: int, timestep: float, bounds: np.ndarray) -> np.ndarray:
        levels = np.asarray(self.levels, dtype=np.float64)
        if levels.shape != bounds[0].shape:
            raise ValueError(f"{len(levels)} levels for {bounds.shape[1]} inputs; give one level per input")
        profile = _ramp_profile(samples, timestep, self.ramp, self.hold)[:, None]
        rest = _resting_level(bounds, self.share)
        return _scale(rest + profile * (levels - rest), self.share, bounds)


@checked(share=OF_RANGE, probability=Number(1e-3, 1.0), ramp=STAY, hold=STAY)
@dataclass(frozen=True)
class RandomOnOffRamp:
    """A `Ramp` with each input on with `probability`, at a level U(0, share), at least one of them on."""

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
        levels = np.where(on, rng.uniform(0, self.share, bounds.shape[1]), _resting_level(bounds, self.share))
        return Ramp(levels, self.ramp, self.hold, self.share)(rng, samples, timestep, bounds)


@checked(count=Whole(0, 10_000), inputs=Whole(1, 1000), seed=SEED, share=OF_RANGE, ramp=STAY, hold=STAY)
def latin_hypercube_ramps(count: int, inputs: int, seed: int, share: float = 1.0,
                          ramp: float = 0.6, hold: float = 1.0) -> list[Ramp]:
    """`count` ramps whose levels are a Latin hypercube on [0, share]^inputs: every input is spread evenly."""
    return [Ramp(levels, ramp, hold, share) for levels in _latin_hypercube(count, inputs, seed, share)]


@checked(knot_interval=HELD, share=OF_RANGE, lowest=Number(-10.0, 0.99))
@dataclass(frozen=True)
class SmoothRandom:
    """Cubic spline through levels U(lowest, 1)·share, a knot every `knot_interval` s, clipped to the share.

    A negative `lowest` leaves each cable slack for part of the time. A signed input has no slack side: its levels are
    U(0, 1)·share.
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
        evenly = (levels - self.share * self.lowest) / (1 - self.lowest)
        levels = np.where(resting_input(bounds) == bounds[0], levels, evenly)
        spline = CubicSpline(np.arange(intervals + 1) * self.knot_interval, levels)
        return _scale(np.clip(spline(time), 0, self.share), self.share, bounds)


@checked(hold=HELD, share=OF_RANGE)
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
        return _scale(levels[index], self.share, bounds)


@checked(hold=HELD, share=OF_RANGE)
@dataclass(frozen=True)
class SetPoints:
    """The rows of `levels` (K, m), one after the other for `hold` s each; the last is held to the end."""

    levels: Sequence[Sequence[float]]
    hold: float = 3.0
    share: float = 1.0

    def __post_init__(self):
        _check_share(self.share)
        _check_fractions("levels", self.levels, self.share)
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
        reached = np.minimum(_interval(samples, timestep, self.hold), len(levels) - 1)
        return _scale(levels[reached], self.share, bounds)


@checked(count=Whole(1, 10_000), inputs=Whole(1, 1000), seed=SEED, share=OF_RANGE, hold=HELD)
def latin_hypercube_set_points(count: int, inputs: int, seed: int, share: float = 1.0,
                               hold: float = 2.0) -> SetPoints:
    """`count` set points, a Latin hypercube on [0, share]^inputs: every input is spread evenly."""
    return SetPoints(tuple(_latin_hypercube(count, inputs, seed, share)), hold, share)


@checked(slowest=Number(1e-4, 1e4, "Hz"), fastest=Number(1e-4, 1e4, "Hz"), share=OF_RANGE)
@dataclass(frozen=True)
class Chirp:
    """Sines about the middle of the share that sweep logarithmically from `slowest` to `fastest` Hz, at random
    phases."""

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
        return _scale(np.clip(0.5 * self.share * (1 + sweep), 0, self.share), self.share, bounds)


@checked(share=OF_RANGE, hold=HELD)
@dataclass(frozen=True)
class Dithered:
    """Another excitation with white steps on top: N(0, share of the range) anew every `hold` s, within the bounds.

    Smooth inputs alone leave the fast response unidentified, of which a controller's own inputs are full. The other
    excitation draws its random numbers first, so that its signal is the same with and without the dither.
    """

    excitation: Excitation
    share: float = 0.025
    hold: float = 0.02

    def __post_init__(self):
        _check_share(self.share)
        _check_positive("hold", self.hold)
        if not callable(self.excitation):
            raise ValueError(f"excitation is {self.excitation!r}; expected the one to dither, such as SmoothRandom()")

    @property
    def duration(self) -> float:
        """That of the excitation, s; AttributeError where it has no end of its own."""
        return self.excitation.duration

    def __call__(self, rng: Generator, samples: int, timestep: float, bounds: np.ndarray) -> np.ndarray:
        signal = self.excitation(rng, samples, timestep, bounds)
        index = _interval(samples, timestep, self.hold)
        steps = rng.normal(0.0, self.share, (index[-1] + 1, bounds.shape[1])) * (bounds[1] - bounds[0])
        return np.clip(signal + steps[index], bounds[0], bounds[1])


@checked(share=OF_RANGE, hold=HELD)
def mpc_like(excitation: Excitation, share: float = 0.05, hold: float = 0.02) -> Dithered:
    """Inputs as a predictive controller makes them: a smooth signal, each `hold` s corrected by 5 % of the range."""
    return Dithered(excitation, share, hold)


def _scale(levels: np.ndarray, share: float, bounds: np.ndarray) -> np.ndarray:
    """Inputs of levels from 0 to `share`, fractions of the range from the lower end of the share."""
    rest = resting_input(bounds)
    lower = np.where(rest == bounds[0], bounds[0], rest + share * (bounds[0] - rest))
    inputs = np.clip(lower + levels * (bounds[1] - bounds[0]), bounds[0], bounds[1])
    return np.where(levels == _resting_level(bounds, share), rest, inputs)  # a release is exact


def _resting_level(bounds: np.ndarray, share: float) -> np.ndarray:
    """(m,), the level of the resting input."""
    return share * (resting_input(bounds) - bounds[0]) / (bounds[1] - bounds[0])


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


def _check_fractions(name: str, levels: Sequence, share: float) -> None:
    array = np.asarray(levels, dtype=np.float64)
    if array.size == 0 or not ((array >= 0) & (array <= share)).all():
        raise ValueError(f"{name} are {array.tolist()}; expected fractions of the input range, 0 to {share:g}")
