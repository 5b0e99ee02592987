"""A soft Cosserat rod with signed forces at its tip, simulated by PyElastica."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ssmr_torch.checked_arguments import checked
from ssmr_torch.extras import require
from ssmr_torch.periods import whole_multiple
from ssmr_torch.plants.base import input_range
from ssmr_torch.plants.flat_state import FlatStatePlant
from ssmr_torch.quantities import INPUT_BOUNDS, TIMESTEP
from ssmr_torch.ranges import Number, Whole

GRAVITY = 9.81  # m/s²
OUTPUTS = ("tip_x", "tip_y", "tip_z", "middle_x", "middle_y", "middle_z")
STATE = ("position_collection", "director_collection", "velocity_collection", "omega_collection")


class CosseratRod(FlatStatePlant):
    """A rod that hangs from a clamp and may bend, twist, shear and stretch (Gazzola et al., 2018).

        ρA ∂v/∂t = ∂n/∂s + ρA g − c_t v + f δ(s − L),   ∂(ρI ω)/∂t = ∂m/∂s + r' × n − c_r ω + …,

    n = S (strain) and m = EI, GJ (curvature) in the frame of the section, with PyElastica's elements and position
    Verlet. f: (2,) N, horizontal, of either sign.

    elements: n.   length, radius: m.   density: kg/m³, of silicone.   young: Pa, of a soft silicone; the shear modulus
    is young / 3.   drag c_t: N s/m², damps all modes alike.   turning_drag c_r: N s, damps each mode by its slope
    squared, like the loss inside a silicone; both act as exact exponentials.   substep: s; the fastest shear mode
    allows 0.5 ms.   payload: kg, at the tip.   input_bounds: N, signed.   state: (18 n + 6,), positions (3, n + 1),
    frames of the sections (3, 3, n), velocities (3, n + 1), angular velocities (3, n).   Outputs: tip and middle, z
    up, from the clamp.   Needs the extra `robots`.
    """

    name, input_unit, ENGINE = "Cosserat rod", "N", ("_simulator", "_rod", "_stepper", "_force")
    output_names, input_names = OUTPUTS, ("force_x", "force_y")

    @checked(elements=Whole(2, 1000), length=Number(1e-4, 100.0, "m"), radius=Number(1e-4, 100.0, "m"),
             density=Number(1e-2, 1e5, "kg/m³"), young=Number(1.0, 1e13, "Pa"), drag=Number(0.0, 1e6),
             turning_drag=Number(0.0, 1e6), timestep=TIMESTEP, input_bounds=INPUT_BOUNDS,
             substep=Number(1e-6, 1.0, "s"), gravity=Number(-1e3, 1e3, "m/s²"), payload=Number(0.0, 1e4, "kg"))
    def __init__(self, *, elements: int = 20, length: float = 0.2, radius: float = 0.01, density: float = 1070.0,
                 young: float = 3e5, drag: float = 1.0, turning_drag: float = 0.006, timestep: float = 0.01,
                 substep: float = 2.5e-4, input_bounds: Sequence = (-0.15, 0.15), gravity: float = GRAVITY,
                 payload: float = 0.0):
        require("elastica")
        if not (elements >= 2 and elements % 2 == 0 and min(length, radius, density, young, drag, turning_drag) > 0):
            raise ValueError(f"elements is {elements}, length {length} m, radius {radius} m, density {density} kg/m³, "
                             f"young {young} Pa, drag {drag} N s/m², turning_drag {turning_drag} N s; expected an even "
                             "number of elements and positive values")
        if not 0 <= payload < np.inf:
            raise ValueError(f"payload is {payload} kg; expected 0 or more")
        self.timestep = float(timestep)
        self.substeps = whole_multiple("timestep", timestep, "substep", substep)
        self.input_bounds = input_range(input_bounds, len(self.input_names), self.input_unit)
        self.parameters = {"elements": elements, "length": length, "radius": radius, "density": density,
                           "young": young, "drag": drag, "turning_drag": turning_drag, "timestep": timestep,
                           "substep": substep, "input_bounds": self.input_bounds.tolist(), "gravity": gravity,
                           "payload": payload}
        self._build()
        self._settle(self._hanging())

    def _build(self) -> None:
        import elastica

        class Simulator(elastica.BaseSystemCollection, elastica.Constraints, elastica.Forcing, elastica.Damping):
            pass

        class TipForce(elastica.NoForces):
            def __init__(self, force: np.ndarray):
                self.force = force

            def apply_forces(self, system, time=0.0):
                system.external_forces[:2, -1] += self.force

        of, self._force = self.parameters, np.zeros(2)
        element = of["length"] / of["elements"]
        self._simulator, self._stepper = Simulator(), elastica.PositionVerlet()
        self._rod = elastica.CosseratRod.straight_rod(
            of["elements"], np.zeros(3), np.array([0.0, 0.0, -1.0]), np.array([1.0, 0.0, 0.0]), of["length"],
            of["radius"], of["density"], youngs_modulus=of["young"], shear_modulus=of["young"] / 3)
        self._rod.mass[-1] += of["payload"]
        self._simulator.append(self._rod)
        self._simulator.constrain(self._rod).using(
            elastica.OneEndFixedBC, constrained_position_idx=(0,), constrained_director_idx=(0,))
        self._simulator.add_forcing_to(self._rod).using(
            elastica.GravityForces, acc_gravity=np.array([0.0, 0.0, -of["gravity"]]))
        self._simulator.add_forcing_to(self._rod).using(TipForce, self._force)
        self._simulator.dampen(self._rod).using(
            elastica.AnalyticalLinearDamper, translational_damping_constant=of["drag"] * element,
            rotational_damping_constant=of["turning_drag"] * element, time_step=of["substep"])
        self._simulator.finalize()

    def _hanging(self) -> np.ndarray:
        """The rod at rest: each element carries the weight N below it, S (e − 1) / e = N with the stretch e."""
        rod = self._rod
        below = np.cumsum(rod.mass[:0:-1])[::-1] * self.parameters["gravity"]
        stretch = 1 / (1 - below / rod.shear_matrix[2, 2])
        position = np.zeros_like(rod.position_collection)
        position[2, 1:] = -np.cumsum(stretch * rod.rest_lengths)
        still = [np.zeros_like(getattr(rod, name)) for name in STATE[2:]]
        return np.concatenate([part.ravel() for part in (position, rod.director_collection, *still)])

    def _flow(self, state: np.ndarray, u: np.ndarray, substeps: int) -> np.ndarray:
        self._force[:], substep = u, self.parameters["substep"]
        start = 0
        for name in STATE:
            part = getattr(self._rod, name)
            part[...] = state[start:start + part.size].reshape(part.shape)
            start += part.size
        for index in range(substeps):
            self._stepper.step(self._simulator, index * substep, substep)
        return np.concatenate([getattr(self._rod, name).ravel() for name in STATE])

    def _observe(self, state: np.ndarray) -> np.ndarray:
        nodes = state[:3 * (self.parameters["elements"] + 1)].reshape(3, -1)
        return np.concatenate([nodes[:, -1], nodes[:, nodes.shape[1] // 2]])
