"""Recordings that nothing can be learned from, refused with the remedy before any long work."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ssmr_torch.recording_faults.copies import copy_said, equal_pairs, is_copied, shared_rows
from ssmr_torch.trajectory import Trajectory, TrajectoryDataset

STILL = 1e-9        # of the largest range, below which a marker does not move
SAME = 1e-9         # of its range, to which an output is given by others
ROWS = 20000        # that dependence is judged on
FEWEST = 8          # samples that one training run must have at least


def check_learnable(dataset: TrajectoryDataset, delays: int = 0) -> None:
    """Raises ValueError, with the remedy, for data that no model can be fitted to.

    delays: of the model's window, in samples. Refused are: a dataset of one run, runs shorter than a window and the
    steps after it, numbers that are not finite, inputs that never change, outputs that never move or are given by
    others, runs that are all alike, and held-out runs that are part of the training.
    """
    training = [run for run in dataset.select("train") if run.kind != "static"]
    if not training:
        raise ValueError("no run is for training; mark fewer runs as test or validation")
    if len(dataset) == 1:
        raise ValueError(f"{training[0].name or 'the trajectory'} is the only run, so nothing would tell how a model "
                         "does on what it has not seen; record a second one and mark it as test, or cut this one in "
                         "two")
    refuse_short(training, delays)
    runs = [run.read() for run in dataset]  # refuses what is not finite
    training = [run for run in runs if run.split == "train" and run.kind != "static"]
    refuse_still_inputs(dataset, [run.extremes() for run in training])
    _refuse_outputs(training, dataset.output_names)
    _refuse_copies(runs, training)


def refuse_short(training: Sequence, delays: int) -> None:
    """Raises ValueError where the longest run has fewer samples than a window of so many delays and a step after it."""
    longest = max(training, key=lambda run: run.length)
    needed = delays + 2
    if longest.length < needed:
        raise ValueError(f"a window of {delays} samples of delay and the step after it take {needed} samples, "
                         f"{needed - longest.length} more than the longest training run, {longest.name!r}, has "
                         f"({longest.length}); take at most {max(longest.length - 2, 0)} samples of delay, or record "
                         "longer runs")
    if longest.length < FEWEST:
        raise ValueError(f"the longest training run, {longest.name!r}, has {longest.length} samples; at least {FEWEST} "
                         "are needed to see how the robot moves: record runs of seconds, not single steps")


def refuse_still_inputs(dataset: TrajectoryDataset, extremes: Sequence) -> None:
    """Raises ValueError when an input never changes; extremes: of the training's runs, see `Run.extremes`."""
    inputs = np.stack([each[1] for each in extremes])
    lowest, highest = inputs[:, 0].min(0), inputs[:, 1].max(0)
    still = [f"{name} ({level:g})" for name, level, top in zip(dataset.input_names, lowest, highest) if level == top]
    if still:
        raise ValueError(f"inputs that never change in the training data: {', '.join(still)}; their effect cannot be "
                         "learned, so leave these columns out or record runs that use them")


def _refuse_outputs(training: Sequence[Trajectory], names: Sequence[str]) -> None:
    y = np.concatenate([run.observation for run in training])
    extent = np.ptp(y, axis=0)
    still = [name for name, size in zip(names, extent) if size <= STILL * extent.max()]
    if still:
        raise ValueError(f"outputs that never move in the training data: {', '.join(still)}; a marker that was lost, "
                         "or a direction that the robot does not have: leave these columns out (outputs=[…])")
    scaled = y[::max(1, len(y) // ROWS)]
    scaled = (scaled - scaled.mean(axis=0)) / extent
    for place, name in enumerate(names):
        before = scaled[:, :place]
        if not place:
            continue
        weights = np.linalg.lstsq(before, scaled[:, place], rcond=1e-12)[0]
        if np.abs(scaled[:, place] - before @ weights).max() <= SAME:
            of = [other for other, weight in zip(names, weights) if abs(weight) > 1e-6]
            same = len(of) == 1 and abs(weights[list(names).index(of[0])] * extent[place] / extent[
                list(names).index(of[0])] - 1) < 1e-6
            what = "a copy of" if same else "a linear combination of"
            raise ValueError(f"output {name} is {what} {', '.join(of)}, to {SAME:g} of its range; it adds nothing "
                             "that a model could learn, so leave it out (outputs=[…])")


def _refuse_copies(runs: Sequence[Trajectory], training: Sequence[Trajectory]) -> None:
    pairs = equal_pairs(runs)
    if len(runs) > 1 and len(pairs) == len(runs) - 1:
        raise ValueError(f"all {len(runs)} runs have the same contents; record runs that differ, or leave the copies "
                         "out")
    for run in runs:
        if run.split == "train" or run.kind == "static":
            continue
        rows, name = shared_rows(run, training)
        if is_copied(run, rows):
            raise ValueError(copy_said(run, rows, name))
