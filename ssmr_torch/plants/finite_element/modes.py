"""Linear modes of a `FiniteElementRobot` at rest: frequencies, and eigenvalues in continuous time and of one step."""

from __future__ import annotations

import numpy as np
from scipy.sparse import diags_array
from scipy.sparse.linalg import LinearOperator, eigs, eigsh, splu


def undamped_frequencies(robot, count: int = 5) -> np.ndarray:
    """The lowest ω of K_w φ = ω² M φ, (count,) rad/s, with the warped stiffness K_w."""
    structure = robot.structure
    stiffness = structure.sparsity.matrix(structure.warped_stiffness(robot.resting))
    squares = eigsh(stiffness, count, M=diags_array(structure.mass).tocsc(), sigma=0.0, return_eigenvectors=False,
                    v0=np.ones(structure.sparsity.size))
    return np.sqrt(np.sort(squares))


def continuous_eigenvalues(robot, count: int = 8) -> np.ndarray:
    """The slowest λ with det(λ² M + λ D + K) = 0, (count,) 1/s, slowest first, under the lowest inputs.

    The search is for the λ nearest to the lowest undamped frequency σ > 0. Around zero, the many rates near −1/β would
    be found before the slow oscillations.
    """
    structure, shift = robot.structure, undamped_frequencies(robot, 1)[0]
    at, n = structure.linearization(robot.resting, robot.input_bounds[0]), structure.sparsity.size
    factor = splu((at.stiffness + shift * at.damping + diags_array(shift ** 2 * at.mass)).tocsc())

    def inverse(state):
        moved, speed = state[:n], state[n:]
        first = -factor.solve(at.mass * (speed + shift * moved) + at.damping @ moved)
        return np.concatenate([first, moved + shift * first])

    return _slowest_first(shift + 1 / _largest(inverse, 2 * n, count))


def step_map_eigenvalues(robot, count: int = 8) -> np.ndarray:
    """ln(μ)/h of the slowest eigenvalues μ of one backward Euler step at rest, (count,) 1/s, slowest first.

    The step is linearized exactly: with the exact tangent in its force, and the warped stiffness in its matrix,

        S δv₊ = S δv − h (K δq + (h + β) K_w δv + α M δv),  δq₊ = δq + h δv₊,  S = (1 + hα) M + h (h + β) K_w.

    Raises ValueError for a robot with another scheme.
    """
    structure, h = robot.structure, robot.timestep
    mechanics, n, positions = structure.mechanics, structure.sparsity.size, robot.resting
    if mechanics.law != "corotational":
        raise ValueError(f"the robot has the law {mechanics.law}; expected a robot with scheme=backward_euler")
    tangent = structure.tangent(positions, robot.input_bounds[0])
    warped = structure.sparsity.matrix(structure.warped_stiffness(positions))
    lag = h + mechanics.stiffness_damping
    factor = splu((h * lag * warped + diags_array((1 + h * mechanics.mass_damping) * structure.mass)).tocsc())

    def step(state):
        moved, speed = state[:n], state[n:]
        force = tangent @ moved + lag * (warped @ speed) + mechanics.mass_damping * structure.mass * speed
        speed = speed - h * factor.solve(force)
        return np.concatenate([moved + h * speed, speed])

    return _slowest_first(np.log(_largest(step, 2 * n, count)) / h)


def _largest(operator, size: int, count: int) -> np.ndarray:
    """The eigenvalues of largest modulus, with their conjugates. A fixed start makes the result reproducible."""
    found = eigs(LinearOperator((size, size), operator), count, which="LM", v0=np.ones(size),
                 ncv=min(size - 1, max(60, 4 * count)), return_eigenvectors=False)
    return found.astype(np.complex128)


def _slowest_first(rates: np.ndarray) -> np.ndarray:
    return rates[np.lexsort((rates.imag, np.abs(rates.imag), -rates.real))]
