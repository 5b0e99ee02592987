"""A robot of two modes under held inputs, exact at every instant, so that two clocks can be told apart."""

import numpy as np
from scipy.linalg import expm

A = np.zeros((4, 4))
A[:2, :2], A[2:, 2:] = [[-1.5, 12.5], [-12.5, -1.5]], [[-1.8, 15.0], [-15.0, -1.8]]
B = np.array([[30.0, 5.0], [10.0, -20.0], [-8.0, 40.0], [25.0, 12.0]])
C = np.array([[1.0, 0.2, 0.3, -0.1], [-0.2, 0.9, 0.1, 0.6], [0.25, -0.3, 0.2, 0.1]])
FINE = 0.001  # s


def commands(seconds, seed=0, hold=0.12):
    """Times (J,) s at which commands begin, and the commands (J, 2)."""
    random = np.random.default_rng(seed)
    times = np.arange(0.0, seconds, hold)
    return times, 2 * random.uniform(-1, 1, (len(times), 2))


def motion(times, held, seconds, step=0.01, noise=0.02, seed=1):
    """Times (T,) s and outputs (T, 3) mm of the robot under commands that are held from their times."""
    whole = expm(FINE * np.block([[A, B], [np.zeros((2, 6))]]))
    fine = FINE * np.arange(round(seconds / FINE))
    acting = held[np.clip(np.searchsorted(times, fine + 1e-9, side="right") - 1, 0, None)]
    x, states = np.zeros(4), []
    for value in acting:
        states.append(x)
        x = whole[:4, :4] @ x + whole[:4, 4:] @ value
    every = round(step / FINE)
    y = np.array(states)[::every] @ C.T
    return fine[::every], y + noise * np.random.default_rng(seed).normal(size=y.shape)
