"""What is to be recorded: the plan of one trajectory, its input signal, and what the result depends on."""

from __future__ import annotations

import hashlib
import zlib
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, is_dataclass

import numpy as np

from ssmr_torch.checked_arguments import checked
from ssmr_torch.collection import excitation as signals
from ssmr_torch.collection.excitation import Excitation, Release, neutral_input
from ssmr_torch.plants.base import Plant
from ssmr_torch.quantities import DURATION, TEXT
from ssmr_torch.ranges import OneOf, OrNone, Whole
from ssmr_torch.trajectory import KINDS, SPLITS


@checked(name=TEXT, duration=OrNone(DURATION), split=OneOf(*SPLITS), repeats=Whole(1, 10_000),
         kind=OneOf("controlled", "static"))
@dataclass(frozen=True)
class ControlledRun:
    """`repeats` runs of `duration` s from rest under one excitation, each with its own random numbers.

    duration: by default that of the excitation, which `SetPoints` have.
    kind: "controlled", or "static" for set points that are held until the robot rests.
    """

    name: str
    excitation: Excitation
    duration: float | None = None
    split: str = "train"
    repeats: int = 1
    kind: str = "controlled"

    def __post_init__(self):
        if self.repeats < 1:
            raise ValueError(f"{self.name}: {self.repeats} repeats; expected 1 or more, or leave the run out")
        if self.duration is None and not hasattr(self.excitation, "duration"):
            raise ValueError(f"{self.name}: {type(self.excitation).__name__} has no end of its own; "
                             "give the run a duration in s")

    def plans(self, noise_std: float = 0.0) -> list[RecordingPlan]:
        duration = self.excitation.duration if self.duration is None else self.duration
        return [RecordingPlan(f"{self.name}-{repeat}", self.kind, self.split, self.excitation, duration,
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

    def first_sample(self, timestep: float) -> int:
        return round(self.start / timestep)

    def samples(self, timestep: float) -> int:
        """How many samples the plant runs through, those before `start` included."""
        return self.first_sample(timestep) + round(self.duration / timestep)

    def seeds(self, seed: int) -> list[np.random.SeedSequence]:
        """Of the signal, the plant and the noise; they follow from `seed` and the name alone."""
        return np.random.SeedSequence([seed, zlib.crc32(self.name.encode())]).spawn(3)

    def signal(self, plant: Plant, seed: int) -> np.ndarray:
        """The inputs (samples, m) from rest on.

        Raises ValueError when fewer than two samples are planned, the excitation does not fit the plant, or that of
        a decay has not let go at its start.
        """
        first, samples = self.first_sample(plant.timestep), self.samples(plant.timestep)
        if samples - first < 2:
            raise ValueError(f"{self.name}: {self.duration} s hold {samples - first} samples of {plant.timestep} s; "
                             "expected at least 2")
        with naming(self):
            rest, bounds = neutral_input(plant), plant.input_bounds
            centre = rest if getattr(plant, "neutral_input", None) is not None else np.zeros_like(rest)
            inputs = self.excitation(np.random.default_rng(self.seeds(seed)[0]), samples, plant.timestep,
                                     bounds - centre)
            inputs = np.clip(inputs + centre, *bounds) if centre.any() else inputs
        away = np.abs(inputs[first:] - rest).max() if self.kind == "decay" else 0.0
        if away > 0:
            raise ValueError(f"{self.name}: the inputs are up to {away:g} {plant.input_unit} away from rest after "
                             f"the decay starts at {self.start} s; expected the resting input from there on, "
                             f"{rest.tolist()}")
        return inputs


@contextmanager
def naming(plan: RecordingPlan) -> Iterator[None]:
    """Errors inside say which trajectory they belong to."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{plan.name}: {error}") from error
    except Exception as error:
        error.add_note(f"while recording {plan.name}")
        raise


def decay_plans(split: str, excitations: Sequence[Release], duration: float, noise_std: float) -> list[RecordingPlan]:
    """A decay after each excitation. Raises ValueError for one that never lets go."""
    for excitation in excitations:
        if not isinstance(excitation, Release):
            raise ValueError(f"{type(excitation).__name__} never lets go, so no decay follows it; "
                             "use Ramp, RandomOnOffRamp or latin_hypercube_ramps")
    return [RecordingPlan(f"decay-{split}-{index:03d}", "decay", split, excitation, duration,
                          excitation.hold, noise_std)
            for index, excitation in enumerate(excitations)]


def refuse_repeated_names(plans: Sequence[RecordingPlan]) -> None:
    repeated = sorted(name for name, count in Counter(plan.name for plan in plans).items() if count > 1)
    if repeated:
        raise ValueError(f"{len(repeated)} names belong to more than one trajectory, the first is "
                         f"{repeated[0]!r}; a name seeds its trajectory, so give each controlled run its own")


def described_plant(plant: Plant) -> dict:
    """What an observation depends on beside the inputs."""
    own = {} if getattr(plant, "neutral_input", None) is None else {"neutral_input": neutral_input(plant).tolist()}
    return own | {
        "class": _path(plant), "timestep": plant.timestep, "input_bounds": np.asarray(plant.input_bounds).tolist(),
        "output_names": list(plant.output_names), "input_names": list(plant.input_names),
        "rest": np.asarray(plant.rest).tolist(), "parameters": getattr(plant, "parameters", {}),
        "origin": getattr(plant, "origin", {})}


def described_plan(plan: RecordingPlan, signal: np.ndarray) -> dict:
    return {"name": plan.name, "kind": plan.kind, "split": plan.split, "start": plan.start,
            "duration": plan.duration, "noise_std": plan.noise_std,
            "excitation": _described_excitation(plan.excitation, signal)}


def _described_excitation(excitation: Excitation, signal: np.ndarray) -> dict:
    """Its settings; one from elsewhere may have others that nobody knows, so its signal speaks for it as well."""
    settings = asdict(excitation) if is_dataclass(excitation) else {}
    described = {"class": type(excitation).__qualname__,
                 **{key: np.asarray(value).tolist() for key, value in settings.items()}}
    if is_dataclass(inner := getattr(excitation, "excitation", None)):
        described["excitation"] = _described_excitation(inner, signal)
    if type(excitation).__module__ == signals.__name__:
        return described
    return described | {"class": _path(excitation), "signal": hashlib.sha256(signal.tobytes()).hexdigest()[:16]}


def _path(thing: object) -> str:
    return f"{type(thing).__module__}.{type(thing).__qualname__}"
