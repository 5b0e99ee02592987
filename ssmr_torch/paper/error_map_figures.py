"""Maps of the open-loop error over a robot's workspace (paper, Fig. 4 and 5). SI in, mm drawn."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ssmr_torch.evaluation import figures
from ssmr_torch.evaluation.figures import MM, styled
from ssmr_torch.paper.figure_panels import name_axes, plain_ticks, tiles, title

SCALE = "cividis"
BAD = "#CC3311"


@styled
def error_maps(position: np.ndarray, errors: Mapping[str, np.ndarray], axis_names: tuple[str, str] = ("x", "y"),
               plane: tuple[int, int] = (0, 1)) -> figures.Figure:
    """One panel per method: where the tip was at each start, coloured by the error from there (mm), on one common
    logarithmic scale; a start from which the method diverged is crossed out.

    position: (S, 3) m; errors: name → (S,) m, infinite where it diverged; plane: the two columns that are drawn.
    """
    position = MM * np.asarray(position)[:, list(plane)]
    errors = {name: MM * np.asarray(error, dtype=np.float64) for name, error in errors.items()}
    _match_starts(position, errors)
    figure, grid = tiles(len(errors), 1.55, sharex=True, sharey=True)
    low, high = _colour_range(errors)
    for axes, (name, error) in zip(grid, errors.items()):
        finite = np.isfinite(error)
        order = np.argsort(error[finite])  # the worst on top
        drawn = axes.scatter(*position[finite][order].T, c=np.clip(error[finite][order], low, high), s=7, linewidths=0,
                             cmap=SCALE, norm="log", rasterized=True, antialiased=False)
        drawn.set_clim(low, high)
        axes.plot(*position[~finite].T, "x", color=BAD, markersize=3.5, markeredgewidth=0.8, rasterized=True)
        title(axes, name, None if finite.all() else f"{100 * (~finite).mean():.2g} % diverged")
        axes.set_aspect("equal", adjustable="box")
    name_axes(figure, grid, *(f"{name} (mm)" for name in axis_names))
    bar = figure.colorbar(drawn, ax=grid, label="RMSE over 50 ms (mm)", aspect=35, pad=0.02, extend="both")
    plain_ticks(bar.ax.yaxis, low, high)
    bar.ax.grid(False)
    return figure


def _colour_range(errors: Mapping[str, np.ndarray]) -> tuple[float, float]:
    """Between which errors the colours vary: 1 to 99 % of all finite ones."""
    finite = np.concatenate([error[np.isfinite(error) & (error > 0)] for error in errors.values()])
    if not len(finite):
        return 1e-3, 1.0
    low, high = np.quantile(finite, [0.01, 0.99])
    return float(low), float(max(high, 1.01 * low))


def _match_starts(position: np.ndarray, errors: Mapping[str, np.ndarray]) -> None:
    wrong = {name: error.shape for name, error in errors.items() if error.shape != position.shape[:1]}
    if wrong or not errors:
        raise ValueError(f"errors of shape {wrong or 'none'} for {len(position)} starts; expected one error per start")
