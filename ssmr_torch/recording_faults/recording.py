"""`Recording`: the samples of one run in SI units, with their faults."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ssmr_torch.recording_files.note import Note


@dataclass(frozen=True, eq=False)
class Recording:
    """Samples of one file or part of it in SI units, not yet trusted.

    time: (T,) s. observation: (T, p) m, absolute unless `centred`. input: (T, m), held from sample to sample.
    seams: rows of the file at which another run begins, or "auto" to look for them. rows: (T,) row of the file of each
    sample, from 0, in increasing order; None: all of them. notes: what was found and done so far.
    Raises ValueError when the three arrays disagree in length.
    """

    name: str
    time: np.ndarray
    observation: np.ndarray
    input: np.ndarray
    kind: str = "controlled"
    split: str = "train"
    centred: bool = False
    seams: tuple[int, ...] | str = "auto"
    rows: np.ndarray | None = None
    notes: tuple[Note, ...] = ()

    def __post_init__(self):
        lengths = tuple(len(a) for a in (self.time, self.observation, self.input))
        if len(set(lengths)) > 1:
            raise ValueError(f"{self.name}: {lengths[0]} times, {lengths[1]} observations and {lengths[2]} "
                             "inputs; expected equally many")
        if lengths[0] < 2:
            raise ValueError(f"{self.name}: {lengths[0]} samples; at least 2 are needed")
        if isinstance(self.seams, str) and self.seams != "auto":
            raise ValueError(f"{self.name}: seams is {self.seams!r}; expected rows or 'auto'")
        if self.rows is None:
            object.__setattr__(self, "rows", np.arange(lengths[0]))
        last = int(self.rows.max())
        outside = [k for k in self.seams if not 0 < k <= last] if self.seams != "auto" else []
        if outside:
            raise ValueError(f"{self.name}: seams {outside} lie outside the {last + 1} rows")
