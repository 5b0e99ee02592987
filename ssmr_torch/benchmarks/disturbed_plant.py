"""A plant with what changes between a recording and a run: between the command and the plant, and in what is seen."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ssmr_torch.periods import whole_multiple
from ssmr_torch.plants.base import Plant, PlantSheet, finite_vector

# Sets these random numbers apart from those that others draw with the same seed.
STREAM = 0x646973
OUTLIERS_APART = 1.0  # s


class Disturbed(PlantSheet):
    """u → gain, offset, play, delay, lag → plant → shift of the origin, outliers, gaps → y; each off by default.

    Per input, k the sample and h the timestep, from rest under the resting input u_0:

        g = u, but gain · u + offset · range of the first input,           clipped to the bounds,
        T_k = clip(T_{k−1}, g_k − play · range, g_k + play · range),
        x_k = share x_{k−1} + (1 − share) T_{k−d},      share = exp(−h / lag),   d = delay / h,

    and x acts on the plant, which may be on a `Rig` with an actuator and sensors of its own.

    delay: s, a multiple of h.   lag: s.   gain: 1, of the first input.   offset: of its range.   play: half of the
    width, of the range.   outlier: m; once a second every output is off by it, either way.   missing: in [0, 1), the
    probability of a sample of NaN.   rest: (p,) m, origin of what is seen, that of the plant before it was changed by a
    payload; None: the plant's.
    state: the plant's, then sample number, T, x, T of the last d samples (oldest first).
    Raises ValueError for numbers that make no sense.
    """

    def __init__(self, plant: Plant, *, delay: float = 0.0, lag: float = 0.0, gain: float = 1.0, offset: float = 0.0,
                 play: float = 0.0, outlier: float = 0.0, missing: float = 0.0, rest=None):
        for name, value in (("delay", delay), ("lag", lag), ("gain", gain), ("play", play), ("outlier", outlier)):
            if not (np.isfinite(value) and value >= 0):
                raise ValueError(f"{name} is {value}; expected a finite number, zero or more")
        if not (0 <= missing < 1 and np.isfinite(offset)):
            raise ValueError(f"missing is {missing} and offset {offset}; expected a share below 1 and a finite number")
        self.plant, self.name = plant, f"{plant.name}, disturbed"
        self.timestep, self.input_bounds, self.input_unit = plant.timestep, plant.input_bounds, plant.input_unit
        self.output_names, self.input_names = plant.output_names, plant.input_names
        self.rest = np.array(plant.rest if rest is None else finite_vector(rest, len(plant.rest), "rest"))
        self._moved = np.asarray(plant.rest) - self.rest
        self.parameters = {"plant": {"class": type(plant).__qualname__, "parameters": getattr(plant, "parameters", {})},
                           "delay": delay, "lag": lag, "gain": gain, "offset": offset, "play": play,
                           "outlier": outlier, "missing": missing, "rest": self.rest.tolist()}
        self._delay = whole_multiple("delay", delay, "the timestep", plant.timestep) if delay else 0
        self._share = float(np.exp(-plant.timestep / lag)) if lag else 0.0
        span = np.ptp(plant.input_bounds, axis=0)
        self._half, first = play * span, np.arange(len(span)) == 0
        self._factor, self._shift = np.where(first, gain, 1.0), np.where(first, offset * span, 0.0)
        self._every = max(1, round(OUTLIERS_APART / plant.timestep))
        self._memory, self._seed = self._resting(), 0

    @property
    def origin(self) -> dict:
        """What the plant was made from, where it says so."""
        return getattr(self.plant, "origin", {})

    @property
    def neutral_input(self) -> np.ndarray:
        """(m,), under which the plant is left alone."""
        own = getattr(self.plant, "neutral_input", None)
        return np.clip(0.0, *self.input_bounds) if own is None else own

    @property
    def displacement(self) -> np.ndarray:
        return self.plant.displacement + self._moved

    @property
    def state(self) -> np.ndarray:
        memory = self._memory
        return np.concatenate([self.plant.state, [memory.sample], memory.transmitted, memory.lagged, *memory.queue])

    def reset(self, seed: int | None = None, state: np.ndarray | None = None) -> np.ndarray:
        """Go to `state` (default: rest); the first sample always arrives, without an outlier."""
        self._seed = 0 if seed is None else seed
        if state is None:
            self._memory, observation = self._resting(), self.plant.reset(seed)
        else:
            m = len(self.input_names)
            state = np.asarray(state, dtype=np.float64)
            own, sample, transmitted, lagged, queue = np.split(state, np.cumsum(
                [state.size - 1 - (2 + self._delay) * m, 1, m, m]))
            self._memory = _Memory(int(sample[0]), transmitted, lagged, tuple(queue.reshape(self._delay, m)))
            observation = self.plant.reset(seed, own)
        return self._seen(observation)

    def step(self, input: np.ndarray) -> np.ndarray:
        """Command the inputs (m,) for one timestep, clipped to the bounds; a misfit raises ValueError."""
        memory, bounds = self._memory, self.input_bounds
        command = np.clip(finite_vector(input, len(self.input_names), "input"), *bounds)
        changed = np.clip(self._factor * command + self._shift, *bounds)
        transmitted = np.clip(memory.transmitted, changed - self._half, changed + self._half)
        acting, *queue = *memory.queue, transmitted
        lagged = acting + self._share * (memory.lagged - acting)
        observation = self.plant.step(lagged)
        self._memory = _Memory(memory.sample + 1, transmitted, lagged, tuple(queue))
        return self._seen(observation)

    def _resting(self) -> _Memory:
        resting = np.clip(self._factor * self.neutral_input + self._shift, *self.input_bounds)
        return _Memory(0, resting, resting, (resting,) * self._delay)

    def _seen(self, observation: np.ndarray) -> np.ndarray:
        observation, sample = np.array(observation, dtype=np.float64) + self._moved, self._memory.sample
        if not sample:
            return observation
        draw = np.random.default_rng([STREAM, self._seed, sample])
        lost, signs = draw.random() < self.parameters["missing"], draw.choice([-1.0, 1.0], size=len(observation))
        if sample % self._every == self._every // 2:
            observation += self.parameters["outlier"] * signs
        return np.full_like(observation, np.nan) if lost else observation


class _Memory(NamedTuple):
    """What is carried from sample to sample."""

    sample: int
    transmitted: np.ndarray
    lagged: np.ndarray
    queue: tuple[np.ndarray, ...]
