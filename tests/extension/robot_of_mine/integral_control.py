"""A controller of one's own: the static gain of the model, and the integral of what it misses."""

import numpy as np

from ssmr_torch.control.base import Command
from ssmr_torch.status import Status


class IntegralController:
    """u = u₀ + G⁺ (r + k ∫ (r − y) dt − G u₀), clipped to the bounds; u₀ is their middle, G = dy/du at rest.

    rate k: 1/s. reach: m, the largest correction; a measurement that is not finite gives the input before again.
    """

    def __init__(self, model, task, input_bounds, *, timestep: float | None = None, output_names=None,
                 rate: float = 2.0, reach: float = 0.01):
        model, self.task, self.bounds = model.reduced, task, np.array(input_bounds, dtype=np.float64)
        self.period = model.window_timestep if timestep is None else timestep
        self.columns, self.rate, self.reach = list(task.columns(output_names)), rate, reach
        rest, none = np.zeros(model.state_dim), np.zeros(model.input_dim)
        A, B, _ = model.linearize(rest, none)
        self.gain = (model.linearize_output(rest).C @ np.linalg.solve(np.eye(len(A)) - A, B))[self.columns]
        self.reset()

    def reset(self) -> None:
        self._missed, self._input = np.zeros(len(self.columns)), self.bounds.mean(0)

    def __call__(self, time: float, observation) -> Command:
        reference = self.task.reference(time)[0]
        error = reference - np.array(observation, dtype=np.float64)[self.columns]
        if not np.isfinite(error).all():
            return Command(self._input.copy(), fallback=Status.NOT_FINITE)
        self._missed = np.clip(self._missed + self.period * self.rate * error, -self.reach, self.reach)
        middle = self.bounds.mean(0)
        wanted = reference + self._missed - self.gain @ middle
        self._input = np.clip(middle + np.linalg.pinv(self.gain) @ wanted, *self.bounds)
        return Command(self._input.copy())
