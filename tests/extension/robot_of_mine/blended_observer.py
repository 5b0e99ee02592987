"""An observer of one's own: what the model expects, moved a share of the way to what the chart sees."""

import numpy as np

from ssmr_torch.control.chart_estimator import ChartEstimator
from ssmr_torch.periods import whole_steps


class BlendedObserver:
    """z ← f(z, u) + share (v(window) − f(z, u)); where the window is not finite, the model alone.

    model: at the timestep of the measurements. input_range: (m,), of no use here.
    """

    def __init__(self, model, input_range, *, share: float = 0.5):
        self.model, self.share = model, share
        self._chart = ChartEstimator(model, whole_steps("window_timestep", model.window_timestep, model.timestep))
        self.reset()

    def reset(self) -> None:
        self._chart.reset()
        self._z = None

    def measure(self, observation, last_input) -> None:
        self._chart.measure(observation, last_input)
        seen = self._chart.state()[0]
        expected = seen if self._z is None else self.model.step(self._z, last_input)
        self._z = expected + self.share * (seen - expected) if np.isfinite(seen).all() else expected

    def state(self):
        return self._z, None, None
