"""The paper's Pacman. Its letters are the general ones: conf/task/paper."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ssmr_torch.checked_arguments import checked
from ssmr_torch.quantities import TEXT, TRACKED
from ssmr_torch.ranges import Number
from ssmr_torch.tasks.references import Task
from ssmr_torch.tasks.symbols import constant_speed

ARC_STEPS = 1440  # straight pieces of the arc; its length is then accurate to 1e-6


@checked(radius=Number(1e-6, 100.0, "m"), mouth=Number(0.0, 6.2831, "rad"), duration=Number(1e-2, 1e5, "s"),
         ramp=Number(0.0, 1e4, "s"), tracked=TRACKED, name=TEXT)
def pacman(radius: float = 0.020, mouth: float = 1.0471976, duration: float = 10.0, ramp: float = 1.0,
           tracked: Sequence[int | str] = ("tip_x", "tip_y"), name: str = "pacman",
           obstacles: Sequence | None = None) -> Task:
    """A disc around rest with a mouth open towards +x, (2 + 2π − mouth) radius long, from its centre and back to it.

    radius in m; mouth: the angle between the two straight edges, in rad; duration and ramp in s.
    Raises ValueError for a radius that is not positive, a mouth outside (0, 2π), and where `constant_speed` does.
    """
    if not (np.isfinite(radius) and radius > 0):
        raise ValueError(f"pacman's radius is {radius} m; expected a positive length in m")
    if not 0 < mouth < 2 * np.pi:
        raise ValueError(f"pacman's mouth is {mouth} rad; expected more than 0 and less than 2π = 6.283 "
                         "(60 degrees are 1.0472)")
    angle = np.linspace(mouth / 2, 2 * np.pi - mouth / 2, ARC_STEPS + 1)
    corners = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return constant_speed(corners, duration, ramp, tracked, name, obstacles)
