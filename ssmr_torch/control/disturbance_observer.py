"""The observer of a designed controller: fixed gains from recordings, with a restart when it has lost the state."""

from __future__ import annotations

from collections import Counter

import numpy as np

from ssmr_torch.control.chart_estimator import ChartEstimator
from ssmr_torch.control.model_step import Stepper
from ssmr_torch.control.outlier_gate import InnovationGate
from ssmr_torch.periods import whole_steps

BEYOND = 1.2      # times the recorded range: a state beyond it that also mispredicts is lost
STRANGE = 10      # samples in a row in which it must be so
PATIENCE = 50     # more samples in a row, if it did not come back after a restart
FAR = 3.0         # times the recorded range: a state beyond it is always lost
SETTLING = 10.0   # s in which the model comes to rest


class DisturbanceObserver:
    """An `Estimator` of the reduced state z and of a disturbance d of every output, from measurements y:

        z⁻ = f(z, v),   e = y − w(z⁻) − d,   z⁺ = z⁻ + K_z e,   d⁺ = d + K_d e,   |d| ≤ limit.

    v is the input that acts on the robot. At first the robot is assumed to be at rest under the present v. What the
    model does not explain in the first complete measurement is given to d and not to z, so that a payload does not put
    the state where there are no data.
    Outliers are left out, see `InnovationGate`. After a sample that is missing (not finite), it only predicts.
    A state outside the recorded range that also mispredicts, by more than `lost` in a watched output, is replaced by
    the chart of the last samples minus d. So is the first state after a gap in time. d is kept.

    model: NumPy tables at the timestep of the measurements.   gain: (n + p, p), [K_z; K_d].   covariance: (p, p) m², of
    the innovation.   limit: (p,) m.   lost: m.   watched: columns of y.   input_range is not needed.
    `counts`: numbers of "gated" samples and of "observer restarted". Raises ValueError for sizes that do not fit.
    """

    def __init__(self, model, input_range=None, *, gain, covariance, limit, lost: float, watched=None):
        self.model = model
        n, p = model.state_dim, model.output_dim
        self._gain = np.array(gain, dtype=np.float64, order="C")  # another order would round products differently
        self._precision = np.linalg.inv(np.array(covariance, dtype=np.float64, order="C"))
        self._limit = np.array(np.broadcast_to(np.asarray(limit, dtype=np.float64), (p,)))
        if self._gain.shape != (n + p, p) or self._precision.shape != (p, p):
            raise ValueError(f"the gain has shape {self._gain.shape} and the covariance {self._precision.shape}; "
                             f"expected ({n + p}, {p}) and ({p}, {p}) for a model of {n} states and {p} outputs")
        self._lost, self._watched = float(lost), list(range(p) if watched is None else watched)
        self._range = np.where(np.isfinite(model.state_scale) & (model.state_scale > 0), model.state_scale, np.inf)
        self._step = Stepper(model)
        self._chart = ChartEstimator(model, whole_steps("the model's window_timestep", model.window_timestep,
                                                        model.timestep))
        self._rest: tuple[bytes, np.ndarray, np.ndarray] | None = None  # the last rest, because finding it is slow
        self._gate = InnovationGate()
        self.reset()

    def reset(self) -> None:
        self.counts: Counter[str] = Counter()
        self._z, self._d = np.zeros(self.model.state_dim), np.zeros(self.model.output_dim)
        self._begun, self._unloaded = False, True
        self.forget()

    def forget(self) -> None:
        """Like `reset`, but counts and disturbance are kept: a payload is still there after a gap in time."""
        self._chart.reset()
        self._gate.reset()
        self._gap, self._strange = self._begun, 0

    def rest(self, acting: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """State and output of the model at rest under v (m,); of the chart at zero if the model leaves its range."""
        key = np.asarray(acting, dtype=np.float64).tobytes()
        if self._rest is None or self._rest[0] != key:
            window = np.zeros((self.model.delays + 1, self.model.output_dim))
            start = self.model.encode(window, np.tile(acting, (self.model.delays, 1)))
            z, y = start, self.model.decode(start)
            with np.errstate(over="ignore", invalid="ignore"):
                for _ in range(round(SETTLING / self.model.timestep)):
                    z, y = self._step(z, acting)
            if not self._inside(z):
                z = np.clip(start, -self._range, self._range)
                y = self.model.decode(z)
            self._rest = key, z, y
        return self._rest[1:]

    def _inside(self, z: np.ndarray) -> bool:
        return bool(np.isfinite(z).all() and (np.abs(z) <= BEYOND * self._range).all())

    def measure(self, observation: np.ndarray, last_input: np.ndarray) -> None:
        z, predicted = self._step(self._z, last_input) if self._begun else self.rest(last_input)
        self._z, self._begun = z.copy(), True
        whole = bool(np.isfinite(observation).all())
        if whole and self._unloaded:
            self._d, self._unloaded = np.clip(observation - predicted, -self._limit, self._limit), False
        elif whole and not self._gap:
            self._update(observation - predicted - self._d)
        self._chart.measure(observation - self._d, last_input)
        if self._gap and whole:
            self._gap = False
            self._from_chart()
        elif self._strange > STRANGE or not (np.abs(self._z) <= FAR * self._range).all():
            self.counts["observer restarted"] += self._from_chart()

    def _update(self, error: np.ndarray) -> None:
        if not self._gate.passes(float(error @ self._precision @ error) / len(error)):
            self.counts["gated"] += 1
            self._strange = self._strange + 1 if not self._inside(self._z) else 0
            return
        n, correction = len(self._z), self._gain @ error
        self._z = self._z + correction[:n]
        self._d = np.minimum(np.maximum(self._d + correction[n:], -self._limit), self._limit)
        mispredicts = np.abs(error[self._watched]).max() > self._lost
        self._strange = self._strange + 1 if mispredicts and not self._inside(self._z) else 0

    def _from_chart(self) -> bool:
        """Take the state from the chart, if the chart has one; returns whether it has."""
        z, _, _ = self._chart.state()
        known = bool(np.isfinite(z).all())
        if known:
            self._z, self._strange = np.clip(z, -self._range, self._range), -PATIENCE
            self._gate.reset()
        return known

    def state(self) -> tuple[np.ndarray, None, np.ndarray]:
        return self._z.copy(), None, self._d.copy()
