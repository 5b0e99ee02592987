"""Replay of a finite-element robot with the inputs of training data, and its linearized equations along the replay.

The results depend only on the robot and the inputs, so that all fits of a search share them.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.linalg import expm
from tqdm import tqdm

from ssmr_torch.plants.finite_element.robot import FiniteElementRobot


class Snapshots(NamedTuple):
    """States of the plant, and its states one step later: displacements from rest and velocities of the free degrees of
    freedom, (S, N), m and m/s; inputs (S, m), N, held in between; outputs (S, p), m.
    """

    displacement: np.ndarray
    velocity: np.ndarray
    input: np.ndarray
    output: np.ndarray
    next_displacement: np.ndarray
    next_velocity: np.ndarray


class Projection(NamedTuple):
    """Matrices of the plant at a displacement and tensions (m,), N, by Galerkin projection on r directions.

    displacement: (r,), m, projected.   mass, stiffness K, warped K_w: (r, r).   input_matrix: (r, m).
    residual: (r,), N, the remaining force without damping.
    """

    displacement: np.ndarray
    input: np.ndarray
    mass: np.ndarray
    stiffness: np.ndarray
    warped: np.ndarray
    input_matrix: np.ndarray
    residual: np.ndarray

    @classmethod
    def of(cls, plant: FiniteElementRobot, displacement: np.ndarray, input: np.ndarray,
           basis: np.ndarray) -> Projection:
        """displacement: of the free degrees of freedom (N,) m from rest; basis: (N, r)."""
        structure, sparsity = plant.structure, plant.structure.sparsity
        positions = sparsity.scatter(sparsity.gather(plant.resting) + displacement, plant.resting)
        inputs = structure.cables.input_matrix(positions)[sparsity.order].reshape(sparsity.size, -1)
        warped = sparsity.matrix(structure.warped_stiffness(positions))
        return cls(basis.T @ displacement, input, basis.T @ (structure.mass[:, None] * basis),
                   basis.T @ (structure.tangent(positions, input) @ basis), basis.T @ (warped @ basis),
                   basis.T @ inputs, basis.T @ structure.forces(positions, input))

    def leading(self, size: int) -> Projection:
        """The projection on only the first `size` directions."""
        mass, stiffness, warped = (square[:size, :size] for square in (self.mass, self.stiffness, self.warped))
        return Projection(self.displacement[:size], self.input, mass, stiffness, warped, self.input_matrix[:size],
                          self.residual[:size])


def linearized_step(plant: FiniteElementRobot, at: Projection) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A (2r, 2r), B (2r, m), c (2r,) of z⁺ = A z + B u + c, z = [q̃, ṽ], the plant's step linearized at q_i, u_i.

    For plants that step by backward Euler, with the tangent K, the warped stiffness K_w and D = α M + β K_w,

        (M + h D + h² K_w) Δv = h [r − K (q − q_i) + H (u − u_i) − (D + h K_w) v],   v⁺ = v + Δv,   q⁺ = q + h v⁺;

    for the others the exact flow of M q̈ + D q̇ + K (q − q_i) = r + H (u − u_i) over h with the input held.
    """
    mechanics, h, r = plant.structure.mechanics, plant.timestep, len(at.displacement)
    damping = mechanics.mass_damping * at.mass + mechanics.stiffness_damping * at.warped
    offset = at.residual + at.stiffness @ at.displacement - at.input_matrix @ at.input
    rates = np.column_stack([-at.stiffness, -damping, at.input_matrix, offset])
    if mechanics.law == "corotational":
        rates[:, r:2 * r] -= h * at.warped
        velocity = np.linalg.solve(at.mass + h * damping + h ** 2 * at.warped, h * rates)
        velocity[:, r:2 * r] += np.eye(r)
        step = np.vstack([h * velocity, velocity])
        step[:r, :r] += np.eye(r)
    else:
        generator = np.zeros((rates.shape[1], rates.shape[1]))
        generator[:r, r:2 * r] = np.eye(r)
        generator[r:2 * r] = np.linalg.solve(at.mass, rates)
        step = expm(h * generator)[:2 * r]
    return step[:, :2 * r], step[:, 2 * r:-1], step[:, -1]


class Replay:
    """A plant that is simulated from rest with the inputs of each run, (T_k, m), N.

    outputs: (Σ T, p), m, at every sample.   snapshots: at most the requested number, evenly spaced, because full states
    are large.   plant: the simulated plant, whose equations `projection` uses.
    """

    def __init__(self, plant: FiniteElementRobot, runs: Sequence[np.ndarray], snapshots: int, progress: bool = False):
        self.plant = plant
        samples = sum(len(run) for run in runs)
        every, seen, rows, outputs = max(-(-samples // snapshots), 1), 0, [], []
        with tqdm(total=samples, desc="replay", unit=" samples", disable=not progress) as bar:
            for run in runs:
                plant.reset()
                for u in run:
                    outputs.append(plant.displacement)
                    before = self._state() if seen % every == 0 else None
                    plant.step(u)
                    if before:
                        rows.append((*before, u, outputs[-1], *self._state()))
                    seen += 1
                bar.update(len(run))
        self.outputs = np.stack(outputs)
        self.snapshots = Snapshots(*(np.stack(column) for column in zip(*rows)))
        self._projections: dict[int, Projection] = {}

    @cached_property
    def directions(self) -> tuple[np.ndarray, np.ndarray]:
        """Singular values of the displacements, and their directions (·, N), orthonormal in the Euclidean sense."""
        return np.linalg.svd(self.snapshots.displacement, full_matrices=False)[1:]

    def projection(self, index: int, size: int) -> Projection:
        """Projection at a snapshot on the first `size` directions. A stored projection on more directions is reused."""
        kept = self._projections.get(index)
        if kept is None or len(kept.displacement) < size:
            seen = self.snapshots
            kept = Projection.of(self.plant, seen.displacement[index], seen.input[index], self.directions[1][:size].T)
            self._projections[index] = kept
        return kept.leading(size)

    def _state(self) -> tuple[np.ndarray, np.ndarray]:
        plant, sparsity = self.plant, self.plant.structure.sparsity
        velocities = plant.state[plant.positions.size:][:sparsity.size]
        return sparsity.gather(plant.positions - plant.resting), velocities


_latest: dict[str, Replay] = {}


def replayed(plant: FiniteElementRobot, runs: Sequence[np.ndarray], snapshots: int, progress: bool = False) -> Replay:
    """A `Replay`; the latest one is reused if it has the same robot, inputs and snapshots.

    A robot is recognized by its `parameters` and `origin`. A robot without parameters is simulated every time.
    """
    if not hasattr(plant, "parameters"):
        return Replay(plant, runs, snapshots, progress)
    made = [plant.name, plant.parameters, plant.origin, snapshots, [len(run) for run in runs]]
    content = hashlib.sha256(json.dumps(made, sort_keys=True).encode())
    for run in runs:
        content.update(np.ascontiguousarray(run, dtype=np.float64))
    key = content.hexdigest()
    if key not in _latest:
        _latest.clear()  # before the new one, so that only one must fit into memory
        _latest[key] = Replay(plant, runs, snapshots, progress)
    return _latest[key]
