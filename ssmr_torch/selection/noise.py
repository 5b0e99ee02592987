"""The noise of the measurement: how large it is in the recordings, and a chart for windows that have more of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ssmr_torch.models.polynomial import PolynomialModel
from ssmr_torch.selection.least_squares import Moments
from ssmr_torch.selection.samples import Samples
from ssmr_torch.selection.windows import longer_window

STRETCH = 25        # samples at least in which the noise is looked for, where the robot moves least
STRETCHES = 8       # of a run at most: the quietest of many short ones is quieter than the noise, by chance
RIDGE = 1e-10


def measured_noise(runs: Sequence[np.ndarray]) -> float:
    """Standard deviation of white noise in outputs y (T, p), m: from third differences, where the robot moves least.

    The third difference of white noise has twenty times its variance; that of a slow motion is small.
    """
    found = []
    for y in runs:
        differences = np.diff(y, 3, axis=0) / np.sqrt(20.0)
        stretch = max(10, min(STRETCH, len(differences) // 4), len(differences) // STRETCHES)
        pieces = [np.sqrt(np.mean(differences[a:a + stretch] ** 2))
                  for a in range(0, len(differences) - stretch + 1, stretch)]
        found += [min(pieces)] if pieces else []
    return float(np.median(found)) if found else 0.0


def recharted(model: PolynomialModel, samples: Samples, noise: float, recorded: float = 0.0) -> PolynomialModel:
    """The same dynamics, with the states regressed anew on [1, window, past inputs] of windows with `noise`, m.

    The window becomes the longest that the samples hold. recorded: noise that the recordings themselves have, m.
    """
    past, latent = samples.past, model.latent_dim
    rows = samples.rows(0, decays=True)
    windows = samples.y[rows[:, None] + np.arange(-past, 1)]
    held = samples.u[rows[:, None] + np.arange(-past, 0)]
    z = model.encode(windows[:, past - model.delays:], held[:, past - model.delays:])
    longer = longer_window(model, past)
    X = longer.chart_regressors(windows, held)
    moments = Moments.of(X, z)
    extra = np.zeros(X.shape[1])
    extra[1:1 + (past + 1) * latent] = max(noise ** 2 - recorded ** 2, 0.0) / longer.window_scale[0] ** 2
    normal = moments.regressors + np.diag(extra)
    chart = Moments(normal, moments.targets, moments.rows).solution(RIDGE)
    return replace(longer, chart=chart)
