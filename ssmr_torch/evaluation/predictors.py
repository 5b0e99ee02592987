"""Models and baselines behind one NumPy function, so that one score serves them all."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from ssmr_torch.models.batch_rollout import BatchRollout, batch_of

FEW = 4000  # steps of all rollouts, which take less time than loading what is compiled


@dataclass(frozen=True)
class Predictor:
    """What is scored: (ŷ_1, …, ŷ_H) = predict(window, window_inputs, inputs), NumPy arrays in and out.

    window: (N, n_d + 1, p), oldest sample first, `window_timestep` s apart, m; window_inputs: (N, n_d, m),
    held from each sample of the window to the next; inputs: (N, H, m), held one `timestep` (s) each.
    Returns (N, H, p), m, infinite from where the model itself calls the rollout diverged.
    output_dim, input_dim: None where any number will do. initial: the predictor's own y_0 (N, p), m, of window and
    window_inputs; None: the newest sample of the window.
    """

    predict: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
    delays: int
    timestep: float
    window_timestep: float
    output_dim: int | None = None
    input_dim: int | None = None
    initial: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None


def model_predictor(model) -> Predictor:
    """A `Model`, or what has one as its `reduced`, in NumPy, for many steps compiled where its family is; samples from
    `diverged_at` on are infinite.
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
    """The same at `stride` instants per step, so that models of any step are seen at the same ones.

        ŷ_{k stride + j} = (1 − j / stride) ŷ_k + (j / stride) ŷ_{k + 1},   ŷ_0 decoded from the initial state

    Inputs are held one instant each; a step sees their mean, and of a last one that is not whole the newest input is
    held to its end. Outputs are infinite from the step on in which the rollout diverges.
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
    """Outputs (N, S + 1, p) every `stride` instants as (N, S · stride, p) at all that follow the first, linearly."""
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
    """A `Predictor` as it is; a model, of NumPy or Torch, behind one."""
    return model if isinstance(model, Predictor) else model_predictor(model)
