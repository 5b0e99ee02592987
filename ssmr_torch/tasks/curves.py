"""The paths of the tasks as objects, not closures: a task, and a controller of it, can then be copied and pickled."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

# The frequencies of a figure eight: (−sin θ, sin 2θ) = sin(EIGHT · θ).
EIGHT = np.array([-1.0, 2.0])


@dataclass(frozen=True)
class RampedPhase:
    """θ(t) of `references.ramped_phase`: times (...) s in [0, duration] → (...), from 0 to `total`."""

    total: float
    speed: float
    ramp: float
    duration: float

    def __call__(self, time: np.ndarray) -> np.ndarray:
        # number by number: of the few that a controller asks for, faster than a dozen array operations
        time = np.asarray(time, dtype=np.float64)
        return np.array([self._turned(t) for t in time.ravel().tolist()]).reshape(time.shape)

    def _turned(self, time: float) -> float:
        since = min(time, self.duration - time)
        if since < self.ramp:
            s = since / self.ramp
            since = self.ramp * s**4 * (s * s - 3.0 * s + 2.5)
        else:
            since -= 0.5 * self.ramp
        return self.speed * since if 2.0 * time <= self.duration else self.total - self.speed * since


@dataclass(frozen=True)
class EightPath:
    """(−a sin θ, a sin 2θ), (K,) s → (K, 2) m."""

    amplitude: float
    phase: RampedPhase

    def __call__(self, time: np.ndarray) -> np.ndarray:
        return self.amplitude * np.sin(np.multiply.outer(self.phase(time), EIGHT))


@dataclass(frozen=True)
class CirclePath:
    """(a sin θ, a − a cos θ), (K,) s → (K, 2) m."""

    amplitude: float
    phase: RampedPhase

    def __call__(self, time: np.ndarray) -> np.ndarray:
        theta = self.phase(time)
        return self.amplitude * np.stack([np.sin(theta), 1.0 - np.cos(theta)], axis=-1)


@dataclass(frozen=True, eq=False)
class OutAndRound:
    """centre (2,) + r(t) (cos θ, sin θ) m: out to the radius (m) within `approach` s, round while θ = phase turns for
    `turning` s, and back in; (K,) s → (K, 2) m.
    """

    centre: np.ndarray
    radius: float
    approach: float
    turning: float
    phase: RampedPhase

    def __post_init__(self):
        object.__setattr__(self, "centre", np.asarray(self.centre, dtype=np.float64))

    def __call__(self, time: np.ndarray) -> np.ndarray:
        out = np.clip(np.minimum(time, self.turning + 2 * self.approach - time) / self.approach, 0.0, 1.0)
        r = self.radius * out ** 3 * (10.0 - 15.0 * out + 6.0 * out ** 2)
        theta = self.phase(np.clip(time - self.approach, 0.0, self.turning))
        return self.centre + r[:, None] * np.stack([np.cos(theta), np.sin(theta)], axis=-1)


@dataclass(frozen=True)
class RosePath:
    """a sin(p θ) (cos θ, sin θ), (K,) s → (K, 2) m."""

    amplitude: float
    petals: int
    phase: RampedPhase

    def __call__(self, time: np.ndarray) -> np.ndarray:
        theta = self.phase(time)
        return self.amplitude * (np.sin(self.petals * theta) * np.stack([np.cos(theta), np.sin(theta)])).T


@dataclass(frozen=True, eq=False)
class Polyline:
    """Straight between points (T, q) m at places (T,), held at the ends; phase: time (K,) s → place, or None: time."""

    places: np.ndarray
    points: np.ndarray
    phase: Callable | None = None

    def __post_init__(self):
        object.__setattr__(self, "places", np.asarray(self.places, dtype=np.float64))
        object.__setattr__(self, "points", np.asarray(self.points, dtype=np.float64))

    def __call__(self, time: np.ndarray) -> np.ndarray:
        place = time if self.phase is None else self.phase(time)
        return np.stack([np.interp(place, self.places, column) for column in self.points.T], axis=-1)


@dataclass(frozen=True, eq=False)
class Drift:
    """center + velocity t, (K,) s → (K, 2) m."""

    center: np.ndarray
    velocity: np.ndarray

    def __post_init__(self):
        object.__setattr__(self, "center", np.asarray(self.center, dtype=np.float64))
        object.__setattr__(self, "velocity", np.asarray(self.velocity, dtype=np.float64))

    def __call__(self, time: np.ndarray) -> np.ndarray:
        return self.center + time[:, None] * self.velocity


def refuse_nameless(function, whose: str) -> None:
    """Raises TypeError for a function that a pickle cannot hold: a lambda, or one made inside another function."""
    name = getattr(function, "__qualname__", "")
    if "<lambda>" in name or "<locals>" in name:
        raise TypeError(f"{whose} cannot be pickled: no module has its function {name} by that name. Define it at "
                        "the top of a module, or give points with ssmr_torch.tasks.path")
