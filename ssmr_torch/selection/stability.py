"""Whether a model stays near what was measured where nothing was: faster and stronger inputs, whole runs."""

from __future__ import annotations

import numpy as np

from ssmr_torch.models.polynomial import PolynomialModel
from ssmr_torch.selection.rollouts import rolled_out
from ssmr_torch.selection.samples import Samples, Starts

FARTHEST = 3.0    # times the largest training output that a rollout may reach
STRONGER, FASTER = (1.0, 1.5), (1, 2)


def stays_bounded(model: PolynomialModel, samples: Samples) -> bool:
    """Whether no rollout over a whole training run leaves `FARTHEST` times the range, with the inputs as recorded,
    twice as fast, half as strong again, and both; and what the model does at rest decays.
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
    """Whether all modes at rest decay: what does not would grow for ever. The constant, a state of some, is no mode."""
    constant = 0 if model.structure.relift else int(model.constant_states.sum())
    rates = np.sort(model.rates.real)
    return bool((rates[:len(rates) - constant] < 0.0).all())
