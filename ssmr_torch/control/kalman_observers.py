"""Kalman observers in reduced coordinates: offset-free tracking with noisy and missing measurements."""

from __future__ import annotations

from collections import Counter

import numpy as np

from ssmr_torch.checked_arguments import checked
from ssmr_torch.control.chart_estimator import ChartEstimator
from ssmr_torch.control.outlier_gate import InnovationGate
from ssmr_torch.periods import whole_steps
from ssmr_torch.quantities import NOISE, TRUTH
from ssmr_torch.ranges import OneOf, OrNone

# If the norm of a state exceeds that of the training range by this factor, the filter restarts.
RANGE_FACTOR = 3.0
DISTURBANCES = ("none", "output", "input")


class KalmanObserver:
    """State of the reduced model and of a constant disturbance d, by a Kalman filter on

        z⁺ = f(z, u + E d) + w,   d⁺ = d + w_d,   y = w(z) + F d + v.

    disturbance: "output", F = I (an offset of every output); "input", F = 0 and E the min(m, p) input directions that
    move the robot most at rest (a payload, a wrong stiffness); or "none", the plain filter. With a disturbance, the
    filter integrates the prediction error, so that no steady error remains [Pannocchia and Rawlings, AIChE J. 2003].
    extended: True linearizes at every measurement and updates the covariance (extended Kalman filter); False uses the
    stationary gain of the model at rest, from SciPy's Riccati equation.
    process_noise: standard deviation of w in a step, as a share of the range of the training states.
    disturbance_noise: of w_d, m for an output, a share of the input range for an input. measurement_noise: of v, m.

    model: NumPy tables at the timestep of the measurements. input_range (m,). A missing (not finite) value is left out
    of the update; the stationary filter leaves out the whole measurement. `missing` counts incomplete measurements. An
    outlier, by the covariance of its innovation, is left out as well and counted in `gated`, see `InnovationGate`. A
    state that is not finite, or far outside the training range, would spoil all later ones: the filter then restarts
    from the chart of the last samples, without a disturbance, and counts it in `restarts`.
    Raises ValueError for another disturbance or noise that is not positive, ImportError without SciPy.
    """

    @checked(disturbance=OneOf(*DISTURBANCES), extended=TRUTH, process_noise=NOISE, disturbance_noise=OrNone(NOISE),
             measurement_noise=NOISE)
    def __init__(self, model, input_range, *, disturbance: str = "output", extended: bool = False,
                 process_noise: float = 1e-3, disturbance_noise: float | None = None,
                 measurement_noise: float = 5e-5):
        if disturbance not in DISTURBANCES:
            raise ValueError(f"disturbance is {disturbance!r}; expected one of {DISTURBANCES}")
        disturbance_noise = {"none": 1.0, "output": 2e-4, "input": 5e-3}[disturbance] if disturbance_noise is None \
            else disturbance_noise
        if not (process_noise > 0 and disturbance_noise > 0 and measurement_noise > 0):
            raise ValueError(f"process_noise is {process_noise}, disturbance_noise {disturbance_noise} and "
                             f"measurement_noise {measurement_noise}; expected positive numbers")
        self.model, self.extended, self.disturbance = model, extended, disturbance
        self._chart = ChartEstimator(model, whole_steps("the model's window_timestep", model.window_timestep,
                                                        model.timestep))
        self._largest = RANGE_FACTOR * float(np.linalg.norm(model.state_scale))
        self._range = np.asarray(input_range, dtype=np.float64)
        m, p = model.input_dim, model.output_dim
        window = np.zeros((model.delays + 1, p))
        rest = model.encode(window, np.zeros((model.delays, m)))
        A, B, _ = model.linearize(rest, np.zeros(m))
        C, _ = model.linearize_output(rest)
        self._E, self._F = self._channels(A, B, C)
        q = self._E.shape[1]
        scale = np.where(np.isfinite(model.state_scale) & (model.state_scale > 0), model.state_scale, 1.0)
        noise = np.full(q, disturbance_noise)
        self._process = np.diag(np.concatenate([process_noise * scale, noise])**2)
        self._measurement = measurement_noise**2 * np.eye(p)
        self._start = self._process + np.diag(np.concatenate([(0.1 * scale)**2, (100 * noise)**2]))
        self._gate = InnovationGate()
        if not extended:
            self._gain, self._whitening = self._stationary(A, B, C)
        self.reset()

    def _channels(self, A, B, C) -> tuple[np.ndarray, np.ndarray]:
        """E (m, q) and F (p, q)."""
        m, p = B.shape[1], C.shape[0]
        if self.disturbance == "none":
            return np.zeros((m, 0)), np.zeros((p, 0))
        if self.disturbance == "output":
            return np.zeros((m, p)), np.eye(p)
        gain = C @ np.linalg.lstsq(np.eye(len(A)) - A, B * self._range, rcond=None)[0]
        _, sizes, directions = np.linalg.svd(gain)
        q = int((sizes > 1e-3 * sizes[0]).sum())
        return self._range[:, None] * directions[:q].T, np.zeros((p, q))

    def _transition(self, A: np.ndarray, B: np.ndarray) -> np.ndarray:
        """The matrix ∂(z⁺, d⁺)/∂(z, d)."""
        n = len(A)
        G = np.eye(n + self._E.shape[1])
        G[:n, :n], G[:n, n:] = A, B @ self._E
        return G

    def _stationary(self, A, B, C) -> tuple[np.ndarray, np.ndarray]:
        """The gain (n + q, p), and L⁻¹ (p, p) of the innovation's covariance S = L Lᵀ."""
        from scipy.linalg import solve_discrete_are  # only here: a robot without this observer needs no SciPy

        G, H = self._transition(A, B), np.hstack([C, self._F])
        P = solve_discrete_are(G.T, H.T, self._process, self._measurement)
        S = H @ P @ H.T + self._measurement
        return np.linalg.solve(S, H @ P).T, np.linalg.inv(np.linalg.cholesky(0.5 * (S + S.T)))

    def reset(self) -> None:
        self.missing, self.restarts, self.gated = 0, 0, 0
        self.forget()

    def forget(self) -> None:
        """Forget all measurements, but keep the counts."""
        self._begun = False
        self._chart.reset()
        self._gate.reset()

    @property
    def counts(self) -> Counter[str]:
        """Numbers of gated measurements, and of restarts from the chart."""
        return Counter({"gated": self.gated, "observer restarted": self.restarts})

    def measure(self, observation: np.ndarray, last_input: np.ndarray) -> None:
        """Predict and update as in `Estimator`; where the estimate is not plausible, restart from the chart."""
        whole = np.isfinite(observation)
        self.missing += not whole.all()
        if not self._begun:
            # The robot is assumed to have rested at this place, and missing values to be zero.
            self._chart.measure(np.where(whole, observation, 0.0), last_input)
            self._start_at(self._chart.state()[0])
            self._begun = True
            return
        self._chart.measure(observation, last_input)
        self._predict(last_input)
        self._update(observation, whole)
        if not self._believed(self._x):
            z, _, _ = self._chart.state()
            if self._believed(z):
                self._start_at(z)
                self.restarts += 1

    def _believed(self, x: np.ndarray) -> bool:
        return bool(np.isfinite(x).all() and np.linalg.norm(x[:self.model.state_dim]) <= self._largest)

    def _start_at(self, z: np.ndarray) -> None:
        self._x, self._P = np.concatenate([z, np.zeros(self._E.shape[1])]), self._start.copy()

    def _predict(self, last_input: np.ndarray) -> None:
        n = self.model.state_dim
        z, d = self._x[:n], self._x[n:]
        u = last_input + self._E @ d
        if not self.extended:
            self._x = np.concatenate([self.model.step(z, u), d])
            return
        A, B, c = self.model.linearize(z, u)
        G = self._transition(A, B)
        self._x = np.concatenate([A @ z + B @ u + c, d])
        self._P = G @ self._P @ G.T + self._process

    def _update(self, observation: np.ndarray, whole: np.ndarray) -> None:
        if not (whole.any() if self.extended else whole.all()):
            return
        n = self.model.state_dim
        z, d = self._x[:n], self._x[n:]
        error = observation - self.model.decode(z) - self._F @ d
        if not self.extended:
            if self._passes(self._whitening @ error, len(error)):
                self._x = self._x + self._gain @ error
            return
        C, _ = self.model.linearize_output(z)
        H = np.hstack([C, self._F])[whole]
        S = H @ self._P @ H.T + self._measurement[np.ix_(whole, whole)]
        if not self._passes(error[whole], len(S), S):
            return
        K = _solved(S, H @ self._P).T
        self._x = self._x + K @ error[whole]
        shrink = np.eye(len(self._x)) - K @ H
        self._P = shrink @ self._P @ shrink.T + K @ self._measurement[np.ix_(whole, whole)] @ K.T

    def _passes(self, error: np.ndarray, size: int, S: np.ndarray | None = None) -> bool:
        """Whether the innovation (size,) is no outlier. S: its covariance; None: the identity, for a white one."""
        distance = error @ (error if S is None else _solved(S, error)) / size
        passes = self._gate.passes(float(distance))
        self.gated += not passes and bool(np.isfinite(self._x).all())
        return passes

    def state(self) -> tuple[np.ndarray, np.ndarray | None, np.ndarray | None]:
        z, d = self._x[:self.model.state_dim].copy(), self._x[self.model.state_dim:]
        of_input, of_output = self.disturbance == "input", self.disturbance == "output"
        return z, self._E @ d if of_input else None, d.copy() if of_output else None


def _solved(S: np.ndarray, X: np.ndarray) -> np.ndarray:
    """S⁻¹ X; NaN where S is singular, as after values far out of range: the filter then restarts."""
    try:
        return np.linalg.solve(S, X)
    except np.linalg.LinAlgError:
        return np.full_like(X, np.nan)
