"""`Predictor`: one NumPy interface for models and baselines, so that all are scored by the same code."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from ssmr_torch.models.batch_rollout import BatchRollout, batch_of

FEW = 4000  # steps of all rollouts; fewer take less time than loading the compiled code


@dataclass(frozen=True)
class Predictor:
    """A function that can be scored: (ŷ_1, …, ŷ_H) = predict(window, window_inputs, inputs), with NumPy arrays.

    window: (N, n_d + 1, p), oldest sample first, `window_timestep` s apart, m; window_inputs: (N, n_d, m),
    held from each sample of the window to the next; inputs: (N, H, m), held one `timestep` (s) each.
    Returns (N, H, p), m, infinite from the step at which the rollout diverged.
    output_dim, input_dim: None if any number is possible. initial: function of window and window_inputs that returns
    the predictor's own y_0 (N, p), m; None: the newest sample of the window.
    """

    predict: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
    delays: int
    timestep: float
    window_timestep: float
    output_dim: int | None = None
    input_dim: int | None = None
    initial: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None


def model_predictor(model) -> Predictor:
    """Predictor of a `Model`, or of an object with a model as its `reduced`, in NumPy; compiled, if it can be, for many
    steps. Samples from `diverged_at` on are infinite.
    """
    plain = BatchRollout(model)
    reduced, compiled = plain.model, cache(lambda: batch_of(model))

    def predict(window, window_inputs, inputs):
        batch = plain if len(inputs) * inputs.shape[1] < FEW else compiled()
        with np.errstate(over="ignore", invalid="ignore"):
            return batch.outputs(reduced.encode(window, window_inputs), inputs)

    def initial(window, window_inputs):
        return reduced.decode(reduced.encode(window, window_inputs))

    return Predictor(predict, reduced.delays, reduced.timestep, reduced.window_timestep, reduced.output_dim,
                     reduced.input_dim, initial)


def at_every_sample(predictor: Predictor, stride: int) -> Predictor:
    """The same predictor with outputs at `stride` instants per step, so that models with different steps are compared
    at the same instants.

        ŷ_{k stride + j} = (1 − j / stride) ŷ_k + (j / stride) ŷ_{k + 1},   ŷ_0 decoded from the initial state

    Each input is held for one instant, and a step takes their mean. If the last step is not complete, the newest input
    is held to its end. Outputs are infinite from the step in which the rollout diverges.
    """
    if stride == 1:
        return predictor

    def predict(window, window_inputs, inputs):
        horizon = inputs.shape[1]
        steps = -(-horizon // stride)
        ahead = np.minimum(np.arange(steps * stride), horizon - 1)
        held = inputs[:, ahead].reshape(len(inputs), steps, stride, -1).mean(axis=2)
        first = window[:, -1] if predictor.initial is None else predictor.initial(window, window_inputs)
        knots = np.concatenate([first[:, None], predictor.predict(window, window_inputs, held)], axis=1)
        return _between(knots, stride)[:, :horizon]

    return replace(predictor, predict=predict, timestep=predictor.timestep / stride)


def _between(knots: np.ndarray, stride: int) -> np.ndarray:
    """Linear interpolation of outputs (N, S + 1, p), `stride` instants apart, at all instants after the first:
    (N, S · stride, p).
    """
    share = np.tile(np.arange(1, stride + 1) / stride, knots.shape[1] - 1)[:, None]
    low, high = (np.repeat(array, stride, axis=1) for array in (knots[:, :-1], knots[:, 1:]))
    with np.errstate(invalid="ignore", over="ignore"):
        return np.where(np.isfinite(high), low + share * (high - low), np.inf)


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
    """A `Predictor` unchanged; the predictor of a model with NumPy or Torch arrays."""
    return model if isinstance(model, Predictor) else model_predictor(model)
