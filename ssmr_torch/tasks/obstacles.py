"""Obstacles of a task: regions that the tracked outputs must not enter."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass, replace

import numpy as np

from ssmr_torch.checked_arguments import checked
from ssmr_torch.quantities import LENGTH, SEED
from ssmr_torch.ranges import Each, Either, Function, Number, Whole
from ssmr_torch.tasks.curves import Drift, refuse_nameless


@checked(center=Either(Each(Number(-1e3, 1e3, "m"), 2, 2), Function()), radius=Number(1e-9, 1e3, "m"))
@dataclass(frozen=True, eq=False)
class Circle:
    """‖y − c(t)‖ ≥ radius, in the plane of the first two tracked outputs (a cylinder where a third is tracked).

    center: (2,) m; for a moving obstacle a function from times (K,) s to centers (K, 2) m.
    Raises ValueError for a radius that is not positive or a center of another shape.
    """

    center: np.ndarray | Callable[[np.ndarray], np.ndarray]
    radius: float

    def __post_init__(self):
        if not (np.isfinite(self.radius) and self.radius > 0):
            raise ValueError(f"the radius of an obstacle is {self.radius} m; expected a positive length")
        if not callable(self.center):
            center = np.array(self.center, dtype=np.float64)
            if center.shape != (2,) or not np.isfinite(center).all():
                raise ValueError(f"the center of an obstacle is {self.center}; expected two lengths in m")
            object.__setattr__(self, "center", center)
        self.centers(np.zeros(1))

    def __getstate__(self) -> dict:
        refuse_nameless(self.center, "the center of a moving obstacle")
        return self.__dict__

    def __deepcopy__(self, memo) -> Circle:
        return replace(self, center=deepcopy(self.center, memo))

    def centers(self, time: np.ndarray) -> np.ndarray:
        """Centers (K, 2) m at times (K,) s. Raises ValueError when the function returns another shape."""
        time = np.atleast_1d(np.asarray(time, dtype=np.float64))
        if not callable(self.center):
            return np.broadcast_to(self.center, (len(time), 2))
        centers = np.asarray(self.center(time), dtype=np.float64)
        if centers.shape != (len(time), 2):
            raise ValueError(f"the center of a moving obstacle has shape {centers.shape} at {len(time)} times; "
                             f"expected {(len(time), 2)}")
        return centers

    def clearance(self, time: np.ndarray, outputs: np.ndarray) -> np.ndarray:
        """‖y − c‖ − radius, (K,) m, for the first two columns of outputs (K, ≥ 2); negative inside the circle."""
        return np.linalg.norm(outputs[:, :2] - self.centers(time), axis=1) - self.radius


@dataclass(frozen=True, eq=False)
class HalfPlane:
    """normalᵀ y ≤ offset for the first tracked outputs, as many as the normal has entries. The normal has length one.

    Raises ValueError for a normal of length zero.
    """

    normal: np.ndarray
    offset: float

    def __post_init__(self):
        normal = np.atleast_1d(np.array(self.normal, dtype=np.float64))
        length = np.linalg.norm(normal)
        if normal.ndim != 1 or not np.isfinite(length) or length == 0 or not np.isfinite(self.offset):
            raise ValueError(f"a half-plane has the normal {self.normal} and the offset {self.offset} m; expected a "
                             "normal that is not zero, and a finite offset")
        object.__setattr__(self, "normal", normal / length)
        object.__setattr__(self, "offset", float(self.offset / length))

    def clearance(self, time: np.ndarray, outputs: np.ndarray) -> np.ndarray:
        """offset − normalᵀ y, (K,) m, for outputs (K, ≥ len(normal)); negative where the half-plane is violated."""
        return self.offset - outputs[:, :len(self.normal)] @ self.normal


def drifting(center, velocity) -> Callable[[np.ndarray], np.ndarray]:
    """A function for `Circle.center`: a center (2,) m that moves with a constant velocity (2,) m/s."""
    center, velocity = np.array(center, dtype=np.float64), np.array(velocity, dtype=np.float64)
    return Drift(center, velocity)


@checked(seed=SEED, count=Whole(0, 1000), reach=Number(1e-6, 100.0, "m"),
         diameters=Each(Number(1e-6, 100.0, "m"), 2, 2), free=LENGTH, gap=LENGTH)
def random_circles(seed: int, count: int = 20, reach: float = 0.030, diameters: tuple[float, float] = (0.008, 0.012),
                   free: float = 0.010, gap: float = 0.003) -> tuple[Circle, ...]:
    """Random circles: centers uniform in ±reach, not within `free` of the origin, `gap` apart (paper, ETH task).

    The seed fixes them. Lengths are in m. Raises ValueError when there is no room for that many circles.
    """
    covered, room = count * np.pi * (diameters[0] + gap)**2 / 4, (2 * reach + diameters[1] + gap)**2
    rng, most = np.random.default_rng(seed), 0
    for _ in range(500 if covered < room else 0):  # a set that leaves no room for its last circles is drawn again
        centers, radii = np.empty((0, 2)), np.empty(0)
        for _ in range(2000):
            center, radius = rng.uniform(-reach, reach, 2), 0.5 * rng.uniform(*diameters)
            apart = np.linalg.norm(centers - center, axis=1) >= radii + radius + gap
            if apart.all() and np.linalg.norm(center) >= radius + free:
                centers, radii = np.vstack([centers, center]), np.append(radii, radius)
            if len(radii) == count:
                return tuple(Circle(center, float(radius)) for center, radius in zip(centers, radii))
        most = max(most, len(radii))
    raise ValueError(f"seed {seed} leaves room for {most} circles; expected {count}. Ask for fewer or smaller circles, "
                     "or increase reach")
