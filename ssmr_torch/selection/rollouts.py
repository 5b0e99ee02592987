"""Rollouts from starts of the samples."""

from __future__ import annotations

import numpy as np

from ssmr_torch.models.batch_rollout import batch_of
from ssmr_torch.models.polynomial import PolynomialModel
from ssmr_torch.selection.samples import Starts


def rolled_out(model: PolynomialModel, starts: Starts) -> np.ndarray:
    """Outputs along the horizon, m, (N, H, p), infinite from where a rollout diverged."""
    delays = model.delays
    window = starts.window[:, starts.window.shape[1] - delays - 1:]
    past = starts.past[:, starts.past.shape[1] - delays:]
    with np.errstate(over="ignore", invalid="ignore"):
        return batch_of(model).outputs(model.encode(window, past), starts.inputs)
