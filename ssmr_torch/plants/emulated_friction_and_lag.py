"""Actuators of an emulated rig: saturation, rate limit, lag and cable friction between a command and the plant."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ssmr_torch.plants.base import Plant
from ssmr_torch.settings import non_negative


class Forces(NamedTuple):
    """Forces of one step, each (m,), input unit: a after the rate limit, x after the lag, T after friction."""

    limited: np.ndarray
    lagged: np.ndarray
    transmitted: np.ndarray


class EmulatedActuators:
    """Actuators between the commands u of a controller and the plant; every part is off by default.

    Per input, with the timestep h and the forces a, x, T of the step before:

        v  = clip(u, input_bounds), at most saturation,
        a⁺ = clip(v, a - rate_limit h, a + rate_limit h),
        x⁺ = a⁺ - (a⁺ - x) exp(-h / lag),                            exact at the samples, as a⁺ is held
        T⁺ = clip(T, x⁺ exp(-cable_friction), x⁺ exp(cable_friction)),        held during the step.

    Friction follows the capstan equation. A cable that wraps the angle θ with friction μ slips only where the tensions
    at its ends differ by the factor exp(μθ); otherwise it keeps what it transmits (Kaneko et al., "A new consideration
    on tendon-tension control system of robot hands", ICRA 1991). This is a hysteresis that no slower motion avoids.

    lag: time constant, s. rate_limit: input unit per s. saturation: highest force, either way, within the bounds. Both
    are one number or (m,), None for no limit. cable_friction: μθ, 1; only for inputs that pull.
    Raises ValueError for settings out of these ranges.
    """

    def __init__(self, plant: Plant, *, lag: float = 0.0, rate_limit=None, saturation=None,
                 cable_friction: float = 0.0):
        self.lag = non_negative("actuator_lag", lag, "s")
        self.rate_limit = _limit("rate_limit", rate_limit, plant, f"{plant.input_unit}/s")
        self.saturation = _saturation(saturation, plant)
        self.cable_friction = _friction(cable_friction, plant)
        ceiling = np.inf if self.saturation is None else self.saturation
        self._lowest, self._highest = np.clip(plant.input_bounds, np.negative(ceiling), ceiling)
        self._stride = np.inf if self.rate_limit is None else plant.timestep * self.rate_limit
        self._share_left = np.exp(-plant.timestep / self.lag) if self.lag else 0.0
        self._slip = np.exp(self.cable_friction)

    @property
    def parameters(self) -> dict:
        """The settings as plain values, by the names that a rig has for them."""
        limits = {"rate_limit": self.rate_limit, "saturation": self.saturation}
        return {"actuator_lag": self.lag, "cable_friction": self.cable_friction,
                **{name: None if limit is None else limit.tolist() for name, limit in limits.items()}}

    @property
    def at_rest(self) -> Forces:
        """The forces nearest to zero that the bounds allow."""
        force = np.clip(0.0, self._lowest, self._highest)
        return Forces(force, force, force)

    def step(self, last: Forces, command: np.ndarray) -> Forces:
        """The forces of the next step, from those of the last one and a command (m,), which the bounds clip."""
        force = np.minimum(np.maximum(command, self._lowest), self._highest)
        limited = np.minimum(np.maximum(force, last.limited - self._stride), last.limited + self._stride)
        lagged = limited - (limited - last.lagged) * self._share_left
        transmitted = np.minimum(np.maximum(last.transmitted, lagged / self._slip), lagged * self._slip)
        return Forces(limited, lagged, transmitted)


def _limit(name: str, value, plant: Plant, unit: str) -> np.ndarray | None:
    """A limit per input, (m,), from one number or m."""
    if value is None:
        return None
    limit, m = np.array(value, dtype=np.float64), len(plant.input_names)
    if limit.shape not in ((), (m,)) or not ((limit > 0) & np.isfinite(limit)).all():
        raise ValueError(f"{name} is {limit.tolist()} {unit}; expected one positive finite number or {m}, "
                         "or None for no limit")
    return np.array(np.broadcast_to(limit, m))


def _saturation(value, plant: Plant) -> np.ndarray | None:
    limit, bounds = _limit("saturation", value, plant, plant.input_unit), plant.input_bounds
    if limit is not None and ((limit < np.maximum(bounds[0], -bounds[1])) | (limit > np.abs(bounds).max(axis=0))).any():
        raise ValueError(f"saturation is {limit.tolist()} {plant.input_unit}; expected forces within the input bounds "
                         f"{bounds.tolist()}: beyond them it has no effect")
    return limit


def _friction(value: float, plant: Plant) -> float:
    friction = non_negative("cable_friction", value, "(μθ)")
    if friction and (plant.input_bounds[0] < 0).any():
        raise ValueError(f"cable_friction is {friction} and the lowest inputs are {plant.input_bounds[0].tolist()} "
                         f"{plant.input_unit}; expected 0 or more, as cables only pull: leave friction off")
    return friction
