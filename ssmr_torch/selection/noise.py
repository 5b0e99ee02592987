"""Measurement noise: its estimate from recordings, and a chart for windows with more noise than in the recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ssmr_torch.models.polynomial import PolynomialModel
from ssmr_torch.selection.folds_and_starts import Samples
from ssmr_torch.selection.least_squares import Moments
from ssmr_torch.selection.windows import longer_window

STRETCH = 25        # smallest number of samples in a piece of a run, in which the noise is estimated
STRETCHES = 8       # largest number of pieces of a run; with many short pieces, the quietest underestimates the noise
RIDGE = 1e-10


def measured_noise(runs: Sequence[np.ndarray]) -> float:
    """Standard deviation, m, of white noise in outputs y (T, p), from third differences where the robot moves least.

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
    """The same dynamics with a new chart: its states are regressed on [1, window, past inputs] with `noise`, m.

    The window becomes the longest one that the samples hold. recorded: noise of the recordings themselves, m.
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
