"""What a real rig adds to an ideal plant: slow, limited, rubbing actuators and a late, lossy, noisy measurement."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ssmr_torch.keywords import configurable
from ssmr_torch.periods import whole_multiple
from ssmr_torch.plants.base import Plant, PlantSheet, finite_vector

DROPPED = ("held", "missing")
# Sets the rig's random numbers apart from those that others draw with the same seed.
STREAM = 0x726967


class Rig(PlantSheet):
    """A plant with the actuators and sensors of a bench, each part off by default: u → actuators → plant → sensors → y.

    Actuators, per input, h the timestep, from the forces a, x, T of the step before:

        v  = clip(u, input_bounds), at most saturation,
        a⁺ = clip(v, a - rate_limit h, a + rate_limit h),
        x⁺ = a⁺ - (a⁺ - x) exp(-h / actuator_lag),                            exact at the samples, as a⁺ is held
        T⁺ = clip(T, x⁺ exp(-cable_friction), x⁺ exp(cable_friction)),        held during the step.

    Friction is the capstan equation: a cable that wraps the angle θ with friction μ slips only where the tensions
    at its ends differ by the factor exp(μθ), and else keeps what it transmits (Kaneko et al., "A new consideration
    on tendon-tension control system of robot hands", ICRA 1991). This is a hysteresis that no slower motion avoids.

    Sensors, at sample k after reset, which is sample 0:

        y_k = observation of sample k - sensor_delay / h + white noise, or, with drop_probability, what `dropped` says.

    Before reset the robot rested where reset puts it. Sample 0 always arrives. Noise belongs to what newly arrives.

    noise_std: of every observed value, m.   sensor_delay: s, a multiple of h.   drop_probability: in [0, 1).
    dropped: "held" repeats the last sample that arrived to the last digit, "missing" gives NaN.
    actuator_lag: time constant, s.   cable_friction: μθ, 1; for inputs that only pull.
    outputs: names of what the sensors see, in this order; None for all that the plant offers.
    rate_limit: input unit per s.   saturation: highest force reached, either way, input unit, within the bounds.
    Both are one number or (m,), None for no limit.
    state: the plant's, then sample number, a, x, T, observations on their way (oldest first), last sample that
    arrived, whether the newest was dropped.
    All random numbers follow from the seed given to `reset` (None is 0) and the number of the sample.
    Raises ValueError for settings out of these ranges, and for a plant that is on a rig already.
    """

    def __init__(self, plant: Plant, *, noise_std: float = 0.0, sensor_delay: float = 0.0,
                 drop_probability: float = 0.0, dropped: str = "held", actuator_lag: float = 0.0, rate_limit=None,
                 saturation=None, cable_friction: float = 0.0, outputs=None):
        if isinstance(plant, Rig):
            raise ValueError(f"the plant is {plant.name!r} already; expected one without, as both would draw the same "
                             "random numbers: give all settings to one rig")
        if dropped not in DROPPED:
            raise ValueError(f"dropped is {dropped!r}; expected one of {DROPPED}")
        self.plant, self.name = plant, f"{plant.name} on a rig"
        self.timestep, self.input_bounds, self.input_unit = plant.timestep, plant.input_bounds, plant.input_unit
        self._columns = _columns(outputs, plant)
        self.output_names = tuple(plant.output_names[column] for column in self._columns)
        self.input_names, self.rest = plant.input_names, plant.rest[self._columns]
        self.noise_std = _non_negative("noise_std", noise_std, "m")
        self.sensor_delay = _non_negative("sensor_delay", sensor_delay, "s")
        self.drop_probability = _probability(drop_probability)
        self.dropped = dropped
        self.actuator_lag = _non_negative("actuator_lag", actuator_lag, "s")
        self.rate_limit = _limit("rate_limit", rate_limit, plant, f"{plant.input_unit}/s")
        self.saturation = _saturation(saturation, plant)
        self.cable_friction = _friction(cable_friction, plant)
        self._delay = _samples(self.sensor_delay, plant.timestep)
        ceiling = np.inf if self.saturation is None else self.saturation
        self._lowest, self._highest = np.clip(plant.input_bounds, np.negative(ceiling), ceiling)
        self._stride = np.inf if self.rate_limit is None else self.timestep * self.rate_limit
        self._share_left = np.exp(-self.timestep / self.actuator_lag) if self.actuator_lag else 0.0
        self._slip = np.exp(self.cable_friction)
        self._key = _key(0)
        self._memory = self._start(self.displacement, self._key)

    @property
    def parameters(self) -> dict:
        """The constructor's arguments, as plain values; of the plant its class and its own parameters."""
        kind = type(self.plant)
        return {"plant": {"class": f"{kind.__module__}.{kind.__qualname__}",
                          "parameters": getattr(self.plant, "parameters", {})},
                "noise_std": self.noise_std, "sensor_delay": self.sensor_delay,
                "drop_probability": self.drop_probability, "dropped": self.dropped,
                "actuator_lag": self.actuator_lag, "rate_limit": _plain(self.rate_limit),
                "saturation": _plain(self.saturation), "cable_friction": self.cable_friction,
                "outputs": None if self.output_names == tuple(self.plant.output_names) else list(self.output_names)}

    @property
    def origin(self) -> dict:
        """What the plant was made from, beyond its parameters, where it says so."""
        return getattr(self.plant, "origin", {})

    @property
    def displacement(self) -> np.ndarray:
        return self.plant.displacement[self._columns]

    @property
    def applied(self) -> np.ndarray:
        """(m,), the forces that reached the plant in the last step; after a reset those it rests under."""
        return self._memory.transmitted.copy()

    @property
    def state(self) -> np.ndarray:
        memory = self._memory
        return np.concatenate([self.plant.state, [memory.sample], memory.limited, memory.lagged, memory.transmitted,
                               *memory.queue, memory.arrived, [memory.lost]])

    def reset(self, seed: int | None = None, state: np.ndarray | None = None) -> np.ndarray:
        """Go to `state`, and return again what was returned there, or to rest with a first measurement of it."""
        seed = 0 if seed is None else seed
        key = _key(seed)
        if state is None:
            memory = self._start(self.plant.reset(seed)[self._columns], key)
        else:
            plant_state, memory = self._read(state)
            self.plant.reset(seed, plant_state)
        self._key, self._memory = key, memory
        return self._sample()

    def step(self, input: np.ndarray) -> np.ndarray:
        """Command the inputs (m,) for one timestep, clipped to the bounds; a misfit raises ValueError."""
        memory = self._memory
        u = finite_vector(input, len(self.input_names), "input")
        limited, lagged, transmitted = self._actuate(np.minimum(np.maximum(u, self._lowest), self._highest))
        observation = np.array(self.plant.step(transmitted), dtype=np.float64)[self._columns]
        newest, *queue = *memory.queue, observation
        lost, noise = self._draw(self._key, memory.sample + 1)
        self._memory = _Memory(memory.sample + 1, limited, lagged, transmitted, tuple(queue),
                               memory.arrived if lost else newest + noise, lost)
        return self._sample()

    def _actuate(self, force: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        last = self._memory
        limited = np.minimum(np.maximum(force, last.limited - self._stride), last.limited + self._stride)
        lagged = limited - (limited - last.lagged) * self._share_left
        transmitted = np.minimum(np.maximum(last.transmitted, lagged / self._slip), lagged * self._slip)
        return limited, lagged, transmitted

    def _draw(self, key: np.ndarray, sample: int) -> tuple[bool, np.ndarray | float]:
        """Whether a sample is lost, and its noise (p,), m."""
        if not (self.noise_std or self.drop_probability):
            return False, 0.0
        rng = np.random.Generator(np.random.Philox(key=key, counter=[0, sample, 0, 0]))
        # Both are drawn whatever the settings: neither changes the other's numbers.
        lost, noise = rng.random() < self.drop_probability, rng.standard_normal(len(self.output_names))
        return lost, self.noise_std * noise

    def _start(self, observation: np.ndarray, key: np.ndarray) -> _Memory:
        observation = np.array(observation, dtype=np.float64)
        force = np.clip(0.0, self._lowest, self._highest)
        return _Memory(0, force, force, force, (observation,) * self._delay, observation + self._draw(key, 0)[1], False)

    def _sample(self) -> np.ndarray:
        if self._memory.lost and self.dropped == "missing":
            return np.full(len(self.output_names), np.nan)
        return self._memory.arrived.copy()

    def _read(self, state: np.ndarray) -> tuple[np.ndarray, _Memory]:
        """The plant's state and the memory in a flat state."""
        m, p = len(self.input_names), len(self.output_names)
        ends = np.cumsum([self.plant.state.size, 1, m, m, m, self._delay * p, p, 1])
        vector = finite_vector(state, ends[-1], "state")
        plant_state, sample, limited, lagged, transmitted, queue, arrived, lost = np.split(vector, ends[:-1])
        if sample[0] < 0 or sample[0] % 1 or lost[0] not in (0, 1):
            raise ValueError(f"state has the sample number {sample[0]} and the mark {lost[0]} for a dropped sample; "
                             "expected a whole number of 0 or more and 0 or 1: give a state that this rig returned")
        return plant_state, _Memory(int(sample[0]), limited, lagged, transmitted,
                                    tuple(queue.reshape(self._delay, p)), arrived, bool(lost[0]))


class _Memory(NamedTuple):
    """What a rig carries from sample to sample."""

    sample: int
    limited: np.ndarray
    lagged: np.ndarray
    transmitted: np.ndarray
    queue: tuple[np.ndarray, ...]
    arrived: np.ndarray
    lost: bool


@configurable(Rig)
def rig(plant: Plant, **settings) -> Plant:
    """The plant on a Rig with these settings, or the plant itself where they leave every part off."""
    built = Rig(plant, **settings)
    off = Rig(plant, dropped=built.dropped)
    return plant if built.parameters == off.parameters else built


def _columns(outputs, plant: Plant) -> list[int]:
    names = list(plant.output_names)
    outputs = names if outputs is None else list(outputs)
    if not outputs or len(set(outputs)) < len(outputs) or not set(outputs) <= set(names):
        raise ValueError(f"outputs are {outputs}; expected some of {names}, each once")
    return [names.index(output) for output in outputs]


def _key(seed: int) -> np.ndarray:
    return np.random.SeedSequence(seed, spawn_key=(STREAM,)).generate_state(2, np.uint64)


def _plain(limit: np.ndarray | None) -> list | None:
    return None if limit is None else limit.tolist()


def _non_negative(name: str, value: float, unit: str) -> float:
    if not 0 <= value < np.inf:
        raise ValueError(f"{name} is {value} {unit}; expected a finite number of 0 or more")
    return float(value)


def _probability(value: float) -> float:
    if not 0 <= value < 1:
        raise ValueError(f"drop_probability is {value}; expected 0 or more and less than 1")
    return float(value)


def _samples(delay: float, timestep: float) -> int:
    return whole_multiple("sensor_delay", delay, "the plant's timestep", timestep) if delay else 0


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
    friction = _non_negative("cable_friction", value, "(μθ)")
    if friction and (plant.input_bounds[0] < 0).any():
        raise ValueError(f"cable_friction is {friction} and the lowest inputs are {plant.input_bounds[0].tolist()} "
                         f"{plant.input_unit}; expected 0 or more, as cables only pull: leave friction off")
    return friction
