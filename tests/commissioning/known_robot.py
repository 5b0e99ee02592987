"""An exactly linear robot: two inputs, three outputs, and whatever can be wrong with it."""

import numpy as np
from scipy.linalg import expm

A = np.zeros((4, 4))
A[:2, :2], A[2:, 2:] = [[-3.0, 12.5], [-12.5, -3.0]], [[-3.6, 15.0], [-15.0, -3.6]]
B = 0.01 * np.array([[30.0, 0.0], [10.0, 0.0], [0.0, 40.0], [0.0, 12.0]])
C = np.array([[1.0, 0.2, 0.05, 0.0], [0.0, 0.05, 1.0, 0.1], [0.25, -0.3, 0.2, 0.1]])


class KnownRobot:
    """dx/dt = A x + B u(t − delay), y = C x + noise; left moves x, right moves y.

    wiring: (2, 2), from commands to what the robot feels: a permutation, a sign or a dead channel.   bounds: of both.
    lost: numbers of the samples that are NaN.   wild: number of the sample from which on the outputs are absurd.
    drift: m per sample.
    """

    name, timestep, input_unit = "known robot", 0.01, "1"
    output_names, input_names = ("x", "y", "z"), ("left", "right")
    rest = np.array([0.0, 0.0, 0.1])

    def __init__(self, wiring=((1, 0), (0, 1)), noise=2e-5, delay=0, bounds=(-1.0, 1.0), lost=(), wild=None, drift=0.0):
        self.input_bounds = np.tile(np.array(bounds, dtype=float)[:, None], 2)
        self.wiring, self.noise, self.delay, self.lost, self.wild = np.array(wiring, float), noise, delay, lost, wild
        self.drift = drift
        whole = expm(self.timestep * np.block([[A, B], [np.zeros((2, 6))]]))
        self._step = whole[:4, :4], whole[:4, 4:]
        self.parameters = {"bounds": list(bounds), "noise": noise, "delay": delay}
        self.commands, self.resets = [], 0
        self._start()

    def _start(self):
        self._x, self._k = np.zeros(4), 0
        self._queue = [np.clip(np.zeros(2), *self.input_bounds)] * self.delay

    @property
    def state(self):
        return self._x.copy()

    @property
    def displacement(self):
        return C @ self._x

    def reset(self, seed=None, state=None):
        self._rng = np.random.default_rng(seed)
        self._start()
        self.resets += 1
        return self._seen()

    def _seen(self):
        if self._k in self.lost:
            return np.full(3, np.nan)
        y = C @ self._x + self.noise * self._rng.standard_normal(3) + self.drift * self._k
        return y if self.wild is None or self._k < self.wild else 100.0 * y + 1.0

    def step(self, input):
        u = np.clip(np.asarray(input, dtype=float), *self.input_bounds)
        self.commands.append(u)
        self._queue.append(u)
        self._x = self._step[0] @ self._x + self._step[1] @ (self.wiring @ self._queue.pop(0))
        self._k += 1
        return self._seen()
