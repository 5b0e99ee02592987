"""Tracked paths of closed loops over their reference (paper, Fig. 6, 7 and 11). SI in, mm drawn."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from ssmr_torch.evaluation import figures
from ssmr_torch.evaluation.figures import MM, styled
from ssmr_torch.paper.figure_panels import name_axes, tiles, title

POINTS_PER_PATH = 600


@styled
def tracked_paths(reference: np.ndarray, paths: Mapping[str, Sequence[np.ndarray]], axis_names: tuple[str, str],
                  notes: Mapping[str, str] | None = None) -> figures.Figure:
    """One panel per method: the path of each run over the reference (mm), the first of them bold.

    reference: (T, 2) m; paths: name → (T, 2) m of each run, the best first. notes: name → text below the name.
    """
    reference = MM * np.asarray(reference)
    figure, grid = tiles(len(paths), 1.75, sharex=True, sharey=True)
    for axes, (name, runs) in zip(grid, paths.items()):
        draw_paths(axes, reference, [MM * np.asarray(run) for run in runs], name, (notes or {}).get(name))
    low, high = reference.min(axis=0), reference.max(axis=0)
    room = 0.14 * max(high - low)
    grid[0].set(xlim=(low[0] - room, high[0] + room), ylim=(low[1] - room, high[1] + room))
    name_axes(figure, grid, *(f"{name} (mm)" for name in axis_names))
    return figure


def draw_paths(axes, reference: np.ndarray, runs: Sequence[np.ndarray], name: str, note: str | None) -> None:
    """A method's runs, the first bold, and the reference over them. All in mm."""
    colour = figures.colours([name])[name]
    for run in runs[:0:-1]:
        axes.plot(*run.T, color=colour, linewidth=0.6, alpha=0.35, antialiased=False, rasterized=True)
    thin = max(1, math.ceil(len(reference) / POINTS_PER_PATH))
    axes.plot(*runs[0][::thin].T, color=colour, linewidth=1.5)
    axes.plot(*reference[::thin].T, color="black", linestyle=(0, (3, 2)), linewidth=0.7)
    title(axes, name, note)
    axes.set_aspect("equal", adjustable="box")
