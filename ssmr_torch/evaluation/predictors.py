"""Models and baselines behind one NumPy function, so that one score serves them all."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ssmr_torch.models.batch_rollout import batch_of


@dataclass(frozen=True)
class Predictor:
    """What is scored: (ŷ_1, …, ŷ_H) = predict(window, window_inputs, inputs), NumPy arrays in and out.

    window: (N, n_d + 1, p), oldest sample first, `window_timestep` s apart, m; window_inputs: (N, n_d, m),
    held from each sample of the window to the next; inputs: (N, H, m), held one `timestep` (s) each.
    Returns (N, H, p), m, infinite from where the model itself calls the rollout diverged.
    output_dim, input_dim: None where any number will do.
    """

    predict: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
    delays: int
    timestep: float
    window_timestep: float
    output_dim: int | None = None
    input_dim: int | None = None


def model_predictor(model) -> Predictor:
    """A `Model`, or what has one as its `reduced`, in NumPy, compiled where its family is; samples from
    `diverged_at` on are infinite.
    """
    batch = batch_of(model)
    reduced = batch.model

    def predict(window, window_inputs, inputs):
        with np.errstate(over="ignore", invalid="ignore"):
            return batch.outputs(reduced.encode(window, window_inputs), inputs)

    return Predictor(predict, reduced.delays, reduced.timestep, reduced.window_timestep, reduced.output_dim,
                     reduced.input_dim)


def persistence(timestep: float) -> Predictor:
    """The baseline ŷ_k = y_0; timestep: s."""
    def predict(window, window_inputs, inputs):
        return np.repeat(window[:, -1:], inputs.shape[1], axis=1)

    return Predictor(predict, 0, timestep, timestep)


def constant_velocity(timestep: float) -> Predictor:
    """The baseline ŷ_k = y_0 + k (y_0 − y_{−1}); timestep: s."""
    def predict(window, window_inputs, inputs):
        step = np.arange(1, inputs.shape[1] + 1)[:, None]
        return window[:, -1:] + step * (window[:, -1:] - window[:, -2:-1])

    return Predictor(predict, 1, timestep, timestep)


BASELINES = {"persistence": persistence, "constant velocity": constant_velocity}


def as_predictor(model) -> Predictor:
    """A `Predictor` as it is; a model, of NumPy or Torch, behind one."""
    return model if isinstance(model, Predictor) else model_predictor(model)
