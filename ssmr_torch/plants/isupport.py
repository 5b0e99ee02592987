"""The I-SUPPORT arm: two pneumatic sections, with the parameters that were identified on the real arm."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ssmr_torch.checked_arguments import checked
from ssmr_torch.plants.base import input_range
from ssmr_torch.plants.soromox_robot import SoromoxRobot
from ssmr_torch.quantities import INPUT_BOUNDS, TIMESTEP
from ssmr_torch.ranges import Number

# m, from the base to the tip: interface, section, interface, section, interface.
LENGTHS = (0.041, 0.180, 0.027, 0.180, 0.006)
RIGID = (True, False, True, False, True)
RADIUS = 0.030                                   # m, of the sections and the plates
INTERFACE_DENSITY = 1210.0                       # kg/m³, printed plastic
CHAMBER = {"inner": 6.39e-3, "outer": 7.79e-3, "distance": 20e-3}  # m
AZIMUTHS = np.pi / 2 + 2 * np.pi / 3 * np.arange(3)                # rad, of the chambers in both sections
GRAVITY = 9.81                                   # m/s², along the arm that hangs
OUTPUTS = ("tip_x", "tip_y", "tip_z", "middle_x", "middle_y", "middle_z")
INPUTS = tuple(f"{section}_chamber_{number}" for section in ("upper", "lower") for number in (1, 2, 3))


class ISupport(SoromoxRobot):
    """An arm of 434 mm that hangs: two sections that bend and stretch uniformly, each with three chambers that push.

    The equation is that of `SoromoxRobot`; a section neither shears nor twists. Each chamber is 20 mm away from the
    middle line and pushes with its pressure times π 6.39² mm². Masses, springs and dampers are soromox's; its example
    of this arm has the values identified on the real, printed arm (geometry: Alessi, Falotico, Lucantonio, IEEE Access
    11, 2023):

    young: Pa.   viscosity: Pa s.   density: kg/m³ of the walls of the chambers, with everything that moves with them.
    pressure_lag: s, of a low-pass at 2.8 Hz, identified as well.   input_bounds: Pa; when 3 bar were commanded, the
    real chambers held about 2.3.   state: (18,), strains, their rates and the pressures.   Outputs: end of each
    section, z down, from the base.
    Needs the extra `robots`.
    """

    name, input_unit = "I-SUPPORT", "Pa"
    output_names, input_names = OUTPUTS, INPUTS

    @checked(young=Number(1.0, 1e13, "Pa"), viscosity=Number(1e-3, 1e12, "Pa s"), density=Number(1e-2, 1e5, "kg/m³"),
             pressure_lag=Number(0.0, 100.0, "s"), timestep=TIMESTEP, input_bounds=INPUT_BOUNDS,
             substep=Number(1e-6, 1.0, "s"))
    def __init__(self, *, young: float = 1.0766e6, viscosity: float = 8.38e4, density: float = 6471.0,
                 pressure_lag: float = 1 / (2 * np.pi * 2.8), timestep: float = 0.01, substep: float = 0.005,
                 input_bounds: Sequence = (0.0, 2.6e5)):
        if not (min(young, viscosity, density) > 0 <= pressure_lag):
            raise ValueError(f"young is {young} Pa, viscosity {viscosity} Pa s, density {density} kg/m³, pressure_lag "
                             f"{pressure_lag} s; expected positive values, and a lag of 0 or more")
        self.timestep = float(timestep)
        self.input_bounds = input_range(input_bounds, len(INPUTS), self.input_unit)
        self._start({"young": young, "viscosity": viscosity, "density": density, "pressure_lag": pressure_lag,
                     "timestep": timestep, "substep": substep, "input_bounds": self.input_bounds.tolist()},
                    substep, pressure_lag)

    def robot(self):
        from soromox import systems
        from soromox.systems import components

        of, count, sections = self.parameters, len(LENGTHS), 2
        density = np.where(RIGID, INTERFACE_DENSITY, of["density"])
        straight = np.tile([0.0, 0.0, 0.0, 1.0, 0.0, 0.0], (count, 1))
        unset = np.tile(np.eye(6), (count, 1, 1))  # the springs follow from the material
        link = components.ContinuumLinkParams(
            length=np.array(LENGTHS), density=density, reference_strain=straight, stiffness=unset, damping=unset,
            cross_section=components.CrossSectionParams(coefficients=np.full((count, 1), RADIUS)))
        params = systems.ISupportParams(
            gravity=np.array([0.0, 0.0, GRAVITY]), link=link,
            chamber_inner_radius=np.full(sections, CHAMBER["inner"]),
            chamber_outer_radius=np.full(sections, CHAMBER["outer"]),
            chamber_distance=np.full(sections, CHAMBER["distance"]),
            chamber_azimuth_angles=np.tile(AZIMUTHS, (sections, 1)),
            chamber_effective_pressure_area=np.full(sections, np.pi * CHAMBER["inner"] ** 2))
        bending_and_stretch = np.tile([False, True, True, True, False, False], count)
        structure = systems.ISupportStructure(pcs_segment_counts=(1, 1), rigid_segment_selector=RIGID,
                                              strain_selector=bending_and_stretch, num_gauss_points=3)
        material = components.IsotropicMaterialParams(
            young_modulus=np.array(of["young"]), shear_modulus=np.array(of["young"] / 3),
            material_damping_coefficient=np.array(of["viscosity"]))
        return systems.ISupport(params=params, structure=structure).with_isotropic_material(material)

    def places(self, robot, q):
        import jax.numpy as jnp

        return jnp.concatenate([robot.forward_kinematics(q, end)[:3, 3] for end in (sum(LENGTHS), sum(LENGTHS[:2]))])
