"""Finds the noises by the likelihood of the innovations on recorded runs, and the stationary observer for them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import solve_discrete_are
from scipy.optimize import minimize

from ssmr_torch.controller_design.model_choice import points_along
from ssmr_torch.controller_design.recordings import Recordings
from ssmr_torch.models.base import Model

SEGMENT, BURN_IN = 160, 60       # samples of a segment, and its first samples, whose innovations do not count
SEGMENTS = 48
EVALUATIONS = 110                # of the likelihood, per start
OUTLIER = 25.0                   # squared innovation per output, in variances; beyond it the cost is linear
FLOOR = 1e-4                     # of the reach: smallest noise of a sensor
LOWEST, HIGHEST = (1e-4, 1e-6, 1e-6, FLOOR), (1.0, 0.3, 0.1, 30 * FLOOR)
STARTS = ((0.03, 3e-3, 1e-3, 2 * FLOOR), (0.03, 3e-3, 1e-5, 10 * FLOOR), (3e-3, 3e-2, 1e-3, 5 * FLOOR),
          (0.3, 0.3, 1e-4, 5 * FLOOR))   # the last start suits a model that diverges without measurements
PRECISE = 80                     # evaluations of the later starts


@dataclass(frozen=True)
class Noises:
    """Standard deviations in the model of an `Observer`: inputs, as a share of half the input range; states, of their
    root mean square; disturbance and sensor, of the reach.
    """

    inputs: float
    states: float
    disturbance: float
    sensor: float

    def times(self, inputs: float = 1.0, states: float = 1.0, disturbance: float = 1.0, sensor: float = 1.0) -> Noises:
        """The same noises, each multiplied by a factor."""
        return Noises(self.inputs * inputs, self.states * states, self.disturbance * disturbance, self.sensor * sensor)


@dataclass(frozen=True, eq=False)
class Observer:
    """Stationary Kalman filter of z⁺ = f(z, v) + w, d⁺ = d + w_d, y = w(z) + d + noise, outputs in units of the reach.

    gain (n + p, p); covariance (p, p) of the innovation; process (n + p, n + p) of w and w_d; sensor (p, p) of the
    noise; n counts the states without the constant 1.
    """

    gain: np.ndarray
    covariance: np.ndarray
    process: np.ndarray
    sensor: np.ndarray


class Likelihood:
    """Likelihood of noises: many segments of the held-out runs are filtered at once, which gives the innovations.

    The filter is linearized at the mean of the recordings, because they need not contain the point zero. The cost of
    outliers grows only linearly, because dropped samples say nothing about the model. States that are the constant 1
    are not filtered.
    """

    def __init__(self, model: Model, acted: Recordings):
        self.model, self.acted = model, acted
        z, u = points_along(model, acted, 60)
        self.mean = z.mean(0), u.mean(0)
        self.scale = np.maximum(np.sqrt((z**2).mean(0)), 1e-9 * np.abs(z).max())
        constant = getattr(model, "constant_states", np.zeros(model.state_dim, dtype=bool))
        self.free = np.flatnonzero(~constant)
        self._segments()

    def _segments(self) -> None:
        d, model = self.model.delays, self.model
        starts = [(piece, k) for piece in self.acted.held
                  for k in range(d, len(piece.input) - SEGMENT - 1, SEGMENT // 2)]
        if not starts:
            shortest = min(len(piece.input) for piece in self.acted.held)
            raise ValueError(f"the held-out runs are {shortest} samples long; expected more than {SEGMENT + d + 1}, "
                             "which the estimate of the noises needs: record longer runs")
        starts = [starts[k] for k in np.unique(np.linspace(0, len(starts) - 1, SEGMENTS).astype(int))]
        windows = np.stack([piece.observation[k - d:k + 1] for piece, k in starts])
        past = np.stack([piece.input[k - d:k] for piece, k in starts])
        self.outputs = np.stack([piece.observation[k + 1:k + 1 + SEGMENT] for piece, k in starts])
        self.inputs = np.stack([piece.input[k:k + SEGMENT] for piece, k in starts])
        self.begin = model.encode(windows, past)

    @cached_property
    def linear(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """A (n', n'), B (n', m) per half of the input range, C (p, n') per reach, for the filtered states."""
        A, B, _ = self.model.linearize(*self.mean)
        C, _ = self.model.linearize_output(self.mean[0])
        free = self.free
        return A[np.ix_(free, free)], B[free] * 0.5 * self.acted.input_range, C[:, free] / self.acted.reach

    @cached_property
    def decoding(self) -> np.ndarray:
        """(p,) root mean square error of decoding the encoded window, as a share of the reach."""
        d, missed = self.model.delays, []
        for piece in self.acted.held:
            k = np.arange(d, len(piece.input), 5)
            back = k[:, None] + np.arange(-d, 1)
            z = self.model.encode(piece.observation[back], piece.input[back[:, :-1]])
            missed.append((self.model.decode(z) - piece.observation[k]) / self.acted.reach)
        return np.sqrt(np.square(np.concatenate(missed)).mean(0))

    def observer(self, noises: Noises) -> Observer:
        """The stationary observer for these noises. Raises LinAlgError where there is none."""
        A, B, C = self.linear
        p, n = C.shape
        process = np.zeros((n + p, n + p))
        process[:n, :n] = noises.inputs**2 * B @ B.T + np.diag((noises.states * self.scale[self.free])**2)
        process[n:, n:] = noises.disturbance**2 * np.eye(p)
        sensor = np.diag(noises.sensor**2 + self.decoding**2)
        G = np.eye(n + p)
        G[:n, :n] = A
        H = np.hstack([C, np.eye(p)])
        P = solve_discrete_are(G.T, H.T, process, sensor)
        S = H @ P @ H.T + sensor
        return Observer(np.linalg.solve(S, H @ P).T, S, process, sensor)

    def whole_gain(self, observer: Observer) -> np.ndarray:
        """(n + p, p) for all states of the model, zero for constant ones."""
        n, p = self.model.state_dim, self.model.output_dim
        gain = np.zeros((n + p, p))
        gain[self.free], gain[n:] = observer.gain[:-p], observer.gain[-p:]
        return gain

    def innovations(self, observer: Observer) -> np.ndarray:
        """Innovations (segments, SEGMENT − BURN_IN, p), as a share of the reach."""
        n, reach = self.model.state_dim, self.acted.reach
        z, d, found = self.begin, np.zeros((len(self.begin), self.model.output_dim)), []
        gain = self.whole_gain(observer)
        of_state, of_disturbance = gain[:n].T, gain[n:].T
        with np.errstate(over="ignore", invalid="ignore"):
            for k in range(SEGMENT):
                z = self.model.step(z, self.inputs[:, k])
                error = (self.outputs[:, k] - self.model.decode(z)) / reach - d
                z, d = z + error @ of_state, d + error @ of_disturbance
                if k >= BURN_IN:
                    found.append(error)
        return np.stack(found, axis=1)

    def cost(self, theta: np.ndarray) -> float:
        """Negative log-likelihood per sample; theta: logarithms of (inputs, states, disturbance, sensor)."""
        within = np.clip(theta, np.log(LOWEST), np.log(HIGHEST))
        try:
            observer = self.observer(Noises(*np.exp(within)))
        except (np.linalg.LinAlgError, ValueError):
            return 1e6
        e = self.innovations(observer).reshape(-1, self.model.output_dim)
        if not np.isfinite(e).all():
            return 1e6
        squared = np.einsum("ij,ij->i", e @ np.linalg.inv(observer.covariance), e)
        limit = OUTLIER * e.shape[1]
        squared = np.where(squared < limit, squared, 2.0 * np.sqrt(limit * squared) - limit)
        outside = np.square(theta - within).sum()
        return float(0.5 * (np.linalg.slogdet(observer.covariance)[1] + squared.mean()) + 1e-2 * outside)

    def most_likely(self, *, say: Callable[[str], None] = lambda line: None) -> Noises:
        """The most likely noises, by Nelder-Mead from several starts. A single start may end in a worse optimum."""
        def searched(start, evaluations):
            x = np.log(start)
            return minimize(self.cost, x, method="Nelder-Mead", options={
                "maxfev": evaluations, "xatol": 0.05, "fatol": 1e-3,
                "initial_simplex": np.vstack([x, x + 1.5 * np.eye(4)])})

        best = min((searched(start, PRECISE // 2) for start in STARTS), key=lambda found: found.fun)
        best = min([best, searched(np.exp(best.x), EVALUATIONS)], key=lambda found: found.fun)
        if best.fun >= 1e6:
            raise ValueError("no stationary observer follows the held-out runs: the model does not fit them. See its "
                             "held-out error, and choose another model or record longer")
        noises = Noises(*np.exp(np.clip(best.x, np.log(LOWEST), np.log(HIGHEST))).tolist())
        say(f"noises: inputs {noises.inputs:.3g} of half their range, states {noises.states:.3g}, disturbance "
            f"{noises.disturbance:.3g} and sensor {noises.sensor:.3g} of the reach "
            f"({1e3 * self.acted.reach * noises.sensor:.3g} mm)")
        return noises
