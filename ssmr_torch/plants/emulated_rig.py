"""An emulated rig: a plant with slow and limited actuators, cable friction, sensor delay, lost samples and noise."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ssmr_torch.checked_arguments import checked
from ssmr_torch.keywords import configurable
from ssmr_torch.periods import whole_multiple
from ssmr_torch.plants.base import Plant, PlantSheet, finite_vector
from ssmr_torch.plants.emulated_friction_and_lag import EmulatedActuators, Forces
from ssmr_torch.quantities import LENGTH, LIMIT, TEXT
from ssmr_torch.ranges import Each, Number, OneOf, OrNone
from ssmr_torch.settings import non_negative

DROPPED = ("held", "missing")
# Keeps the rig's random numbers different from other random numbers with the same seed.
STREAM = 0x726967


class Rig(PlantSheet):
    """A plant with actuators and sensors, each part off by default: u → actuators → plant → sensors → y.

    Actuators: see `EmulatedActuators`, which gives the forces T that act on the plant.

    Sensors, at sample k after reset, which is sample 0:

        y_k = observation of sample k - sensor_delay / h + white noise, or, with drop_probability, what `dropped` says.

    Before the reset the robot was at the state of the reset. Sample 0 always arrives. A repeated sample has no new
    noise.

    noise_std: m, of every observed value.   sensor_delay: s, a multiple of h.   drop_probability: in [0, 1).
    dropped: "held" repeats the last sample that arrived exactly, "missing" gives NaN.
    actuator_lag: s, time constant.   cable_friction: μθ, 1; only for inputs that pull.
    outputs: names of the outputs that the sensors measure, in this order; None: all outputs of the plant.
    rate_limit: input unit per s.   saturation: largest force, of either sign, input unit, within the bounds. Both are
    one number or (m,); None: no limit.
    state: the plant's state, then sample number, a, x, T, delayed observations (oldest first), the last sample that
    arrived, and whether the newest sample was dropped.
    All random numbers follow from the seed given to `reset` (None is 0) and the number of the sample.
    Raises ValueError for settings out of these ranges, and for a plant that is already on a rig.
    """

    @checked(noise_std=LENGTH, sensor_delay=Number(0.0, 10.0, "s"), drop_probability=Number(0.0, 0.999),
             dropped=OneOf(*DROPPED), actuator_lag=Number(0.0, 100.0, "s"), rate_limit=LIMIT, saturation=LIMIT,
             cable_friction=Number(0.0, 100.0), outputs=OrNone(Each(TEXT, 0)))
    def __init__(self, plant: Plant, *, noise_std: float = 0.0, sensor_delay: float = 0.0,
                 drop_probability: float = 0.0, dropped: str = "held", actuator_lag: float = 0.0, rate_limit=None,
                 saturation=None, cable_friction: float = 0.0, outputs=None):
        if isinstance(plant, Rig):
            raise ValueError(f"the plant is already {plant.name!r}; expected a plant without a rig, because two rigs "
                             "would draw the same random numbers: give all settings to one rig")
        if dropped not in DROPPED:
            raise ValueError(f"dropped is {dropped!r}; expected one of {DROPPED}")
        self.plant, self.name = plant, f"{plant.name} on a rig"
        self.timestep, self.input_bounds, self.input_unit = plant.timestep, plant.input_bounds, plant.input_unit
        self._columns = _columns(outputs, plant)
        self.output_names = tuple(plant.output_names[column] for column in self._columns)
        self.input_names, self.rest = plant.input_names, plant.rest[self._columns]
        self.noise_std = non_negative("noise_std", noise_std, "m")
        self.sensor_delay = non_negative("sensor_delay", sensor_delay, "s")
        self.drop_probability = _probability(drop_probability)
        self.dropped = dropped
        self.actuators = EmulatedActuators(plant, lag=actuator_lag, rate_limit=rate_limit, saturation=saturation,
                                           cable_friction=cable_friction)
        self._delay = _samples(self.sensor_delay, plant.timestep)
        self._key = _key(0)
        self._memory = self._start(self.displacement, self._key)

    @property
    def parameters(self) -> dict:
        """The constructor's arguments as plain values; for the plant its class and its own parameters."""
        kind = type(self.plant)
        return {"plant": {"class": f"{kind.__module__}.{kind.__qualname__}",
                          "parameters": getattr(self.plant, "parameters", {})},
                "noise_std": self.noise_std, "sensor_delay": self.sensor_delay,
                "drop_probability": self.drop_probability, "dropped": self.dropped,
                **self.actuators.parameters,
                "outputs": None if self.output_names == tuple(self.plant.output_names) else list(self.output_names)}

    @property
    def origin(self) -> dict:
        """What else the plant was made from, beyond its parameters, if the plant tells it."""
        return getattr(self.plant, "origin", {})

    @property
    def displacement(self) -> np.ndarray:
        return self.plant.displacement[self._columns]

    @property
    def applied(self) -> np.ndarray:
        """(m,), the forces on the plant in the last step; after a reset the forces at rest."""
        return self._memory.forces.transmitted.copy()

    @property
    def state(self) -> np.ndarray:
        memory = self._memory
        return np.concatenate([self.plant.state, [memory.sample], *memory.forces,
                               *memory.queue, memory.arrived, [memory.lost]])

    def reset(self, seed: int | None = None, state: np.ndarray | None = None) -> np.ndarray:
        """Go to `state` and return the same observation as there; without `state` go to rest and measure."""
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
        """Apply the command (m,) for one timestep, clipped to the bounds. Raises ValueError for a wrong size."""
        memory = self._memory
        u = finite_vector(input, len(self.input_names), "input")
        forces = self.actuators.step(memory.forces, u)
        observation = np.array(self.plant.step(forces.transmitted), dtype=np.float64)[self._columns]
        newest, *queue = *memory.queue, observation
        lost, noise = self._draw(self._key, memory.sample + 1)
        arrived = memory.arrived if lost else newest + noise
        self._memory = _Memory(memory.sample + 1, forces, tuple(queue), arrived, lost)
        return self._sample()

    def _draw(self, key: np.ndarray, sample: int) -> tuple[bool, np.ndarray | float]:
        """Whether the sample is lost, and its noise (p,), m."""
        if not (self.noise_std or self.drop_probability):
            return False, 0.0
        rng = np.random.Generator(np.random.Philox(key=key, counter=[0, sample, 0, 0]))
        # Both are always drawn, so that no setting changes the other's random numbers.
        lost, noise = rng.random() < self.drop_probability, rng.standard_normal(len(self.output_names))
        return lost, self.noise_std * noise

    def _start(self, observation: np.ndarray, key: np.ndarray) -> _Memory:
        observation = np.array(observation, dtype=np.float64)
        queue, noise = (observation,) * self._delay, self._draw(key, 0)[1]
        return _Memory(0, self.actuators.at_rest, queue, observation + noise, False)

    def _sample(self) -> np.ndarray:
        if self._memory.lost and self.dropped == "missing":
            return np.full(len(self.output_names), np.nan)
        return self._memory.arrived.copy()

    def _read(self, state: np.ndarray) -> tuple[np.ndarray, _Memory]:
        """The plant's state and the rig's memory, from a flat state."""
        m, p = len(self.input_names), len(self.output_names)
        ends = np.cumsum([self.plant.state.size, 1, m, m, m, self._delay * p, p, 1])
        vector = finite_vector(state, ends[-1], "state")
        plant_state, sample, *forces, queue, arrived, lost = np.split(vector, ends[:-1])
        if sample[0] < 0 or sample[0] % 1 or lost[0] not in (0, 1):
            raise ValueError(f"state has the sample number {sample[0]} and the mark {lost[0]} for a dropped sample; "
                             "expected a whole number of 0 or more and 0 or 1: give a state that this rig returned")
        return plant_state, _Memory(int(sample[0]), Forces(*forces), tuple(queue.reshape(self._delay, p)), arrived,
                                    bool(lost[0]))


class _Memory(NamedTuple):
    """The values that a rig keeps from sample to sample."""

    sample: int
    forces: Forces
    queue: tuple[np.ndarray, ...]
    arrived: np.ndarray
    lost: bool


@configurable(Rig)
def rig(plant: Plant, **settings) -> Plant:
    """The plant on a Rig with these settings; the plant itself where the settings leave every part off."""
    built = Rig(plant, **settings)
    off = Rig(plant, dropped=built.dropped)
    return plant if built.parameters == off.parameters else built


def _columns(outputs, plant: Plant) -> list[int]:
    names = list(plant.output_names)
    outputs = names if outputs is None else list(outputs)
    if not outputs or len(set(outputs)) < len(outputs) or not set(outputs) <= set(names):
        raise ValueError(f"outputs are {outputs}; expected some of {names}, each only once")
    return [names.index(output) for output in outputs]


def _key(seed: int) -> np.ndarray:
    return np.random.SeedSequence(seed, spawn_key=(STREAM,)).generate_state(2, np.uint64)


def _probability(value: float) -> float:
    if not 0 <= value < 1:
        raise ValueError(f"drop_probability is {value}; expected 0 or more and less than 1")
    return float(value)


def _samples(delay: float, timestep: float) -> int:
    return whole_multiple("sensor_delay", delay, "the plant's timestep", timestep) if delay else 0
