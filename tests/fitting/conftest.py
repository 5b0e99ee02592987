"""A robot whose reduced model is known exactly, and what would be measured of it."""

import numpy as np
import pytest
import torch

from ssmr_torch.models.integrators import rk4_step
from ssmr_torch.trajectory import Trajectory, TrajectoryDataset

REACH = 0.02


class KnownModel:
    """dz/dt = A z - γ |z|² z + (B + [D_1 z, D_2 z]) u,  y = V z + W (z_1², z_1 z_2, z_2²),  with Vᵀ W = 0.

    n = 2, m = 2, p = 4, γ > 0, lengths in m. The drift is odd and decays come in pairs ±z, so that the two leading
    directions of the decays' observations span V, exactly.
    """

    def __init__(self):
        rng = np.random.default_rng(5)
        self.A = np.array([[-1.0, 12.0], [-12.0, -1.2]])
        self.gamma = 4e3
        self.B = np.array([[0.10, -0.04], [0.03, 0.12]])
        self.D = rng.uniform(-2, 2, (2, 2, 2))
        frame = np.linalg.qr(rng.normal(size=(4, 4))).Q
        self.V, self.W = frame[:, :2], frame[:, 2:] @ rng.uniform(-8, 8, (2, 3))

    def drift(self, z):
        return z @ self.A.T - self.gamma * (z**2).sum(-1, keepdims=True) * z

    def control_field(self, z):
        """(..., n, m)."""
        return self.B + np.stack([z @ D.T for D in self.D], axis=-1)

    def observe(self, z):
        products = np.stack([z[..., 0]**2, z[..., 0] * z[..., 1], z[..., 1]**2], axis=-1)
        return z @ self.V.T + products @ self.W.T

    def simulate(self, start, inputs, timestep, finest=2e-4):
        """Observations (N, T, p) from starts (N, n) under held inputs (N, T, m), integrated in steps of `finest` s."""
        states = [start]
        for k in range(inputs.shape[1] - 1):
            u = inputs[:, k]
            states.append(rk4_step(lambda z: self.drift(z) + (self.control_field(z) @ u[..., None])[..., 0],
                                   states[-1], timestep, max(round(timestep / finest), 1)))
        return self.observe(np.stack(states, axis=1))

    def runs(self, kind, start, inputs, timestep, finest=2e-4, **labels):
        time = timestep * np.arange(inputs.shape[1])
        return [Trajectory(time, y, u, kind, name=f"{kind}-{index}", **labels)
                for index, (y, u) in enumerate(zip(self.simulate(start, inputs, timestep, finest), inputs))]

    def decays(self, timestep, duration=1.0, pairs=4, **options):
        angle = 2.5 * np.arange(pairs)
        start = REACH * np.linspace(0.6, 1.0, pairs)[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        start = np.concatenate([start, -start])
        samples = round(duration / timestep) + 1
        return self.runs("decay", start, np.zeros((2 * pairs, samples, 2)), timestep, **options)

    def held_runs(self, timestep, duration=1.0, count=8, **options):
        """Each under one input that is held throughout: everything is smooth in time."""
        rng = np.random.default_rng(6)
        start = REACH * rng.uniform(-0.7, 0.7, (count, 2))
        samples = round(duration / timestep) + 1
        inputs = np.repeat(rng.uniform(-1, 1, (count, 1, 2)), samples, axis=1)
        return self.runs("controlled", start, inputs, timestep, **options)

    def excited_runs(self, timestep, duration=2.0, count=3, seed=7, **options):
        """From rest, under inputs that change at random every 50 ms."""
        samples, hold = round(duration / timestep) + 1, max(round(0.05 / timestep), 1)
        levels = np.random.default_rng(seed).uniform(-1, 1, (count, -(-samples // hold), 2))
        inputs = np.repeat(levels, hold, axis=1)[:, :samples]
        return self.runs("controlled", np.zeros((count, 2)), inputs, timestep, **options)

    def dataset(self, timestep=0.01):
        """Decays and excited runs for training, one of each for the test."""
        runs = [*self.decays(timestep, finest=1e-3), *self.excited_runs(timestep, finest=1e-3),
                *self.excited_runs(timestep, count=1, seed=8, finest=1e-3, split="test")]
        return TrajectoryDataset(runs, np.zeros(4), ("a", "b", "c", "d"), ("u", "v"), provenance={"source": "known"})

    @torch.no_grad()
    def errors(self, model):
        """Relative errors of drift, control field and outputs of an SSMR over the training range.

        The model's coordinates are those of the truth up to the rotation T = (chart) V.
        """
        z = REACH * np.random.default_rng(9).uniform(-0.7, 0.7, (200, 2))
        T = model.chart[:, :4].numpy() @ self.V
        there = torch.from_numpy(z @ T.T)
        pairs = {"drift": (model.reduced.drift(there), self.drift(z) @ T.T),
                 "control": (model.reduced.control_field(there), T @ self.control_field(z)),
                 "outputs": (model.decode(there), self.observe(z))}
        return {name: np.linalg.norm(found.numpy() - true) / np.linalg.norm(true)
                for name, (found, true) in pairs.items()}


@pytest.fixture(scope="session")
def known():
    return KnownModel()
