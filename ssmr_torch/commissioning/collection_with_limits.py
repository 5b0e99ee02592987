"""Records the training data within the card's limits. When a limit is exceeded, it continues with smaller inputs."""

from __future__ import annotations

from collections.abc import Callable

from ssmr_torch.collection.resumption import COMPLETE
from ssmr_torch.commissioning.directory import CommissioningDirectory, dataset_of
from ssmr_torch.commissioning.safety_guard import GuardedPlant, SafetyStop
from ssmr_torch.trajectory import TrajectoryDataset

NARROWER = 0.75   # after each stop the share of the input range is multiplied by this
LEAST = 0.05      # of the range; below it something else must be wrong
NOTE = "collection.json"


def gather(plant: GuardedPlant, excitation: Callable, directory: CommissioningDirectory, share: float,
           go_on: Callable[[str], bool]) -> TrajectoryDataset | None:
    """Record all runs of the excitation, in trajectories.h5. After a kill it continues with the next run.

    excitation: (plant, directory, workers) → dataset, such as `collection.collect` with its settings.
    share: how much of the way from the neutral input to the bounds the inputs use at first. After a stop, the finished
    runs are kept, and the stopped one is kept aside, marked. `go_on` is then asked with a text about the stop. If it
    agrees, the remaining runs are recorded with 75 % of the share.
    Returns None where `go_on` does not agree. Raises SafetyStop when the share would fall below 5 %.
    """
    if directory.has(COMPLETE):
        return directory.trajectories()
    note = directory.read_json(NOTE) if directory.has(NOTE) else {"share": share, "stops": []}
    while True:
        directory.write_json(NOTE, note)
        guard = plant.narrowed(note["share"], bridged=True)
        try:
            excitation(guard, directory=directory.runs_folder(note["share"]), workers=1)
            break
        except SafetyStop as stop:
            run = guard.run("collection")
            kept = directory.stopped("collection", run, guard, str(stop))
            note["stops"].append({"share": note["share"], "reason": str(stop), "kept": kept and kept.name})
            narrower = NARROWER * note["share"]
            if narrower < LEAST:
                raise
            if not go_on(f"{stop} The finished runs are kept; the remaining ones would use {100 * narrower:.3g} % of "
                         "the input range."):
                directory.write_json(NOTE, note)
                return None
            note["share"] = narrower
        finally:
            guard.relax()
    directory.keep_trajectories(dataset_of(guard, directory.gathered(guard), note))
    return directory.trajectories()


def recorded_share(directory: CommissioningDirectory) -> float:
    """The share of the input range in the last recording."""
    return float(directory.read_json(NOTE)["share"])
