"""Designed controllers on robots that changed after the recording: delay, lag, friction, payload, outliers, gaps.

The part `disturbed` of designed.py; results are kept in the same folder.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from ssmr_torch.benchmarks import designed
from ssmr_torch.checked_arguments import checked
from ssmr_torch.quantities import PATH, TEXT
from ssmr_torch.ranges import Each, OrNone, Whole


@checked(folder=PATH, recordings=OrNone(PATH), robots=OrNone(Each(TEXT, 0, 1000)), models=OrNone(Each(TEXT, 0, 1000)),
         conditions=Each(TEXT, 0), told=Each(TEXT, 0), tasks=Each(TEXT, 0), seeds=Whole(1, 10_000))
def rows(*, folder: str = "outputs/designed", recordings: str | None = None, robots: Sequence[str] | None = None,
         models: Sequence[str] | None = None, conditions: Sequence[str] = (), told: Sequence[str] = (),
         tasks: Sequence[str] = (), seeds: int = 5) -> Iterator[dict | str]:
    """One row per run on a changed robot; settings as of `designed.rows`."""
    yield from designed.rows(folder=folder, recordings=recordings, robots=robots, parts=("disturbed",), models=models,
                             conditions=conditions, told=told, tasks=tasks, seeds=seeds)
