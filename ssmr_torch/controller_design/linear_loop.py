"""The linear closed loop of robot, actuator, observer and unconstrained controller: margins and predicted error.

Outputs are in units of the reach, inputs in units of their range.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import solve_discrete_lyapunov

from ssmr_torch.control.actuator import Actuator
from ssmr_torch.controller_design.noises import Observer
from ssmr_torch.models.base import Model

FREQUENCIES = 12
LEAK = 0.9999      # of the disturbance per sample, so that the variance in the predicted error is finite


@dataclass(frozen=True)
class Weights:
    """tolerance: of tracking, share of the reach.   input, move: weights of v and of its changes, with v in units of
    the input range.   horizon: N samples after the delay.
    """

    horizon: int
    tolerance: float
    input: float
    move: float

    @property
    def output(self) -> float:
        return self.tolerance**-2


@dataclass(frozen=True)
class Margins:
    """The worst values over all points: spectral radii of the loop itself, with extra delay, with half and with twice
    the gain; and the largest singular value of the sensitivity S(e^{iωT}) of the tracked outputs.
    """

    nominal: float = 0.0
    delayed: float = 0.0
    halved: float = 0.0
    doubled: float = 0.0
    sensitivity: float = 0.0

    def worse(self, other: Margins) -> Margins:
        return Margins(*(max(a, b) for a, b in zip(self.values, other.values)))

    @property
    def values(self) -> tuple[float, ...]:
        return self.nominal, self.delayed, self.halved, self.doubled, self.sensitivity

    def shortfall(self, peak: float) -> float:
        """Less than one where all margins hold."""
        return max(self.nominal, self.delayed, self.halved, self.doubled, self.sensitivity / peak)


class Point:
    """The loop around one state z (n,) and acting input u (m,) of the recordings.

    States of the linear model: [z, x of the lag, the queue of the delay, oldest first]. Of z only the `free` states are
    used, without the constant 1. reach: m; input_range (m,); tracked: columns of the outputs.
    """

    def __init__(self, model: Model, actuator: Actuator, z, u, free, reach: float, input_range, tracked):
        A, B, _ = model.linearize(z, u)
        C, _ = model.linearize_output(z)
        A, B, C = A[np.ix_(free, free)], B[free] * input_range, C[:, free] / reach
        self.tracked, self.plain = list(tracked), (A, B, C)
        self.n, self.m, self.p = len(A), B.shape[1], len(C)
        self.A, self.B, self.C = _with_actuator(A, B, C, actuator)
        self._delay = actuator.delay
        self._gains: dict[Weights, np.ndarray] = {}

    @cached_property
    def of_acting(self) -> np.ndarray:
        """(N, m), the effect of noise in the acting inputs on the states."""
        out = np.zeros((len(self.A), self.m))
        out[:self.n] = self.plain[1]
        return out

    def gain(self, weights: Weights) -> np.ndarray:
        """K (m, N + p + m) of the unconstrained controller, v_0 = K [s, d, v_{−1}]."""
        if weights not in self._gains:
            self._gains[weights] = self._gain(weights)
        return self._gains[weights]

    def _gain(self, weights: Weights) -> np.ndarray:
        Y, Z = self._sensitivities(weights.horizon)
        N, m, q = weights.horizon, self.m, len(self.tracked)
        size = N * m
        D = np.eye(size) - np.eye(size, k=-m)
        F = np.tile(np.eye(self.p)[self.tracked], (len(Y) // q, 1))
        H = weights.output * Y.T @ Y + weights.move * D.T @ D + weights.input * np.eye(size)
        before = np.zeros((size, m))
        before[:m] = weights.move * np.eye(m)
        right = np.hstack([-weights.output * Y.T @ Z, -weights.output * Y.T @ F, before])
        return np.linalg.solve(H, right)[:m]

    def _sensitivities(self, horizon: int) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of the tracked outputs 1 … d + N by the inputs 0 … N − 1 and by the state; later inputs are zero.
        """
        steps, m = horizon + self._delay, self.m
        G, P = np.zeros((len(self.A), horizon * m)), np.eye(len(self.A))
        Y, Z, C = [], [], self.C[self.tracked]
        for k in range(steps):
            G, P = self.A @ G, self.A @ P
            if k < horizon:
                G[:, k * m:(k + 1) * m] += self.B
            Y.append(C @ G)
            Z.append(C @ P)
        return np.vstack(Y), np.vstack(Z)

    def loop(self, observer: Observer, weights: Weights, extra: int = 0, gain: float = 1.0):
        """Matrix of one sample for [robot with `extra` samples of delay, observer, last input]; C, K; and its rows."""
        n, p, m, N = self.n, self.p, self.m, len(self.A)
        Ap, Bp, Cp = _delayed(self.A, gain * self.B, self.C, extra)
        K = np.zeros((N + p, p))
        K[:n], K[N:] = observer.gain[:n], observer.gain[n:]
        G = np.eye(N + p)
        G[:N, :N] = self.A
        H = np.hstack([self.C, np.eye(p)])
        B = np.vstack([self.B, np.zeros((p, m))])
        robot, watch, last = slice(0, len(Ap)), slice(len(Ap), len(Ap) + N + p), slice(len(Ap) + N + p, None)
        T = np.zeros((len(Ap) + N + p + m,) * 2)
        keep = np.eye(N + p) - K @ H
        T[robot, robot], T[robot, last] = Ap, Bp
        T[watch, robot], T[watch, last], T[watch, watch] = K @ Cp @ Ap, keep @ B + K @ Cp @ Bp, keep @ G
        T[last, last] = np.eye(m)
        U = np.eye(len(T))
        U[last] = 0.0
        U[last, watch.start:] = self.gain(weights)
        return T @ U, Cp, K, watch

    def margins(self, observer: Observer, weights: Weights, extra: int) -> Margins:
        """The margins at this point. Where the loop itself is unstable, the others are not computed."""
        loop, Cp, K, watch = self.loop(observer, weights)
        nominal = _radius(loop)
        if nominal >= 1.0:
            return Margins(nominal, np.inf, np.inf, np.inf, np.inf)
        return Margins(nominal, _radius(self.loop(observer, weights, extra=extra)[0]),
                       _radius(self.loop(observer, weights, gain=0.5)[0]),
                       _radius(self.loop(observer, weights, gain=2.0)[0]), self._peak(loop, Cp, K, watch))

    def sensitivity(self, observer: Observer, weights: Weights, frequencies: np.ndarray) -> np.ndarray:
        """σ_max(S(e^{iω})) of the tracked outputs, (K,), at frequencies ω per sample."""
        loop, Cp, K, watch = self.loop(observer, weights)
        return self._largest(loop, Cp, K, watch, frequencies)

    def _peak(self, loop, Cp, K, watch) -> float:
        return float(self._largest(loop, Cp, K, watch, np.geomspace(0.02, 0.98 * np.pi, FREQUENCIES)).max())

    def _largest(self, loop, Cp, K, watch, frequencies) -> np.ndarray:
        noise, seen = np.zeros((len(loop), self.p)), np.zeros((len(self.tracked), len(loop)))
        noise[watch], seen[:, :Cp.shape[1]] = K, Cp[self.tracked]
        around = np.exp(1j * frequencies)
        answers = np.linalg.solve(around[:, None, None] * np.eye(len(loop)) - loop, noise * around[:, None, None])
        S = np.eye(len(self.tracked)) + (seen @ answers)[:, :, self.tracked]
        return np.linalg.svd(S, compute_uv=False)[:, 0]

    def predicted_variance(self, observer: Observer, truth: Observer, weights: Weights) -> float:
        """Variance of the tracked outputs under the noises of `truth`, by a Lyapunov equation; infinite if unstable."""
        n, p, N = self.n, self.p, len(self.A)
        loop, Cp, K, watch = self.loop(observer, weights)
        if _radius(loop) >= 1.0:
            return np.inf
        size = len(loop)
        whole = np.zeros((size + p, size + p))           # the robot's disturbance comes last
        whole[:size, :size], whole[size:, size:] = loop, LEAK * np.eye(p)
        whole[watch, size:] = LEAK * K
        enters = np.zeros((size + p, n + p))
        enters[:n, :n], enters[size:, n:] = np.eye(n), np.eye(p)
        enters[watch, :n], enters[watch, n:] = K @ self.C[:, :n], K
        measured = np.zeros((size + p, p))
        measured[watch] = K
        P = solve_discrete_lyapunov(whole, enters @ truth.process @ enters.T + measured @ truth.sensor @ measured.T)
        seen = np.zeros((len(self.tracked), size + p))
        seen[:, :N] = Cp[self.tracked][:, :N]
        seen[:, size:] = np.eye(p)[self.tracked]
        return float(np.trace(seen @ P @ seen.T))


def _with_actuator(A, B, C, actuator: Actuator):
    """The model of s = [z, x, queue] with the command v as input; the inputs of all parts are in the same unit."""
    n, m, d = len(A), B.shape[1], actuator.delay
    B = B * actuator.factor
    if actuator.share:
        lag = actuator.share * np.eye(m)
        A = np.block([[A, B @ lag], [np.zeros((m, n)), lag]])
        B = np.vstack([B, np.eye(m)]) * (1.0 - actuator.share)
        C = np.hstack([C, np.zeros((len(C), m))])
    return _delayed(A, B, C, d)


def _delayed(A, B, C, samples: int):
    if not samples:
        return A, B, C
    n, m = len(A), B.shape[1]
    longer = np.zeros((n + samples * m,) * 2)
    longer[:n, :n], longer[:n, n:n + m] = A, B
    longer[n:-m, n + m:] = np.eye((samples - 1) * m)
    enters = np.zeros((len(longer), m))
    enters[-m:] = np.eye(m)
    return longer, enters, np.hstack([C, np.zeros((len(C), samples * m))])


def _radius(matrix: np.ndarray) -> float:
    return float(np.abs(np.linalg.eigvals(matrix)).max()) if np.isfinite(matrix).all() else np.inf
