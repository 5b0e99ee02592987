"""Recording trajectories from a plant: decays to rest and controlled runs."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from tqdm import tqdm

from ssmr_torch import __version__
from ssmr_torch.checked_arguments import checked
from ssmr_torch.collection.excitation import RandomOnOffRamp, Release
from ssmr_torch.collection.parallel import available_cores, record, record_all
from ssmr_torch.collection.recording_plans import (
    ControlledRun,
    RecordingPlan,
    decay_plans,
    described_plan,
    described_plant,
    refuse_repeated_names,
)
from ssmr_torch.collection.resumption import Recorded, discard_recorded
from ssmr_torch.keywords import configurable
from ssmr_torch.plants.base import Plant
from ssmr_torch.quantities import DURATION, LENGTH, SEED, TRUTH
from ssmr_torch.ranges import Each, Either, Made, OrNone, Whole
from ssmr_torch.trajectory import Trajectory, TrajectoryDataset

__all__ = ["ControlledRun", "RecordingPlan", "collect", "discard_recorded", "record"]

DEFAULT_RELEASE = RandomOnOffRamp()


@configurable(given=("workers", "directory"))
@checked(decays=Either(Whole(0, 10_000), Each(Made(), 0), said="a whole number from 0 to 10000, or excitations"),
         validation_decays=Whole(0, 10_000), test_decays=Whole(0, 10_000), decay_duration=DURATION, noise_std=LENGTH,
         seed=SEED, workers=OrNone(Whole(1, 1024)), progress=TRUTH,
         controlled=Each(Made(), 0))
def collect(plant: Plant, *, decays: int | Sequence[Release] = 40, validation_decays: int = 4,
            test_decays: int = 4, decay_duration: float = 5.0, release: Release = DEFAULT_RELEASE,
            controlled: Sequence[ControlledRun] = (), noise_std: float = 0.0, seed: int = 0,
            workers: int | None = 1, directory: str | Path | None = None,
            progress: bool = True) -> TrajectoryDataset:
    """Record decays and controlled runs, each from rest.

    A decay starts when its excitation lets go and lasts `decay_duration` s with the resting input. decays: how
    many for training, all excited by `release`, or one excitation each; validation and test use `release`.
    noise_std: white measurement noise, m. The same seed gives the same data; a trajectory's random numbers
    follow from the seed and its name, not from the other trajectories.
    workers: processes that record, one thread each; None for one per available core, 1 for this process. The data
    are the same to the last bit where the plant's arithmetic does not depend on the number of threads.
    directory: keeps each trajectory as soon as it is finished, for the next call with equal settings to take. Call
    `discard_recorded` once the dataset is saved there as trajectories.h5; then that file is returned as it is.
    Raises ValueError, before anything is recorded, when a plan is impossible, two runs share a name, or the
    directory holds trajectories of other settings; later, when the plant refuses to go on. ChildProcessError when a
    process that records dies. What was finished by then is kept in the directory.
    """
    plans = _plans({"train": decays, "validation": validation_decays, "test": test_decays}, decay_duration, release,
                   controlled, noise_std)
    workers = available_cores() if workers is None else _count("workers", workers, least=1)
    provenance = _provenance(plant, plans, seed)
    store = None if directory is None else Recorded(_comparable(plant, directory), provenance)
    if store and (dataset := store.complete()):
        return dataset
    finished = store.take() if store else {}
    _record_rest(plant, plans, seed, workers, finished, store, progress)
    return _dataset(plant, [finished[plan.name] for plan in plans], provenance)


def _plans(decays: dict[str, int | Sequence[Release]], duration: float, release: Release,
           controlled: Sequence[ControlledRun], noise_std: float) -> list[RecordingPlan]:
    excitations = {split: [release] * _count(f"the number of {split} decays", of_split, least=0)
                   if isinstance(of_split, int) else list(of_split) for split, of_split in decays.items()}
    plans = [plan for split, chosen in excitations.items() for plan in decay_plans(split, chosen, duration, noise_std)]
    plans += [plan for run in controlled for plan in run.plans(noise_std)]
    refuse_repeated_names(plans)
    return plans


def _record_rest(plant: Plant, plans: Sequence[RecordingPlan], seed: int, workers: int,
                 finished: dict[str, Trajectory], store: Recorded | None, progress: bool) -> None:
    """Add the trajectories that are not finished yet to those that are."""
    rest = [plan for plan in plans if plan.name not in finished]
    total, missing = (sum(plan.samples(plant.timestep) for plan in chosen) for chosen in (plans, rest))

    def keep(trajectory: Trajectory) -> None:
        if store:
            store.keep(_dataset(plant, [trajectory], store.provenance))
        finished[trajectory.name] = trajectory

    with tqdm(desc="collect", total=total, initial=total - missing, unit=" samples", smoothing=0,
              disable=not progress) as bar:
        try:
            record_all(plant, rest, seed, workers, keep, lambda samples: bar.update(total - missing + samples - bar.n))
        except (ValueError, ChildProcessError) as error:
            kept = f"; {len(finished)} of {len(plans)} trajectories are kept in {store.folder}" if store else ""
            raise type(error)(f"{error}{kept}") from error


def _dataset(plant: Plant, trajectories: Sequence[Trajectory], provenance: dict) -> TrajectoryDataset:
    return TrajectoryDataset(trajectories, plant.rest, plant.output_names, plant.input_names, plant.input_unit,
                             provenance)


def _count(name: str, value: int, least: int) -> int:
    if not isinstance(value, int) or value < least:
        raise ValueError(f"{name} is {value!r}; expected a whole number, {least} or more")
    return value


def _comparable(plant: Plant, directory: str | Path) -> Path:
    """Raises ValueError for a plant of unknown settings: what another had recorded would pass for its own."""
    if not hasattr(plant, "parameters"):
        raise ValueError(f"{type(plant).__name__} has no `parameters`, so what is kept in {directory} could be of "
                         "another one; give it that property (a dict of plain values), or collect without a directory")
    return Path(directory)


def _provenance(plant: Plant, plans: Sequence[RecordingPlan], seed: int) -> dict:
    """Raises ValueError for an impossible plan, or a plant whose parameters no file can hold."""
    described = {"source": "simulation", "package": f"ssmr_torch {__version__}", "seed": seed,
                 "plant": described_plant(plant),
                 "plans": [described_plan(plan, plan.signal(plant, seed)) for plan in plans]}
    try:
        return json.loads(json.dumps(described))
    except TypeError as error:
        raise ValueError(f"the settings of {type(plant).__name__} or of an excitation are not plain values ({error}); "
                         "give numbers, texts, lists and dicts") from error
