"""A plant of one's own: a mass on a spring that hardens, pulled by three cables in the plane."""

import numpy as np

from ssmr_torch.models.integrators import rk4_step
from ssmr_torch.plants.base import PlantSheet, finite_vector, input_range

ANGLES = np.deg2rad([90.0, 210.0, 330.0])
CABLES = np.stack([np.cos(ANGLES), np.sin(ANGLES)])


class SprungMass(PlantSheet):
    """m q̈ = −(k + k₃ ‖q‖²) q − c q̇ + CABLES · u,   y = q (2,) m, state [q, q̇].

    mass: kg. stiffness k: N/m. hardening k₃: N/m³. damping c: N s/m. timestep: s. input_bounds: N.
    """

    def __init__(self, mass: float = 0.1, stiffness: float = 15.0, hardening: float = 5e3, damping: float = 0.4,
                 timestep: float = 0.01, input_bounds=(0.0, 0.5)):
        self.parameters = {"mass": mass, "stiffness": stiffness, "hardening": hardening, "damping": damping}
        self.name, self.timestep, self.input_unit = "sprung mass", float(timestep), "N"
        self.output_names, self.input_names = ("x", "y"), ("north", "south-west", "south-east")
        self.input_bounds, self.rest = input_range(input_bounds, 3, "N"), np.zeros(2)
        self.reset()

    @property
    def state(self) -> np.ndarray:
        return self._state.copy()

    @property
    def displacement(self) -> np.ndarray:
        return self._state[:2].copy()

    def reset(self, seed: int | None = None, state=None) -> np.ndarray:
        self._state = np.zeros(4) if state is None else finite_vector(state, 4, "state")
        return self.displacement

    def step(self, input) -> np.ndarray:
        force = CABLES @ np.clip(finite_vector(input, 3, "input"), *self.input_bounds)
        self._state = rk4_step(lambda x: self._rate(x, force), self._state, self.timestep, substeps=2)
        return self.displacement

    def _rate(self, x: np.ndarray, force: np.ndarray) -> np.ndarray:
        of, q, v = self.parameters, x[:2], x[2:]
        spring = (of["stiffness"] + of["hardening"] * (q @ q)) * q
        return np.concatenate([v, (force - spring - of["damping"] * v) / of["mass"]])
