"""Runs that no fit sees, and whether they are any others than those of the training."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from ssmr_torch.recordings.context import Recorded
from ssmr_torch.recordings.finding import GOOD, LOOK, MISSING, Finding
from ssmr_torch.trajectory import Trajectory

LENGTH = 16         # samples that must agree one by one
FINENESS = 1e-7     # of the range, within which numbers count as equal
MOVED = 0.005       # of the range; stretches at rest look all alike
SHARED = 0.02       # of a held-out run


def shared_rows(run: Trajectory, others: Sequence[Trajectory]) -> tuple[int, str]:
    """How many samples of a run are contained in one of the others, in the same order, and in which.

    Outputs and inputs of `LENGTH` samples in a row agree to 1e-7 of their range; stretches without motion do not count.
    """
    scale = _scale([run, *others])
    best, name = 0, ""
    own = dict(_stretches(run, scale))
    for other in others:
        met = [own[key] for key, _ in _stretches(other, scale) if key in own]
        rows = {start + step for start in met for step in range(LENGTH)}
        if len(rows) > best:
            best, name = len(rows), other.name
    return best, name


def _scale(runs: Sequence[Trajectory]) -> np.ndarray:
    rows = [np.hstack([run.observation, run.input]) for run in runs]
    extent = np.max([each.max(axis=0) for each in rows], axis=0) - np.min([each.min(axis=0) for each in rows], axis=0)
    return np.where(extent > 0, extent, 1.0)


def _stretches(run: Trajectory, scale: np.ndarray) -> Iterator[tuple[bytes, int]]:
    table = np.hstack([run.observation, run.input]) / scale
    whole = np.round(table / FINENESS).astype(np.int64)
    outputs = run.observation.shape[1]
    for start in range(len(table) - LENGTH + 1):
        if np.ptp(table[start:start + LENGTH, :outputs], axis=0).max() > MOVED:
            yield whole[start:start + LENGTH].tobytes(), start


def held_out(recorded: Recorded) -> Finding:
    """Whether there are test and validation runs, and none of them is in the training."""
    subject, training = "held-out runs", recorded.training
    count = {split: len(recorded.of(split)) for split in ("train", "validation", "test")}
    for run in (*recorded.of("test"), *recorded.of("validation")):
        rows, name = shared_rows(run, training)
        if rows > max(LENGTH, SHARED * run.length):
            return Finding(subject, MISSING, f"{rows} of the {run.length} samples of the {run.split} run {run.name!r} are "
                           f"those of the training run {name!r}.", "Fits refuse this: record another run, or leave "
                           "these samples out of the training.", {**count, "shared_samples": rows})
    twice = [(run.name, other.name) for place, run in enumerate(training) for other in training[:place]
             if run.length == other.length and np.array_equal(run.observation, other.observation)]
    numbers = {**count, "shared_samples": 0, "copies": len(twice)}
    if not count["test"]:
        return Finding(subject, MISSING, "0 test runs: no score would tell how the model does on what it has not seen.",
                       "Record a run of 10 s with other inputs and name it under split: {test: […]}.", numbers)
    if twice:
        return Finding(subject, LOOK, f"{len(twice)} pairs of training runs are copies, the first is {twice[0][1]!r} and "
                       f"{twice[0][0]!r}.", "Leave one of each pair out: a copy counts twice and tells nothing.", numbers)
    kinds = {run.kind for run in recorded.of("test")}
    if "controlled" not in kinds:
        return Finding(subject, LOOK, f"{count['test']} test runs, all of them decays.",
                       "Hold a controlled run out as well: the score is to tell how inputs act.", numbers)
    return Finding(subject, GOOD, f"{count['test']} test and {count['validation']} validation runs; none shares samples "
                   "with the training.", "", numbers)
