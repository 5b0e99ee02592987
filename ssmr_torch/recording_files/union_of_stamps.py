"""Several signals in one table, each with rows of its own: what PlotJuggler exports of topics of different rates."""

from __future__ import annotations

import os
from dataclasses import replace

import numpy as np

from ssmr_torch.recording_files.table import Table

ALONE = 0.8          # share of the rows in which only one group of columns holds values
FEWEST = 4           # rows of each group


def by_signal(table: Table) -> list[Table]:
    """A table for each group of columns that are empty in the rows of the others; else the table itself.

    Columns that are never empty, such as the time, belong to every group.
    """
    groups: dict[bytes, list[str]] = {}
    full = []
    for name, column in table.columns.items():
        there = np.array([cell == cell for cell in column]) if column.dtype.kind == "O" else ~np.isnan(column)
        if there.all():
            full.append(name)
        else:
            groups.setdefault(there.tobytes(), []).append(name)
    masks = [np.frombuffer(key, dtype=bool) for key in groups]
    if len(masks) < 2 or not full or min(mask.sum() for mask in masks) < FEWEST:
        return [table]
    if (np.sum(masks, axis=0) == 1).mean() < ALONE:
        return [table]
    found = []
    for mask, names in zip(masks, groups.values()):
        columns = {name: table.columns[name][mask] for name in (*full, *names)}
        part = os.path.commonprefix(names).strip("/_.[ ") or names[0]
        found.append(replace(table, columns=columns, part=part, notes=() if found else table.notes))
    return found
