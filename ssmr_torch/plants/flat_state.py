"""Base class of plants whose whole state is one vector."""

from __future__ import annotations

from abc import abstractmethod

import numpy as np

from ssmr_torch.plants.base import PlantSheet, finite_vector

SLOWEST = 12
DIFFERENCE = 1e-6                     # of a state, in its unit
LEAST_FACTOR, LEAST_RATE = 1e-9, 1e-2  # 1, 1/s


class FlatStatePlant(PlantSheet):
    """x⁺ = flow(x, u), y = observe(x) − observe(x_rest), with u held for one timestep and clipped to the bounds.

    A subclass sets the attributes of `Plant` and `substeps`, the number of parts of a timestep. It gives `_flow` and
    `_observe`, which depend only on their arguments, so that the state is all that has to be saved. It calls `_settle`
    with the state at rest. Nothing is random: seeds have no effect. Where another package simulates, `_build` makes its
    objects, which are named in `ENGINE`; copies and parallel processes build their own.
    """

    ENGINE: tuple[str, ...] = ()

    def _build(self) -> None:
        """Set the attributes in `ENGINE` from `parameters`."""

    def __getstate__(self) -> dict:
        return {name: value for name, value in vars(self).items() if name not in self.ENGINE}

    def __setstate__(self, settings: dict) -> None:
        vars(self).update(settings)
        self._build()

    @abstractmethod
    def _flow(self, state: np.ndarray, u: np.ndarray, substeps: int) -> np.ndarray:
        """The state (n,) after this number of substeps, with u (m,) within the bounds."""

    @abstractmethod
    def _observe(self, state: np.ndarray) -> np.ndarray:
        """(p,) m, the positions of the observed points."""

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
        """Go to `state` (default: rest). `seed` has no effect, because nothing is random."""
        self._state = self._resting.copy() if state is None else finite_vector(state, self._resting.size, "state")
        return self.displacement

    def step(self, input: np.ndarray) -> np.ndarray:
        """Hold the inputs (m,) for one timestep, clipped to the bounds. Raises ValueError for a wrong size."""
        u = np.clip(finite_vector(input, len(self.input_names), "input"), *self.input_bounds)
        state = self._flow(self._state, u, self.substeps)
        if not np.isfinite(state).all():
            raise ValueError(f"{self.name} diverged under the inputs {u.tolist()} {self.input_unit}; the robot keeps "
                             "the state before this step. Lower the inputs or the timestep")
        self._state = state
        return self.displacement

    @property
    def eigenvalues(self) -> np.ndarray:
        """(12,) 1/s, of the map over one substep, linearized at rest by central differences, slowest first.

        Eigenvalues that belong to no motion are left out: of states that one step forgets completely, and of states
        that it never changes, such as a frame that is not quite orthonormal.
        """
        rest, still = self._resting, np.clip(0.0, *self.input_bounds)
        columns = [(self._flow(rest + shift, still, 1) - self._flow(rest - shift, still, 1)) / (2 * DIFFERENCE)
                   for shift in DIFFERENCE * np.eye(rest.size)]
        factors = np.linalg.eigvals(np.stack(columns, axis=1)).astype(complex)
        rates = np.log(factors[np.abs(factors) > LEAST_FACTOR]) * self.substeps / self.timestep
        rates = rates[np.abs(rates) > LEAST_RATE]
        return rates[np.argsort(np.abs(rates), kind="stable")][:SLOWEST]
