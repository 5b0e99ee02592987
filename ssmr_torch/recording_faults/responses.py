"""The linear response of the controlled runs to their inputs, against which single runs are judged."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ssmr_torch.recording_clocks.gaps import find_time_gaps
from ssmr_torch.recording_estimates.modes import Modes, slow_modes
from ssmr_torch.recording_faults.recording import Recording
from ssmr_torch.trajectory import Trajectory

SHORTEST = 16       # samples of a part that is judged


class Part(NamedTuple):
    """A part of a recording without a cut, on a uniform clock, from rest; rows: its first and last place there."""

    name: str
    run: Trajectory
    first: int
    stop: int


def parts(recordings: Sequence[Recording], rest: np.ndarray) -> list[Part]:
    """The uncut parts of the recordings, each on the grid of its median sampling interval."""
    found = []
    for each in recordings:
        steps = np.diff(each.time)
        if not len(steps) or not np.isfinite(each.observation).all() or not (steps > 0).all():
            continue
        known = () if isinstance(each.seams, str) else each.seams
        edges = sorted({0, len(each.time), *find_time_gaps(each.time).tolist(),
                        *np.searchsorted(each.rows, [*known, *each.cuts]).tolist()})
        moved = each.observation - (0.0 if each.centred else rest)
        for first, stop in zip(edges, edges[1:]):
            if stop - first >= SHORTEST and np.isfinite(each.input[first:stop]).all():
                time = np.median(steps) * np.arange(stop - first)
                found.append(Part(each.name, Trajectory(time, moved[first:stop], each.input[first:stop], each.kind,
                                                        each.split, each.name), first, stop))
    return found


def modes_of(every: Sequence[Part]) -> Modes:
    """The slow modes of the parts."""
    return slow_modes([part.run for part in every])
