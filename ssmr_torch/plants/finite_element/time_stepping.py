"""Time stepping: the linearized backward Euler of the reference scheme, and two schemes of second order with Newton.

The order holds for inputs that vary smoothly. A jump of the tensions reduces it by one, as no scheme restarts there.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from ssmr_torch.plants.finite_element.linear_solvers import LinearSolver
from ssmr_torch.plants.finite_element.structure import Structure

NEWTON_ITERATIONS = 20
# Of the size of the forces. Newton's method reaches it in two or three iterations from the extrapolated state.
NEWTON_TOLERANCE = 1e-9


class State(NamedTuple):
    """positions: (N, 3) m.   velocities: (n,) m/s.   memory: (k, n), what else the scheme remembers."""

    positions: np.ndarray
    velocities: np.ndarray
    memory: np.ndarray


class Scheme(Protocol):
    memory_rows: int

    def start(self, structure: Structure, positions: np.ndarray, velocities: np.ndarray, tensions: np.ndarray,
              timestep: float) -> State:
        """The state for this motion under these tensions, with the memory that the scheme needs."""

    def step(self, structure: Structure, solver: LinearSolver, state: State, tensions: np.ndarray,
             timestep: float) -> State:
        """The state one timestep (s) later, with tensions (m,) in N held. Raises DivergenceError."""


class DivergenceError(ValueError):
    """A step has no trustworthy result. The robot keeps the state before it."""


class BackwardEuler:
    """One linear solve per step: [(1 + hα) M + h (h + β) K] Δv = h [M g + H(q) u − f(q) − (h + β) K v − α M v],

    then v += Δv, q += h v; K is the law's tangent and H the cable directions at the start of the step. First order:
    at h = 0.01 s it adds about 45 % to the damping of a mode at 16 rad/s. It is the scheme of the paper's plants.
    """

    memory_rows = 0

    def start(self, structure, positions, velocities, tensions, timestep):
        return State(positions, velocities, np.empty((0, len(velocities))))

    def step(self, structure, solver, state, tensions, timestep):
        mass_damping, lag = structure.mechanics.mass_damping, timestep + structure.mechanics.stiffness_damping
        sparsity, stiffness = structure.sparsity, structure.zeros()
        force = structure.forces(state.positions, tensions, stiffness)
        force -= lag * (sparsity.matrix(stiffness) @ state.velocities)
        force -= mass_damping * structure.mass * state.velocities
        stiffness *= timestep * lag
        stiffness[sparsity.diagonal] += (1 + timestep * mass_damping) * structure.mass
        velocities = state.velocities + solver.solve(stiffness, timestep * force)
        positions = state.positions.copy()
        positions[sparsity.order] += timestep * velocities.reshape(-1, 3)
        return State(positions, velocities, state.memory)


class GeneralizedAlpha:
    """Chung and Hulbert's scheme, second order (J. Appl. Mech. 60, 1993). ρ: spectral radius at infinite frequency.

        M a_m + C v_f + f(q_f) = M g + H(q_f) u,   x_f = (1 − α_f) x₊ + α_f x,   a_m = (1 − α_m) a₊ + α_m a,
        α_m = (2ρ − 1)/(ρ + 1),  α_f = ρ/(ρ + 1),  γ = ½ − α_m + α_f,  β = ¼ (1 − α_m + α_f)².

    C is taken at the extrapolated q + (1 − α_f) h v.   Memory: the acceleration.
    """

    memory_rows = 1

    def __init__(self, radius: float = 0.8):
        if not 0 <= radius <= 1:
            raise ValueError(f"the spectral radius is {radius}; expected 0 to 1")
        self.alpha_m, self.alpha_f = (2 * radius - 1) / (radius + 1), radius / (radius + 1)
        self.gamma = 0.5 - self.alpha_m + self.alpha_f
        self.beta = 0.25 * (1 - self.alpha_m + self.alpha_f) ** 2

    def start(self, structure, positions, velocities, tensions, timestep):
        return State(positions, velocities, _acceleration(structure, positions, velocities, tensions)[None])

    def step(self, structure, solver, state, tensions, timestep):
        h, (a,), v = timestep, state.memory, state.velocities
        m, f = 1 - self.alpha_m, 1 - self.alpha_f
        moved = h * v + h * h * (0.5 - self.beta) * a
        sped = h * (1 - self.gamma) * a
        found = _newton(structure, solver, state.positions, tensions,
                        inertia=(m, self.alpha_m * a), velocity=(f * self.gamma * h, v + f * sped),
                        displacement=(f * self.beta * h * h, f * moved), extrapolated=f * h * v)
        velocities = v + sped + h * self.gamma * found
        positions = _displaced(structure, state.positions, moved + h * h * self.beta * found)
        return State(positions, velocities, found[None])


class BDF2:
    """Second-order backward differences: (3 x₊ − 4 x + x₋) / (2h) of q and v at the end of the step; L-stable.

    Memory: displacement and velocity one step before, relative to the present ones.
    """

    memory_rows = 2

    def start(self, structure, positions, velocities, tensions, timestep):
        a = _acceleration(structure, positions, velocities, tensions)
        return State(positions, velocities, np.stack([-timestep * velocities + 0.5 * timestep ** 2 * a, -timestep * a]))

    def step(self, structure, solver, state, tensions, timestep):
        h, v, (moved_before, sped_before) = 2 * timestep / 3, state.velocities, state.memory
        found = _newton(structure, solver, state.positions, tensions,
                        inertia=(1 / h, (sped_before / 3 - v) / h), velocity=(1.0, np.zeros_like(v)),
                        displacement=(h, -moved_before / 3), extrapolated=timestep * v)
        step = h * found - moved_before / 3
        return State(_displaced(structure, state.positions, step), found, np.stack([-step, v - found]))


SCHEMES = {"backward_euler": BackwardEuler, "generalized_alpha": GeneralizedAlpha, "bdf2": BDF2}


def _acceleration(structure: Structure, positions, velocities, tensions) -> np.ndarray:
    force = structure.forces(positions, tensions)
    damping = structure.sparsity.matrix(structure.warped_stiffness(positions)) @ velocities
    return ((force - structure.mechanics.stiffness_damping * damping) / structure.mass
            - structure.mechanics.mass_damping * velocities)


def _displaced(structure: Structure, positions: np.ndarray, displacement: np.ndarray) -> np.ndarray:
    moved = positions.copy()
    moved[structure.sparsity.order] += displacement.reshape(-1, 3)
    return moved


def _newton(structure, solver, positions, tensions, inertia, velocity, displacement, extrapolated):
    """x with M a + C v + f(q) = M g + H(q) u, where a, v and q − positions are each factor · x + offset.

    A step that does not lower the residual is halved. Raises DivergenceError when the tolerance is not reached.
    """
    sparsity, mechanics = structure.sparsity, structure.mechanics
    damping = structure.warped_stiffness(_displaced(structure, positions, extrapolated))
    damping *= mechanics.stiffness_damping
    damping[sparsity.diagonal] += mechanics.mass_damping * structure.mass
    damper = sparsity.matrix(damping)

    def residual(x, stiffness=None):
        force = structure.forces(_displaced(structure, positions, displacement[0] * x + displacement[1]), tensions,
                                 stiffness)
        inertial = structure.mass * (inertia[0] * x + inertia[1])
        return inertial + damper @ (velocity[0] * x + velocity[1]) - force, np.linalg.norm(inertial)

    x = (extrapolated - displacement[1]) / displacement[0]
    floor = NEWTON_TOLERANCE * structure.weight + structure.rounding
    for _ in range(NEWTON_ITERATIONS):
        tangent = structure.zeros()
        left, inertial = residual(x, tangent)
        size = np.linalg.norm(left)
        tolerance = floor + NEWTON_TOLERANCE * inertial
        if size <= tolerance:
            return x
        tangent *= displacement[0]
        tangent += velocity[0] * damping
        tangent[sparsity.diagonal] += inertia[0] * structure.mass
        direction = solver.solve(tangent, -left)
        fraction = 1.0
        while not np.linalg.norm(residual(x + fraction * direction)[0]) < size:
            fraction /= 2
            if fraction < 1e-4:
                raise DivergenceError(f"Newton's method cannot lower the residual of {size:.3g} N, expected "
                                      f"{tolerance:.3g} N; lower the inputs or the timestep")
        x = x + fraction * direction
    raise DivergenceError(f"Newton's method left a residual of {size:.3g} N after {NEWTON_ITERATIONS} iterations; "
                          "lower the inputs or the timestep")
