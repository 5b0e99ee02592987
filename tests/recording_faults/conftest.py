"""Recordings of a linear robot with two modes, one or two markers and two inputs: mm, 100 Hz, 0.02 mm of noise."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from ssmr_torch.recording_faults.recording import Recording

RATES = np.array([[-1.5, 12.5, 0, 0], [-12.5, -1.5, 0, 0], [0, 0, -1.8, 15], [0, 0, -15, -1.8]])
PUSH = np.array([[30, 5], [10, -20], [-8, 40], [25, 12.0]])
SEEN = np.array([[1, 0.2, 0.3, -0.1], [-0.2, 0.9, 0.1, 0.6], [0.25, -0.3, 0.2, 0.1],
                 [0.5, 0.3, 0.1, 0.2], [-0.1, 0.4, 0.3, 0.3], [0.1, -0.2, 0.4, 0.1]])
REST = np.array([5.0, -3.0, 120.0, 4.0, -2.0, 60.0])  # mm
NAMES = ("ax", "ay", "az", "bx", "by", "bz")


class Rig:
    """The recordings d1 … d6 (decays), c1 … c3 and test, by name, and the rest position, m."""

    def __init__(self, markers=1, noise=0.02, seed=0, inputs=None):
        self.names = NAMES[:3 * markers] if markers > 1 else ("x", "y", "z")
        self.rest = 1e-3 * REST[:3 * markers]
        system = np.zeros((6, 6))
        system[:4, :4], system[:4, 4:] = RATES, PUSH
        step, random = expm(0.01 * system), np.random.default_rng(seed)
        inputs = inputs or (lambda random: np.repeat(2 * random.uniform(-1, 1, (126, 2)), 12, axis=0)[:1500])
        self.runs = {}
        for name in ("d1", "d2", "d3", "d4", "d5", "d6", "c1", "c2", "c3", "test"):
            decay = name[0] == "d"
            u = np.zeros((300, 2)) if decay else inputs(random)
            x, states = random.normal(size=4) * 12 if decay else np.zeros(4), []
            for value in u:
                states.append(x)
                x = step[:4, :4] @ x + step[:4, 4:] @ value
            y = np.array(states) @ SEEN[:3 * markers].T
            y = 1e-3 * (y + noise * random.normal(size=y.shape)) + self.rest
            self.runs[name] = Recording(name, 0.01 * np.arange(len(u)), y, u, "decay" if decay else "controlled",
                                        "test" if name == "test" else "train", output_names=self.names)

    @property
    def recordings(self):
        return list(self.runs.values())

    def change(self, name, rows, values, columns=slice(None)):
        """Give the observations of a run other values, m."""
        y = self.runs[name].observation.copy()
        y[rows, columns] = values
        self.runs[name] = replace(self.runs[name], observation=y)

    def shift(self, name, away):
        """Add to the observations of a run, m."""
        self.runs[name] = replace(self.runs[name], observation=self.runs[name].observation + away)


@pytest.fixture
def rig():
    return Rig()


@pytest.fixture
def two_markers():
    return Rig(markers=2)


@pytest.fixture
def make_rig():
    return Rig
