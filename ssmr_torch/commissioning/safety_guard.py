"""A safety guard around a robot: at a limit of its card the input goes back to neutral and everything stops."""

from __future__ import annotations

from collections import deque
from contextlib import suppress

import numpy as np

from ssmr_torch.collection.excitation import neutral_input
from ssmr_torch.collection.recording_plans import described_plant
from ssmr_torch.commissioning.robot_card import RobotCard
from ssmr_torch.plants.base import Plant, PlantSheet, finite_vector
from ssmr_torch.trajectory import Trajectory

MOVED = 0.05  # of an input's range: after a larger change a measurement must change, too


class SafetyStop(RuntimeError):
    """A limit of the card was exceeded. The input is neutral again, and the guard makes no step until it is reset."""


class GuardedPlant(PlantSheet):
    """A plant that is checked at every sample, with narrower bounds.

    card: `fitted` to the plant.   share: of the way from the neutral input to the bounds, which inputs may use.
    noisy: True if two measurements are never exactly equal, so that equal ones mean a frozen sensor.
    bridged: True returns the last measurement for a missing one, for recordings; False returns NaN.

    The median of the last three samples is judged, so that a single wrong sample does not stop the robot. Samples that
    are missing, or repeat the last one, are left out. It stops for an output beyond displacement_limit; for one that
    moves faster than rate_limit; without a measurement for blind_limit s; and when a noisy sensor repeats its value for
    as long while an input moved. Then, and in `relax`, the input goes to neutral in `ramp` s. `reset` goes to rest and
    holds the neutral input for `settle` s. `step` and `reset` raise SafetyStop; the run so far is in `run`.
    """

    def __init__(self, plant: Plant, card: RobotCard, share: float = 1.0, noisy: bool = False, bridged: bool = False):
        if not 0 < share <= 1:
            raise ValueError(f"share is {share}; expected more than 0 and at most 1 of the way to the bounds")
        self.plant, self.card, self.share = plant, card, float(share)
        self.noisy, self.bridged = bool(noisy), bool(bridged)
        self.name, self.timestep, self.rest = plant.name, plant.timestep, plant.rest
        self.input_unit, self.output_names, self.input_names = plant.input_unit, plant.output_names, plant.input_names
        self.neutral_input = card.rest
        self.input_bounds = self.neutral_input + self.share * (card.range - self.neutral_input)
        self._applied = self.neutral_input
        self._begin(np.zeros(len(self.output_names)))

    def narrowed(self, share: float, bridged: bool = False) -> GuardedPlant:
        """A guard of the same plant in which inputs may use this share of the way to the bounds."""
        return GuardedPlant(self.plant, self.card, share, self.noisy, bridged)

    @property
    def parameters(self) -> dict:
        """What an observation depends on: the plant and the share. Bounds and neutral input are recorded separately."""
        return {"plant": described_plant(self.plant), "share": self.share, "settle": self.card.settle}

    @property
    def origin(self) -> dict:
        return getattr(self.plant, "origin", {})

    @property
    def state(self) -> np.ndarray:
        return self.plant.state

    @property
    def displacement(self) -> np.ndarray:
        return self.plant.displacement

    @property
    def stamp(self) -> float:
        """s by the robot's own clock at the last observation; NaN where the robot does not send it."""
        bare = getattr(self.plant, "plant", self.plant)  # a rig has no clock
        return getattr(bare, "stamp", np.nan)

    def reset(self, seed: int | None = None, state: np.ndarray | None = None) -> np.ndarray:
        """Go to rest and hold the neutral input; any state but None raises ValueError."""
        if state is not None:
            raise ValueError("a state was given, but a guarded robot cannot be put into a state; expected None, which "
                             "means rest")
        observation = np.array(self.plant.reset(seed), dtype=np.float64)
        self._applied = neutral_input(self.plant)
        self._begin(observation)
        self._judge(observation)
        if self.card.settle:
            for u in self._way_to_neutral(self.card.ramp + self.card.settle):
                observation = self._pass_on(u)
                self._judge(observation)
            self._begin(observation)
        if self.bridged and not np.isfinite(observation).all():
            while not np.isfinite(observation).all():
                observation = self._pass_on(self.neutral_input)
                self._judge(observation)
            self._begin(observation)
        return observation

    def step(self, input: np.ndarray) -> np.ndarray:
        """Hold the inputs (m,) for one timestep, clipped to the bounds, and check the new measurement."""
        if self.stopped:
            raise SafetyStop(f"{self.stopped} The robot was stopped; reset it before it moves again.")
        u = np.clip(finite_vector(input, len(self.input_names), "input"), *self.input_bounds)
        observation = self._pass_on(u)
        self._judge(observation)
        return self._last.copy() if self.bridged else observation

    def relax(self) -> None:
        """Go to the neutral input by a ramp. If the robot is gone, do nothing."""
        if (self._applied != self.neutral_input).any():
            with suppress(OSError, ValueError):
                for u in self._way_to_neutral(self.card.ramp):
                    self._pass_on(u)

    def run(self, name: str, **use) -> Trajectory | None:
        """The recording since the last reset, with missing samples held; None for fewer than two samples."""
        if len(self._observations) < 2:
            return None
        observation = np.array(self._observations)
        bad = ~np.isfinite(observation).all(axis=1)
        good = np.maximum.accumulate(np.where(bad, 0, np.arange(len(bad))))
        inputs = np.array([*self._inputs, self._applied])
        time = self.timestep * np.arange(len(bad))
        return Trajectory(time, np.nan_to_num(observation[good]), inputs, name=name, **use)

    def _begin(self, observation: np.ndarray) -> None:
        self.stopped = ""
        self._observations, self._inputs = [observation], []
        self._recent, self._middle = deque(maxlen=3), None  # (sample number, observation); the same for the last median
        self._last, self._input_then = np.full(len(self.output_names), np.nan), self._applied
        self._silent = 0

    def _pass_on(self, u: np.ndarray) -> np.ndarray:
        self._inputs.append(u)
        self._applied = u
        observation = np.array(self.plant.step(u), dtype=np.float64)
        self._observations.append(observation)
        return observation

    def _way_to_neutral(self, duration: float) -> list[np.ndarray]:
        """The inputs, for this many s, from the last one to the neutral one within the card's ramp."""
        start, ramp = self._applied, max(1, round(self.card.ramp / self.timestep))
        left = np.maximum(1.0 - np.arange(1, max(ramp, round(duration / self.timestep)) + 1) / ramp, 0.0)
        return [self.neutral_input + share * (start - self.neutral_input) for share in left]

    def _judge(self, observation: np.ndarray) -> None:
        reason = self._wrong(observation)
        if reason:
            seconds = self.timestep * (len(self._observations) - 1)
            self.relax()
            self.stopped = f"{reason} at {seconds:.3g} s; the input went back to {self.neutral_input.tolist()}."
            raise SafetyStop(self.stopped)

    def _wrong(self, observation: np.ndarray) -> str:
        """The limit that this sample exceeds, in words; empty where there is none."""
        card, names = self.card, self.output_names
        missing = not np.isfinite(observation).all()
        if missing or (observation == self._last).all():
            return self._without_news(missing)
        self._last, self._silent, self._input_then = observation, 0, self._applied
        self._recent.extend([(len(self._observations), observation)] * (1 if self._recent else 3))
        (_, a), (number, b), (_, c) = self._recent
        middle = np.maximum(np.minimum(a, b), np.minimum(np.maximum(a, b), c))  # the median, from the second sample on
        before, last = self._middle or (number, middle)
        rate = np.abs(middle - last) / (self.timestep * max(number - before, 1))
        self._middle = number, middle
        far, fast = int(np.argmax(np.abs(middle))), int(np.argmax(rate))
        if abs(middle[far]) > card.displacement_limit:
            return (f"{names[far]} is {1e3 * middle[far]:.3g} mm from rest, more than the displacement_limit of "
                    f"{1e3 * card.displacement_limit:.3g} mm,")
        if rate[fast] > card.rate_limit:
            return (f"{names[fast]} moves at {rate[fast]:.3g} m/s, more than the rate_limit of {card.rate_limit:.3g} "
                    "m/s,")
        return ""

    def _without_news(self, missing: bool) -> str:
        self._silent += 1
        seconds = self.timestep * self._silent
        if seconds <= self.card.blind_limit:
            return ""
        span = self.card.range[1] - self.card.range[0]
        if missing:
            return f"no measurement came for {seconds:.3g} s, more than the blind_limit of {self.card.blind_limit:g} s,"
        if self.noisy and (np.abs(self._applied - self._input_then) > MOVED * span).any():
            return f"the sensor repeats exactly the same values for {seconds:.3g} s while the input moves,"
        return ""
