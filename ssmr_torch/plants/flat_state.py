"""A plant whose whole state is one vector: what every such plant does alike."""

from __future__ import annotations

from abc import abstractmethod

import numpy as np

from ssmr_torch.plants.base import PlantSheet, finite_vector


class FlatStatePlant(PlantSheet):
    """x⁺ = advance(x, u), y = observe(x) − observe(x_rest), with u held for one timestep and clipped to the bounds.

    A subclass sets what `Plant` names, calls `_settle` with the state at rest, and gives `_advance` and `_observe`;
    both are functions of their arguments alone, so nothing else has to be saved. Nothing is random: seeds have no
    effect.
    """

    @abstractmethod
    def _advance(self, state: np.ndarray, u: np.ndarray) -> np.ndarray:
        """The state (n,) one timestep later, u (m,) within the bounds."""

    @abstractmethod
    def _observe(self, state: np.ndarray) -> np.ndarray:
        """(p,), where the observed points are, m."""

    def _settle(self, resting: np.ndarray) -> None:
        self._resting = np.array(resting, dtype=np.float64)
        self._state = self._resting.copy()
        self.rest = self._observe(self._resting)

    @property
    def state(self) -> np.ndarray:
        return self._state.copy()

    @property
    def displacement(self) -> np.ndarray:
        return self._observe(self._state) - self.rest

    def reset(self, seed: int | None = None, state: np.ndarray | None = None) -> np.ndarray:
        """Go to `state` (default: rest); nothing here is random, so `seed` has no effect."""
        self._state = self._resting.copy() if state is None else finite_vector(state, self._resting.size, "state")
        return self.displacement

    def step(self, input: np.ndarray) -> np.ndarray:
        """Hold the inputs (m,) for one timestep, clipped to the bounds; a misfit raises ValueError."""
        u = np.clip(finite_vector(input, len(self.input_names), "input"), *self.input_bounds)
        state = self._advance(self._state, u)
        if not np.isfinite(state).all():
            raise ValueError(f"{self.name} diverged under the inputs {u.tolist()} {self.input_unit}; the state before "
                             "the step stands; expected finite motion: lower the inputs or the timestep")
        self._state = state
        return self.displacement


def step_map_eigenvalues(plant: FlatStatePlant, count: int, share: float = 1e-6) -> np.ndarray:
    """(count,) of the linearization at rest, 1/s, slowest decay first: log of those of the step map over the timestep.

    The step map is differenced centrally, each state moved by `share` of its unit.
    """
    rest, still = plant._resting, np.clip(0.0, *plant.input_bounds)
    columns = [(plant._advance(rest + shift, still) - plant._advance(rest - shift, still)) / (2 * share)
               for shift in share * np.eye(rest.size)]
    factors = np.linalg.eigvals(np.stack(columns, axis=1)).astype(complex)
    rates = np.log(factors[np.abs(factors) > 1e-9]) / plant.timestep
    return rates[np.argsort(-rates.real)][:count]
