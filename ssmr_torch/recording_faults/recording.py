"""`Recording`: the samples of one run in SI units, with their faults."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ssmr_torch.recording_files.note import Note


@dataclass(frozen=True, eq=False)
class Recording:
    """Samples of one file or part of it in SI units, not yet trusted.

    time: (T,) s. observation: (T, p) m, absolute unless `centred`. input: (T, m), held from sample to sample.
    seams: rows of the file at which another run begins, or "auto" to look for them. rows: (T,) row of the file of each
    sample, from 0, in increasing order; None: all of them. cuts: rows of the file before which the run is cut, because
    bad rows were taken out. output_names: of the columns of observation, where they are known. notes: what was found
    and done so far.
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
    cuts: tuple[int, ...] = ()
    output_names: tuple[str, ...] = ()

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

    def noted(self, kind: str, said: str, done: str, rows: Sequence[int] = (), **numbers) -> Recording:
        """The recording with one more note; rows: of the file."""
        return replace(self, notes=(*self.notes, Note(self.name, kind, said, done, tuple(rows), numbers)))

    def without(self, places: np.ndarray) -> Recording:
        """The recording without the samples where `places` (T,) is true, cut at both ends of each stretch of them.

        Raises ValueError when fewer than two samples are left.
        """
        kept = np.flatnonzero(~places)
        if len(kept) < 2:
            raise ValueError(f"{self.name}: {len(kept)} of {len(self.rows)} rows are left; leave the run out")
        after, last = self.rows[kept[1:][np.diff(kept) > 1]], self.rows[kept[-1]]
        seams = self.seams if self.seams == "auto" else tuple(row for row in self.seams if row <= last)
        return replace(self, seams=seams, time=self.time[kept], observation=self.observation[kept],
                       input=self.input[kept], rows=self.rows[kept], cuts=tuple(sorted({*self.cuts, *after.tolist()})))

    def columns(self, which: np.ndarray) -> str:
        """Names of the columns where `which` (p,) is true, as "x and z"; "" for all of them."""
        names = self.output_names or tuple(f"y{number}" for number in range(1, len(which) + 1))
        return "" if which.all() else " and ".join(name for name, each in zip(names, which) if each)


def longest(recordings: Sequence[Recording]) -> int:
    """Rows of the longest of them."""
    return max(len(each.time) for each in recordings)
