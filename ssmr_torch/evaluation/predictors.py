"""Models and baselines behind one NumPy function, so that one score serves them all."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ssmr_torch.models.integrators import DIVERGENCE_FACTOR


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


def numpy_predictor(model) -> Predictor:
    """A model in NumPy: encode(window, inputs), rollout(z, inputs) → (N, H + 1, n), decode(z), state_scale (n,).

    As in Torch, a rollout has diverged once ‖z‖ is not within `DIVERGENCE_FACTOR` ‖state_scale‖.
    """
    bound = DIVERGENCE_FACTOR * np.linalg.norm(model.state_scale)

    def predict(window, window_inputs, inputs):
        with np.errstate(over="ignore", invalid="ignore"):
            states = model.rollout(model.encode(window, window_inputs), inputs)[..., 1:, :]
            outside = ~(np.linalg.norm(states, axis=-1) <= bound)
            outputs = model.decode(states)
        return np.where(np.logical_or.accumulate(outside, axis=-1)[..., None], np.inf, outputs)

    return _predictor_of(model, predict)


def torch_predictor(model) -> Predictor:
    """A Torch `ReducedModel`, on the device that it is on; samples from `diverged_at` on are infinite."""
    import torch

    def predict(window, window_inputs, inputs):
        window, window_inputs, inputs = (
            torch.as_tensor(array, dtype=torch.float64, device=model.state_scale.device)
            for array in (window, window_inputs, inputs))
        with torch.no_grad():
            rollout = model.rollout(model.encode(window, window_inputs), inputs)
            outputs = model.decode(rollout.states[..., 1:, :]).cpu().numpy()
        step = np.arange(1, inputs.shape[-2] + 1)
        diverged = step >= rollout.diverged_at.cpu().numpy()[..., None]
        return np.where(diverged[..., None], np.inf, outputs)

    return _predictor_of(model, predict)


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
    """A `Predictor` as it is; a Torch module or a NumPy model behind one."""
    if isinstance(model, Predictor):
        return model
    return torch_predictor(model) if hasattr(model, "state_dict") else numpy_predictor(model)


def _predictor_of(model, predict: Callable) -> Predictor:
    return Predictor(predict, model.delays, model.timestep, model.window_timestep,
                     model.output_dim, model.input_dim)
