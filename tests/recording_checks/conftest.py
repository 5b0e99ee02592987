"""A robot of two linear modes whose recordings have a known noise, delay, drift, friction and neutral input."""

import numpy as np
import pytest
from scipy.linalg import expm

import ssmr_torch as ssmr

RATES = (-1.5 + 12.5j, -1.8 + 15.0j)  # 1/s
A = np.zeros((4, 4))
A[:2, :2], A[2:, 2:] = [[-1.5, 12.5], [-12.5, -1.5]], [[-1.8, 15.0], [-15.0, -1.8]]
B = np.array([[30.0, 5.0], [10.0, -20.0], [-8.0, 40.0], [25.0, 12.0]])
C = np.array([[1.0, 0.2, 0.3, -0.1], [-0.2, 0.9, 0.1, 0.6], [0.25, -0.3, 0.2, 0.1]])


def outputs(u, x, step):
    """(T, 3) mm, exact at the samples under held inputs."""
    whole = expm(step * np.block([[A, B], [np.zeros((2, 6))]]))
    y = []
    for held in u:
        y.append(C @ x)
        x = whole[:4, :4] @ x + whole[:4, 4:] @ held
    return np.array(y)


def held(rng, seconds, step, size=2.0, hold=0.12):
    every = max(1, round(hold / step))
    return np.repeat(size * rng.uniform(-1, 1, (round(seconds / hold) + 1, 2)), every, axis=0)[:round(seconds / step)]


@pytest.fixture
def robot():
    """recorded(noise=mm, …) → dataset: six decays of 3 s, three runs of 15 s and a test, 100 Hz, inputs of up to ±2.

    late: samples by which the inputs act late; drift: mm within each controlled run, in z; shift: added to the logged
    inputs; stretch: of the test's inputs; inputs: function (rng, s, step) in place of held random ones; loop: mm, that
    y lies further on the way up of the first input than on its way down; decays: how many; duration: s, of decays.
    """
    def recorded(noise=0.02, step=0.01, late=0, drift=0.0, shift=0.0, stretch=1.0, inputs=held, loop=0.0, decays=6,
                 duration=3.0, controlled=3, seconds=15.0, seed=0, test=True):
        rng = np.random.default_rng(seed)

        def run(u, x):
            acting = np.roll(u, late, axis=0)
            if late > 0:
                acting[:late] = 0.0
            y = outputs(acting, x, step) + noise * rng.normal(size=(len(u), 3))
            rising = np.convolve(np.sign(np.gradient(u[:, 0])), np.full(25, 0.04))[:len(u)]
            return y + 0.5 * loop * np.outer(rising, [1.0, 0.0, 0.0])

        free = [(step, run(np.zeros((round(duration / step), 2)), 12.0 * rng.normal(size=4)), np.zeros(
            (round(duration / step), 2))) for _ in range(decays)]
        driven = []
        for number in range(controlled + 1):
            u = inputs(rng, seconds, step) * (stretch if number == controlled else 1.0)
            y = run(u, np.zeros(4))
            if number < controlled:
                y = y + np.outer(np.linspace(0, drift, len(y)), [0.0, 0.0, 1.0])
            driven.append((step, y, u + shift))
        return ssmr.trajectories(decays=free, controlled=driven[:controlled], test=driven[controlled:] if test else [],
                                 output_names=("x", "y", "z"), input_names=("left", "right"),
                                 units={"length": "mm", "input": "1", "time": "s"})

    return recorded
