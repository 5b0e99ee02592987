"""Symmetries of a robot, found in its training runs or stated: whether the runs may be used once more, turned."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ssmr_torch.selection.candidate import ALL, ClosedForm
from ssmr_torch.selection.rollouts import rolled_out
from ssmr_torch.selection.samples import FOLDS, Samples, Starts
from ssmr_torch.selection.specification import Specification
from ssmr_torch.selection.turns import Turn, closed, suggested

STEP, INSTANTS = 1.0, 10    # s and samples of the responses that are compared
LINEAR = Specification(delays=4, memory=("shift", 4))
SIGNED = 0.5                # of an input's largest value, that it takes with the other sign, too


def response(samples: Samples) -> np.ndarray:
    """Responses G (H, p, m) of a linear model to a step of each input, of the size of the inputs' mean spread, m."""
    closed_form = ClosedForm(samples, LINEAR)
    model, m = closed_form.model(LINEAR.ridge, ALL), samples.input_dim
    steps = max(INSTANTS, round(STEP / samples.timestep))
    inputs = np.tile(samples.input_mean, (m + 1, steps, 1))
    inputs[1:] += samples.input_scale.mean() * np.eye(m)[:, None]
    window = np.zeros((m + 1, samples.past + 1, samples.output_dim))
    past = np.tile(samples.input_mean, (m + 1, samples.past, 1))
    y = rolled_out(model, Starts(window, past, inputs, window[:, :0]))
    at = np.linspace(0, steps - 1, INSTANTS + 1).astype(int)[1:]
    return (y[1:, at] - y[:1, at]).transpose(1, 2, 0)
