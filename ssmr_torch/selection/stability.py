"""Stability of a model beyond the data: whether it stays bounded over whole runs under faster and larger inputs."""

from __future__ import annotations

import numpy as np

from ssmr_torch.models.polynomial import PolynomialModel
from ssmr_torch.selection.folds_and_starts import Samples, Starts
from ssmr_torch.selection.rollouts import rolled_out

FARTHEST = 3.0    # largest output of a rollout, relative to the largest training output
STRONGER, FASTER = (1.0, 1.5), (1, 2)


def stays_bounded(model: PolynomialModel, samples: Samples) -> bool:
    """Whether all rollouts over whole training runs stay within `FARTHEST` times the measured range, and all modes at
    rest decay. The inputs are those recorded, twice as fast, 1.5 times larger, and both.
    """
    if not decays_at_rest(model):
        return False
    limit = FARTHEST * np.abs(np.concatenate([y for y, _ in samples.controlled])).max()
    past = samples.past
    for length in {len(y) for y, _ in samples.controlled}:
        y, u = (np.stack([run[k] for run in samples.controlled if len(run[0]) == length]) for k in (0, 1))
        for inputs in (factor * u[:, past::speed] for factor in STRONGER for speed in FASTER):
            starts = Starts(y[:, :past + 1], u[:, :past], np.ascontiguousarray(inputs), y[:, :0])
            if not np.abs(rolled_out(model, starts)).max(initial=0.0) < limit:
                return False
    return True


def decays_at_rest(model: PolynomialModel) -> bool:
    """Whether all modes at rest decay. Other modes would grow without limit. A constant state does not count as a mode.
    """
    constant = 0 if model.structure.relift else int(model.constant_states.sum())
    rates = np.sort(model.rates.real)
    return bool((rates[:len(rates) - constant] < 0.0).all())
