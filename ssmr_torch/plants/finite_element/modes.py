"""Linear modes of a robot: undamped frequencies, and the eigenvalues of its map from one sample to the next."""

from __future__ import annotations

import numpy as np
from scipy.sparse import diags_array
from scipy.sparse.linalg import LinearOperator, eigs, eigsh, splu

from ssmr_torch.plants.finite_element.robot import FiniteElementRobot


def undamped_frequencies(robot: FiniteElementRobot, count: int = 5) -> np.ndarray:
    """The lowest ω of K φ = ω² M φ, (count,) rad/s; K the warped stiffness at the robot's present configuration."""
    structure = robot.structure
    stiffness = structure.sparsity.matrix(structure.warped_stiffness(robot.positions))
    squares = eigsh(stiffness, count, M=diags_array(structure.mass).tocsc(), sigma=0.0, return_eigenvectors=False)
    return np.sqrt(np.sort(squares))


def step_map_eigenvalues(robot: FiniteElementRobot, count: int = 8) -> np.ndarray:
    """ln(μ)/h of the slowest eigenvalues μ of the backward Euler step at rest, (count,) 1/s, slowest first.

    The step is linearized exactly: its force with the exact tangent, its matrix with the warped one,

        S δv₊ = S δv − h (K δq + (h + β) K_w δv + α M δv),  δq₊ = δq + h δv₊,  S = (1 + hα) M + h (h + β) K_w.

    Raises ValueError for a robot of another scheme.
    """
    structure, h = robot.structure, robot.timestep
    mechanics, n = structure.mechanics, structure.sparsity.size
    if mechanics.law != "corotational":
        raise ValueError(f"the robot steps with the {mechanics.law} law; the step map of backward_euler is meant")
    tangent = structure.tangent(robot.positions, robot.input_bounds[0])
    warped = structure.sparsity.matrix(structure.warped_stiffness(robot.positions))
    lag = h + mechanics.stiffness_damping
    matrix = (h * lag * warped + diags_array((1 + h * mechanics.mass_damping) * structure.mass)).tocsc()
    factor = splu(matrix)

    def step(state):
        moved, speed = state[:n], state[n:]
        force = tangent @ moved + lag * (warped @ speed) + mechanics.mass_damping * structure.mass * speed
        speed = speed - h * factor.solve(force)
        return np.concatenate([moved + h * speed, speed])

    start = np.random.default_rng(0).standard_normal(2 * n)
    found = eigs(LinearOperator((2 * n, 2 * n), step), count, which="LM", v0=start, ncv=max(60, 4 * count),
                 return_eigenvectors=False)
    rates = np.log(found) / h
    return rates[np.lexsort((rates.imag, np.abs(rates.imag), -rates.real))]
