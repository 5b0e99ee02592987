"""Small systems whose models are known, as the runs and samples of a selection."""

from types import SimpleNamespace

import numpy as np
import pytest

from ssmr_torch.selection.folds_and_starts import Samples

TIMESTEP = 0.02


def held_inputs(seed, steps, inputs=2, hold=6, lowest=-0.5, highest=1.0):
    """(steps, m), redrawn every `hold` samples, about a mean that is not zero."""
    drawn = np.random.default_rng(seed).uniform(lowest, highest, (steps // hold + 1, inputs))
    return np.repeat(drawn, hold, axis=0)[:steps]


def run(step, u, start):
    """y_0 = start at rest, y_{k+1} = step(y_k, y_k − y_{k−1}, u_k, u_{k−1}), the input before the first one zero."""
    y, before, held = [np.array(start, dtype=float)], np.array(start, dtype=float), np.zeros(u.shape[1])
    for now in u[:-1]:
        y.append(step(y[-1], y[-1] - before, now, held))
        before, held = y[-2], now
    return np.array(y), u


def linear(y, d, u, held):
    """A damped oscillator in the plane: an autoregression of order two with one past input."""
    return (y + np.array([[0.86, 0.05], [-0.05, 0.83]]) @ d - np.array([[0.05, 0.01], [0.0, 0.08]]) @ y
            + 1e-3 * (np.array([[1.0, -0.4], [0.3, 0.8]]) @ u + np.array([[0.2, 0.1], [-0.1, 0.3]]) @ held))


def configuration_affine(y, d, u, held):
    """The same with a stiffness, a gain and a damping that depend on the configuration."""
    return (linear(y, d, u, held) - np.array([1.5 * y[0] * y[1], 2.0 * y[0] ** 2]) + 0.03 * u[0] * y[::-1]
            + np.array([3.0 * d[0] * y[1], 0.05 * d[1] * u[1]]))


def samples(step=linear, *, runs=3, seconds=8.0, decays=3, timestep=TIMESTEP, inputs=2, outputs=2, **more):
    """Runs of a system of as many outputs, from rest and, for decays, released without inputs."""
    steps, rng = round(seconds / timestep), np.random.default_rng(99)
    released = [run(step, np.zeros((steps // 2, inputs)), rng.uniform(-0.02, 0.02, outputs)) for _ in range(decays)]
    driven = [run(step, held_inputs(seed, steps, inputs), np.zeros(outputs)) for seed in range(runs)]
    return Samples(released, driven, timestep, **{"coordinates": {"identity": None}, "targets": range(outputs)} | more)


@pytest.fixture(scope="session")
def systems():
    return SimpleNamespace(held_inputs=held_inputs, run=run, linear=linear, samples=samples,
                           configuration_affine=configuration_affine, timestep=TIMESTEP)
