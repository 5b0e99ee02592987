"""Recording trajectories from a plant: decays to rest and controlled runs."""

from __future__ import annotations

import zlib
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, is_dataclass

import numpy as np
from tqdm import tqdm

from ssmr_torch.data.excitation import Excitation, RandomOnOffRamp, Release
from ssmr_torch.plants.base import Plant
from ssmr_torch.trajectory import KINDS, SPLITS, Trajectory, TrajectoryDataset

DEFAULT_RELEASE = RandomOnOffRamp()


@dataclass(frozen=True)
class ControlledRun:
    """`repeats` runs of `duration` s from rest under one excitation, each with its own random numbers.

    kind: "controlled", or "static" for set points that are held until the robot rests.
    """

    name: str
    excitation: Excitation
    duration: float
    split: str = "train"
    repeats: int = 1
    kind: str = "controlled"

    def __post_init__(self):
        if self.repeats < 1:
            raise ValueError(f"{self.name}: {self.repeats} repeats; expected 1 or more, or leave the run out")

    def plans(self, noise_std: float = 0.0) -> list[RecordingPlan]:
        return [RecordingPlan(f"{self.name}-{repeat}", self.kind, self.split, self.excitation, self.duration,
                              noise_std=noise_std) for repeat in range(self.repeats)]


@dataclass(frozen=True)
class RecordingPlan:
    """One trajectory, before it is recorded: `duration` s from `start` s after the plant left its rest.

    noise_std: standard deviation of the white measurement noise on every observation, m.
    """

    name: str
    kind: str
    split: str
    excitation: Excitation
    duration: float
    start: float = 0.0
    noise_std: float = 0.0

    def __post_init__(self):
        if not (0 < self.duration < np.inf and 0 <= self.start < np.inf):
            raise ValueError(f"{self.name}: duration {self.duration} s and start {self.start} s; "
                             "expected a positive duration and a start of 0 or more")
        if not 0 <= self.noise_std < np.inf:
            raise ValueError(f"{self.name}: noise_std is {self.noise_std} m; expected 0 or more")
        if self.kind not in KINDS or self.split not in SPLITS:
            raise ValueError(f"{self.name}: kind {self.kind!r} and split {self.split!r}; "
                             f"expected one of {KINDS} and one of {SPLITS}")


def record(plant: Plant, plan: RecordingPlan, seed: int) -> Trajectory:
    """Run the plant from rest as planned; the result depends on plant, plan and seed, not on what ran before.

    Raises ValueError when a decay's excitation has not let go at its start.
    """
    drawing, plant_seed, disturbing = np.random.SeedSequence([seed, zlib.crc32(plan.name.encode())]).spawn(3)
    start, length = round(plan.start / plant.timestep), round(plan.duration / plant.timestep)
    rng = np.random.default_rng(drawing)
    inputs = plan.excitation(rng, start + length, plant.timestep, plant.input_bounds)
    if plan.kind == "decay" and (inputs[start:] != plant.input_bounds[0]).any():
        raise ValueError(f"{plan.name}: the inputs reach {inputs[start:].max():g} {plant.input_unit} after "
                         f"the decay starts at {plan.start} s; expected the lowest input from there on")
    observation = np.empty((start + length, len(plant.output_names)))
    observation[0] = plant.reset(seed=int(plant_seed.generate_state(1)[0]))
    for k in range(start + length - 1):
        observation[k + 1] = plant.step(inputs[k])
    noise = np.random.default_rng(disturbing).normal(0.0, plan.noise_std, (length, observation.shape[1]))
    return Trajectory(plant.timestep * np.arange(length), observation[start:] + noise, inputs[start:],
                      plan.kind, plan.split, plan.name)


def collect(plant: Plant, *, decays: int | Sequence[Release] = 40, validation_decays: int = 4,
            test_decays: int = 4, decay_duration: float = 5.0, release: Release = DEFAULT_RELEASE,
            controlled: Sequence[ControlledRun] = (), noise_std: float = 0.0, seed: int = 0,
            progress: bool = True) -> TrajectoryDataset:
    """Record decays and controlled runs, each from rest.

    A decay starts when its excitation lets go and lasts `decay_duration` s with the lowest input. decays: how
    many for training, all excited by `release`, or one excitation each; validation and test use `release`.
    noise_std: white measurement noise, m. The same seed gives the same data; a trajectory's random numbers
    follow from the seed and its name, not from the other trajectories.
    Raises ValueError, before anything is recorded, when a plan is impossible or two runs share a name.
    """
    training = [release] * _count("decays", decays) if isinstance(decays, int) else list(decays)
    by_split = {"train": training,
                "validation": [release] * _count("validation_decays", validation_decays),
                "test": [release] * _count("test_decays", test_decays)}
    plans = [plan for split, excitations in by_split.items()
             for plan in _decay_plans(split, excitations, decay_duration, noise_std)]
    plans += [plan for run in controlled for plan in run.plans(noise_std)]
    _check_names(plans)
    trajectories = [record(plant, plan, seed)
                    for plan in tqdm(plans, desc="collect", unit="run", disable=not progress)]
    return TrajectoryDataset(trajectories, plant.rest, plant.output_names, plant.input_names,
                             plant.input_unit, _provenance(plant, plans, seed))


def _decay_plans(split: str, excitations: Sequence[Release], duration: float,
                 noise_std: float) -> list[RecordingPlan]:
    for excitation in excitations:
        if not isinstance(excitation, Release):
            raise ValueError(f"{type(excitation).__name__} never lets go, so no decay follows it; "
                             "use Ramp, RandomOnOffRamp or latin_hypercube_ramps")
    return [RecordingPlan(f"decay-{split}-{index:03d}", "decay", split, excitation, duration,
                          excitation.hold, noise_std)
            for index, excitation in enumerate(excitations)]


def _count(name: str, value: int) -> int:
    if value < 0:
        raise ValueError(f"{name} is {value}; expected 0 or more")
    return value


def _check_names(plans: Sequence[RecordingPlan]) -> None:
    repeated = sorted(name for name, count in Counter(plan.name for plan in plans).items() if count > 1)
    if repeated:
        raise ValueError(f"{len(repeated)} names belong to more than one trajectory, the first is "
                         f"{repeated[0]!r}; a name seeds its trajectory, so give each controlled run its own")


def _provenance(plant: Plant, plans: Sequence[RecordingPlan], seed: int) -> dict:
    plant_class = type(plant)
    return {"source": "simulation", "seed": seed,
            "plant": {"class": f"{plant_class.__module__}.{plant_class.__qualname__}",
                      "timestep": plant.timestep, "input_bounds": plant.input_bounds.tolist(),
                      "parameters": getattr(plant, "parameters", {})},
            "plans": [{"name": plan.name, "start": plan.start, "duration": plan.duration,
                       "noise_std": plan.noise_std, "excitation": _described(plan.excitation)}
                      for plan in plans]}


def _described(excitation: Excitation) -> dict:
    settings = asdict(excitation) if is_dataclass(excitation) else {}
    return {"class": type(excitation).__qualname__,
            **{key: np.asarray(value).tolist() for key, value in settings.items()}}
