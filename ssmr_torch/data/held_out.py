"""What of the training runs is kept back for validation."""

from __future__ import annotations

import numpy as np

from ssmr_torch.trajectory import TrajectoryDataset

HELD_OUT = ("tail", "outermost")


def hold_out(dataset: TrajectoryDataset, share: float, which: str, stretch: int) -> tuple[tuple, tuple]:
    """Training and validation runs, (...), (...); static ones are neither.

    which: "tail" keeps back the last `share` of every controlled training run, where no run is marked "validation".
    "outermost" keeps back the `share` that reaches furthest from the run's mean, in position and speed, in stretches
    of `stretch` samples, besides the runs marked "validation": a score on what lies within the training's range says
    little of a model that has to go beyond it.
    Raises ValueError, with the name and the numbers, when a run is too short for that.
    """
    training, marked = (tuple(run for run in dataset.select(split=split) if run.kind != "static")
                        for split in ("train", "validation"))
    if share == 0 or (marked and which == "tail"):
        return training, marked
    kept, held = [], list(marked)
    for run in training:
        if run.kind != "controlled":
            kept.append(run)
            continue
        chosen = _tail(run, share) if which == "tail" else _outermost(run, share, stretch)
        edges = np.flatnonzero(np.diff(chosen)) + 1
        for start, end in zip([0, *edges], [*edges, run.length]):
            (held if chosen[start] else kept).append(run.part(int(start), int(end)))
    return tuple(kept), tuple(held)


def _tail(run, share: float) -> np.ndarray:
    boundary = round(run.length * (1 - share))
    if min(boundary, run.length - boundary) < 2:
        raise ValueError(f"trajectory {run.name!r} has {run.length} samples, too few to hold out a "
                         f"share of {share}; set validation_share=0 or mark a run as validation")
    return np.arange(run.length) >= boundary


def _outermost(run, share: float, stretch: int) -> np.ndarray:
    """Whole stretches from the run's start, those of the largest mean squared distance; what is over is kept."""
    stretches = run.length // stretch
    if stretches < 2:
        raise ValueError(f"trajectory {run.name!r} has {run.length} samples; held_out=outermost needs two stretches of "
                         f"{stretch} samples, twice the validation horizon; set held_out=tail or a shorter "
                         "validation_horizon")
    observation = run.read().observation
    motion = np.hstack([observation, np.gradient(observation, axis=0)])
    spread = np.where(motion.std(0) > 0, motion.std(0), 1.0)
    distance = np.square((motion - motion.mean(0)) / spread).sum(1)
    reached = distance[:stretches * stretch].reshape(stretches, stretch).mean(1)
    count = min(max(round(share * run.length / stretch), 1), stretches - 1)
    chosen = np.zeros(run.length, dtype=bool)
    for index in np.argsort(-reached, kind="stable")[:count]:
        chosen[index * stretch:(index + 1) * stretch] = True
    return chosen
