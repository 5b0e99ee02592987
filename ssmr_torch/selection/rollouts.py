"""Rollouts of a model from the starts of a selection."""

from __future__ import annotations

import numpy as np

from ssmr_torch.models.batch_rollout import BatchRollout, batch_of
from ssmr_torch.models.polynomial import PolynomialModel
from ssmr_torch.selection.folds_and_starts import Starts

DENSE = 64  # for linear maps with more states, products of whole matrices are faster than the compiled kernel


def rolled_out(model: PolynomialModel, starts: Starts) -> np.ndarray:
    """Outputs along the horizon (N, H, p), m; infinite from the step at which a rollout diverged."""
    delays = model.delays
    window = starts.window[:, starts.window.shape[1] - delays - 1:]
    past = starts.past[:, starts.past.shape[1] - delays:]
    with np.errstate(over="ignore", invalid="ignore"):
        return _batch(model).outputs(model.encode(window, past), starts.inputs)


def _batch(model: PolynomialModel) -> BatchRollout:
    structure = model.structure
    linear = structure.scheme == "map" and structure.dynamics.highest <= 1 and not structure.relift
    return BatchRollout(model) if linear and model.state_dim > DENSE else batch_of(model)
