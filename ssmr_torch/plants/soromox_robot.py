"""Base class of robots with soromox's equations: integration, and the state at rest.

Building and compiling such a robot takes about ten seconds, so that it is done once per process and set of physical
parameters.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import numpy as np

from ssmr_torch.extras import require
from ssmr_torch.periods import whole_multiple
from ssmr_torch.plants.flat_state import FlatStatePlant

IMPLICIT = 1 - np.sqrt(0.5)  # γ of the method
NEWTON_STEPS = 2
NUMERICAL = ("timestep", "substep", "input_bounds")  # parameters that do not belong to soromox's model


class Compiled(NamedTuple):
    """force(q, v, u): (n,), the force that accelerates the robot, M(q) v̇ = force.   observe(q): (p,) m.

    flow(state, u, h, substeps): the state after this number of substeps of h s.   stiffness: (n, n), springs only.
    """

    force: Callable
    flow: Callable
    observe: Callable
    stiffness: np.ndarray


class SoromoxRobot(FlatStatePlant):
    """M(q) v̇ = A(q, p) − c(q, v) − K (q − q₀) − D v,   q̇ = v,   lag ṗ = u − p,   of soromox (Stölzle et al., 2026).

    The integrator is the L-stable implicit Runge-Kutta method of order two with two stages (Alexander, SIAM J. Numer.
    Anal. 14, 1977), because shear and stretch are much stiffer than bending; p is exact. Each stage takes two Newton
    steps. Their Jacobian holds the springs and dampers, which are linear, but not gravity and inertia. state: q, v, and
    p where there is a lag. JAX is set to double precision for the whole process.
    """

    ENGINE = ("_compiled",)

    def _start(self, parameters: dict, substep: float, lag: float) -> None:
        """The last call of every constructor. lag: s, of the inputs; 0 for none."""
        require("soromox")
        self.parameters, self._lag = parameters, float(lag)
        self.substeps = whole_multiple("timestep", self.timestep, "substep", substep)
        self._build()
        resting = self._equilibrium()
        pressures = np.zeros(len(self.input_names)) if lag else []
        self._settle(np.concatenate([resting, np.zeros_like(resting), pressures]))

    def _build(self) -> None:
        physical = repr(sorted((name, value) for name, value in self.parameters.items() if name not in NUMERICAL))
        self._compiled = _compiled(type(self), physical, self._lag, _Recipe(self.robot, self.places))

    @abstractmethod
    def robot(self):
        """soromox's model, made from `parameters`."""

    @abstractmethod
    def places(self, robot, q):
        """(p,) m, the positions of the observed points of soromox's model, as a function on JAX arrays."""

    def force(self, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Generalized force (n,) that accelerates the robot at the shape q, velocity v and pressures u."""
        return np.array(self._compiled.force(q, v, u))

    def _equilibrium(self) -> np.ndarray:
        """The shape at rest, by Newton's method with the stiffness of the springs, from the unloaded shape."""
        still, q = np.zeros(len(self.input_names)), np.zeros(len(self._compiled.stiffness))
        for _ in range(200):
            step = np.linalg.solve(self._compiled.stiffness, self.force(q, np.zeros_like(q), still))
            q = q + step
            if np.abs(step).max() <= 1e-15 * (1 + np.abs(q).max()):
                break
        return q

    def _flow(self, state: np.ndarray, u: np.ndarray, substeps: int) -> np.ndarray:
        return np.array(self._compiled.flow(state, u, self.timestep / self.substeps, substeps))

    def _observe(self, state: np.ndarray) -> np.ndarray:
        return np.array(self._compiled.observe(state[:len(self._compiled.stiffness)]))


class _Recipe:
    """Functions that are passed to a cached function without being part of its key."""

    def __init__(self, robot: Callable, places: Callable):
        self.robot, self.places = robot, places

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Recipe)

    def __hash__(self) -> int:
        return 0


@cache
def _compiled(kind: type, physical: str, lag: float, recipe: _Recipe) -> Compiled:
    import jax
    import jax.numpy as jnp

    jax.config.update("jax_enable_x64", True)
    robot = recipe.robot()
    size = robot.num_coordinates
    stiffness, damping = robot.stiffness_matrix(), robot.damping_matrix(jnp.zeros(size))

    def terms(q, v, p):
        mass, inertial, gravity = robot.dynamics_terms(q, v)
        return mass, (robot.actuation_force(q, p, qd=v) - inertial - gravity - robot.elastic_force(q) - damping @ v)

    def stage(q, v, p, guess, h):
        """Acceleration a with M(q + γ h (v + γ h a)) a = force there, and the shape there."""
        newton = damping * (IMPLICIT * h) + stiffness * (IMPLICIT * h) ** 2

        def improved(_, a):
            speed = v + IMPLICIT * h * a
            mass, force = terms(q + IMPLICIT * h * speed, speed, p)
            return a + jnp.linalg.solve(mass + newton, force - mass @ a)
        a = jax.lax.fori_loop(0, NEWTON_STEPS, improved, guess)
        speed = v + IMPLICIT * h * a
        return a, speed, q + IMPLICIT * h * speed

    def later(p, u, time):
        return u + (p - u) * jnp.exp(-time / lag) if lag else u

    def substep(u, h, state):
        q, v, p = state[:size], state[size:2 * size], state[2 * size:]
        first, v1, q1 = stage(q, v, later(p, u, IMPLICIT * h), jnp.zeros(size), h)
        rest = (1 - IMPLICIT) * h
        _, v2, q2 = stage(q + rest * v1, v + rest * first, later(p, u, h), first, h)
        return jnp.concatenate([q2, v2, later(p, u, h) if lag else p])

    def flow(state, u, h, count):
        return jax.lax.fori_loop(0, count, lambda _, x: substep(u, h, x), state)

    return Compiled(jax.jit(lambda q, v, u: terms(q, v, u)[1]), jax.jit(flow),
                    jax.jit(lambda q: recipe.places(robot, q)), np.array(stiffness))
