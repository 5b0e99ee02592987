"""Samples that two runs share: a test that is part of the training tells nothing."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from ssmr_torch.trajectory import Trajectory

LENGTH = 16         # samples in a row that must agree
FINENESS = 1e-7     # of the range, within which numbers count as equal
MOVED = 0.005       # of the range; stretches at rest look all alike
SHARED = 0.02       # of a run, from which on it counts as part of another


def shared_rows(run: Trajectory, others: Sequence[Trajectory]) -> tuple[int, str]:
    """How many samples of a run are contained in one of the others, in the same order, and the name of that one.

    Outputs and inputs of `LENGTH` samples in a row agree to `FINENESS` of their range; stretches without motion do not
    count. Returns 0 and "" where there are none.
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


def is_copied(run: Trajectory, rows: int) -> bool:
    """Whether so many shared samples make a run part of another."""
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


def _marks(table: np.ndarray, outputs: int) -> np.ndarray:
    """(T,) a number for the `LENGTH` samples from each row on, equal for equal ones; 0 at rest and near the end."""
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
