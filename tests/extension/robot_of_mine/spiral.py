"""A task of one's own: outwards on a spiral and back."""

from collections.abc import Sequence

import numpy as np

from ssmr_torch.tasks.references import Task


def spiral(radius: float = 0.008, turns: float = 2.0, duration: float = 4.0,
           tracked: Sequence[int | str] = ("x", "y")) -> Task:
    """r sin²(π s) (cos 2π n s, sin 2π n s) with s = t / duration; radius r in m, turns n, duration in s."""

    def path(time):
        share = time / duration
        angle = 2 * np.pi * turns * share
        return (radius * np.sin(np.pi * share) ** 2 * np.stack([np.cos(angle), np.sin(angle)])).T

    return Task("spiral", duration, tracked, path)
