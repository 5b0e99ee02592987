"""Finds samples that two runs share, because a test run that is part of a training run makes its score useless."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from ssmr_torch.recording_files.note import Note
from ssmr_torch.trajectory import Trajectory, TrajectoryDataset

logger = logging.getLogger(__name__)

LENGTH = 16         # number of consecutive samples that must agree
FINENESS = 1e-7     # numbers that differ by less than this share of the range count as equal
MOVED = 0.005       # smallest motion as a share of the range, because all samples at rest look alike
NOISE = 0.7         # of the noise, below which two runs are one measurement
FEWEST_CHANGES = 4  # changes of the inputs that must agree
SHARED = 0.02       # share of a run above which it counts as part of another run


def shared_rows(run: Trajectory, others: Sequence[Trajectory]) -> tuple[int, str]:
    """Number of samples of a run that another run contains in the same order, and the name of that run.

    Outputs and inputs of `LENGTH` consecutive samples must agree within `FINENESS` of their range. Samples without
    motion do not count. Returns 0 and "" if there are none.
    """
    tables = [np.hstack([each.observation, each.input]) for each in (run, *others)]
    low, high = (np.min([each.min(0) for each in tables], axis=0), np.max([each.max(0) for each in tables], axis=0))
    scale, outputs = np.where(high > low, high - low, 1.0), run.observation.shape[1]
    own = _marks((tables[0] - low) / scale, outputs)
    best, name = 0, ""
    for other, table in zip(others, tables[1:]):
        met = np.flatnonzero(np.isin(own, _marks((table - low) / scale, outputs)) & (own != 0))
        rows = len(np.unique(met[:, None] + np.arange(LENGTH)))
        if rows > best:
            best, name = rows, other.name
    return best, name


def rounded_rows(run: Trajectory, others: Sequence[Trajectory]) -> tuple[int, str]:
    """Number of samples of a run that another run contains under the same inputs, with outputs that differ by less than
    their noise, and the name of that run.

    Two measurements of the same motion differ by √2 times their noise; numbers that were only rounded or scaled in
    writing differ by less. Returns 0 and "" if there are none.
    """
    best, name = 0, ""
    noise = _noise(run)
    for other in others:
        shift = _same_inputs(run.input, other.input)
        if shift is None:
            continue
        first, stop = max(0, -shift), min(run.length, other.length - shift)
        apart = run.observation[first:stop] - other.observation[first + shift:stop + shift]
        if stop - first > max(LENGTH, best) and (np.sqrt(np.mean(apart ** 2, axis=0)) < NOISE * noise).all():
            best, name = stop - first, other.name
    return best, name


def _noise(run: Trajectory) -> np.ndarray:
    """(p,), m, of the fourth differences, whose variance is 70 times that of white noise."""
    return np.median(np.abs(np.diff(run.observation, 4, axis=0)), axis=0) / 0.6745 / np.sqrt(70) if (
        run.length > 4) else np.zeros(run.observation.shape[1])


def _same_inputs(u: np.ndarray, other: np.ndarray) -> int | None:
    """By how many rows u must be shifted to equal the other's inputs; None if it nowhere equals them."""
    changes, theirs = (np.flatnonzero((np.diff(each, axis=0) != 0).any(axis=1)) + 1 for each in (u, other))
    if len(changes) < FEWEST_CHANGES or len(theirs) < FEWEST_CHANGES:
        return None
    places: dict[bytes, int] = {other[row].tobytes(): int(row) for row in theirs}
    shifts = [places[u[row].tobytes()] - int(row) for row in changes if u[row].tobytes() in places]
    if len(shifts) < FEWEST_CHANGES:
        return None
    values, counts = np.unique(shifts, return_counts=True)
    return int(values[counts.argmax()]) if counts.max() >= max(FEWEST_CHANGES, 0.5 * len(shifts)) else None


def is_copied(run: Trajectory, rows: int) -> bool:
    """Whether a run with this number of shared samples counts as part of another run."""
    return rows > max(LENGTH, SHARED * run.length)


def equal_pairs(runs: Sequence[Trajectory]) -> list[tuple[str, str]]:
    """Names of the pairs of runs with the same outputs and inputs."""
    known: dict[bytes, str] = {}
    found = []
    for run in runs:
        key = run.observation.tobytes() + run.input.tobytes()
        if key in known:
            found.append((known[key], run.name))
        known.setdefault(key, run.name)
    return found


def without_copies(dataset: TrajectoryDataset, rule: str) -> TrajectoryDataset:
    """The dataset, with a note in its provenance on copies among its training runs.

    Raises ValueError, unless the rule is "keep", for a test or validation run that is part of a training run.
    """
    runs = [run.read() for run in dataset]
    training = [run for run in runs if run.split == "train" and run.kind != "static"]
    notes = []
    for run in runs:
        if run.split == "train" or run.kind == "static":
            continue
        rows, name = max(shared_rows(run, training), rounded_rows(run, training))
        if is_copied(run, rows):
            text = copy_said(run, rows, name)
            if rule != "keep":
                raise ValueError(text)
            notes.append(Note(run.name, "copies", f"{rows} of its samples are those of {name}; kept, as faults.copies "
                              "says", "kept"))
    notes += [Note(second, "copies", f"it has the same contents as {first}, so that run counts twice; leave one out",
                   "kept") for first, second in equal_pairs(training)]
    for note in notes:
        logger.warning("%s", note)
    if not notes:
        return dataset
    known = dataset.provenance.get("notes", [])
    return replace(dataset, provenance=dataset.provenance | {"notes": [*known, *(note.as_dict() for note in notes)]})


def copy_said(run: Trajectory, rows: int, name: str) -> str:
    """The refusal of a run that shares so many rows with the training run of this name."""
    return (f"{rows} of the {run.length} samples of the {run.split} run {run.name!r} are those of the training run "
            f"{name!r}, so its score would tell nothing; record another run, or leave these samples out of the "
            "training")


def _marks(table: np.ndarray, outputs: int) -> np.ndarray:
    """(T,), a hash of the `LENGTH` samples that begin at each row; equal samples give equal numbers, and 0 marks rest
    and rows near the end.
    """
    marks = np.zeros(len(table), dtype=np.uint64)
    if len(table) < LENGTH:
        return marks
    mixing = np.random.default_rng(0)
    whole = np.round(table / FINENESS).astype(np.int64).astype(np.uint64)
    rows = (whole * mixing.integers(1, 2**63, whole.shape[1], dtype=np.uint64)).sum(axis=1, dtype=np.uint64)
    order = mixing.integers(1, 2**63, LENGTH, dtype=np.uint64)
    kept = len(table) - LENGTH + 1
    mixed = sum((rows[step:step + kept] * order[step] for step in range(LENGTH)), np.zeros(kept, dtype=np.uint64))
    windows = sliding_window_view(table[:, :outputs], LENGTH, axis=0)
    marks[:kept] = np.where((windows.max(-1) - windows.min(-1)).max(axis=1) > MOVED, mixed, 0)
    return marks
