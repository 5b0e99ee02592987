"""Recording what a model learns from, within the card's limits: where they are exceeded, the inputs become smaller."""

from __future__ import annotations

from collections.abc import Callable

from ssmr_torch.collection.resumption import COMPLETE
from ssmr_torch.commissioning.directory import CommissioningDirectory, dataset_of
from ssmr_torch.commissioning.safety_guard import GuardedPlant, SafetyStop
from ssmr_torch.trajectory import TrajectoryDataset

NARROWER = 0.75   # of the share of the input range, after each stop
LEAST = 0.05      # of the range; below that something else is wrong
NOTE = "collection.json"


def gather(plant: GuardedPlant, excitation: Callable, directory: CommissioningDirectory, share: float,
           go_on: Callable[[str], bool]) -> TrajectoryDataset | None:
    """All runs of the excitation, in trajectories.h5; what a kill left is taken up, run by run.

    excitation: (plant, directory, workers) → dataset, such as `data.collection.collect` with its settings.
    share: of the way from the neutral input to the bounds, that the inputs use at first. A stop keeps the finished
    runs, and the stopped one aside, marked; `go_on`, asked with what happened, lets the rest be recorded with 75 % of
    the share.
    Returns None where it does not. Raises SafetyStop when the share would fall below 5 %.
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
            if not go_on(f"{stop} What was recorded is kept; the rest would follow with {100 * narrower:.3g} % of the "
                         "input range."):
                directory.write_json(NOTE, note)
                return None
            note["share"] = narrower
        finally:
            guard.relax()
    directory.keep_trajectories(dataset_of(guard, directory.gathered(guard), note))
    return directory.trajectories()


def recorded_share(directory: CommissioningDirectory) -> float:
    """The share of the input range that was recorded last."""
    return float(directory.read_json(NOTE)["share"])
