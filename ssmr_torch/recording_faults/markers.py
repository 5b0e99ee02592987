"""Which columns belong to one marker."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

AXIS = re.compile(r"^(.*?)[_.\s:-]?([xyzXYZ])(\d*)$")


def markers(columns: int, names: Sequence[str] = ()) -> list[np.ndarray]:
    """The columns of each marker.

    By the names, where all end in an axis (ax, ay, az; tip_x; x1, y1); else three at a time, if their number can be
    divided by three; else all columns are one marker.
    """
    matches = [AXIS.match(name) for name in names]
    if len(names) == columns and all(matches):
        owners = [(match[1], match[3]) for match in matches]
        each = [np.array([place for place, owner in enumerate(owners) if owner == known])
                for known in dict.fromkeys(owners)]
        if len({len(group) for group in each}) == 1 and len(each[0]) > 1:
            return each
    if columns % 3 == 0:
        return list(np.arange(columns).reshape(-1, 3))
    return [np.arange(columns)]


def marker_name(columns: np.ndarray, names: Sequence[str]) -> str:
    """What a marker is called: the common part of the names of its columns, else all of them."""
    chosen = [names[place] for place in columns] if names else [f"y{place + 1}" for place in columns]
    matches = [AXIS.match(name) for name in chosen]
    if all(matches) and len({(match[1], match[3]) for match in matches}) == 1 and (matches[0][1] or matches[0][3]):
        return matches[0][1] or matches[0][3]
    return "/".join(chosen)
