"""The planar robot of handed shearing auxetics, with the parameters that were identified on the real robot."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ssmr_torch.checked_arguments import checked
from ssmr_torch.plants.base import input_range
from ssmr_torch.plants.soromox_robot import SoromoxRobot
from ssmr_torch.quantities import INPUT_BOUNDS, TIMESTEP
from ssmr_torch.ranges import Number

RODS = 2                  # each stands for a pair of rods, one behind the other, that turn together
GRAVITY = (0.0, 9.81)     # m/s², y down
WIDTH = 80e-3             # m, of the platform
LARGEST_TWIST = 3.49      # rad, 200 deg; soromox stores it but does not apply it
GEOMETRY = {              # m, per segment
    "length": 59e-3, "proximal_cap_length": 25e-3, "distal_cap_length": 14e-3}
PER_ROD = {
    "rod_height": 1.0, "rod_outer_radius": 12.7e-3, "rod_inner_radius": 10.27e-3,  # handedness, m, m
    "strain_coupling": 0.00984819}                                                 # m/rad
PER_PAIR = {              # identified for one rod of polyurethane, doubled for the pair
    "rod_density": 798.38,                                                         # kg/m³
    "nominal_bending_stiffness": 5.71346377e-4, "nominal_shear_stiffness": 0.591462074,      # N m², N
    "nominal_axial_stiffness": 5.66472469, "bending_shear_stiffness": 4.48419541e-3,         # N, N m
    "bending_stiffness_correction": -9.67560524e-6, "shear_stiffness_correction": -4.75687961e-4,  # N m³/rad, N m/rad
    "axial_stiffness_correction": 0.01508165,                                      # N m/rad
    "bending_damping": 3e-5, "shear_damping": 2e-4, "axial_damping": 2e-2}         # N m² s, N s, N s
OUTPUTS = ("left_x", "left_y", "right_x", "right_y")


class PlanarHSA(SoromoxRobot):
    """A platform on rods. Motors twist the rods, which changes their length and stiffness; they bend and shear as well.

    The equation is that of `SoromoxRobot` with q: (3,), bending 1/m, shear and stretch of the middle line. The
    stiffness of the springs is affine in the twist, so that the inputs act by u, u² and u q. From the base down: caps
    of 25 mm, rods of 59 mm at ±24 mm, caps of 14 mm, a platform of 12 mm.

    Springs, masses and dampers: Stölzle, Rus, Della Santina, "An experimental study of model-based control for planar
    handed shearing auxetics robots", ISER 2023, as published with jsrm, which soromox follows. The dampers are those of
    its earlier parameter set. In the later set they are 15 to 25 times smaller, and the shear oscillates at 0.8 % of
    critical damping.

    payload: kg, below the platform, such as a gripper; our choice, which puts the slowest mode at 4.2 Hz.
    input_bounds: rad, twist of each pair of rods; up to 200 deg on the real robot.   state: (6,), q and its rate.
    Outputs: the ends of the platform, x to the right, y down, from the base.   Needs the extra `robots`.
    """

    name, input_unit = "planar HSA", "rad"
    output_names, input_names = OUTPUTS, ("left_twist", "right_twist")

    @checked(payload=Number(0.0, 1e4, "kg"), timestep=TIMESTEP, input_bounds=INPUT_BOUNDS,
             substep=Number(1e-6, 1.0, "s"))
    def __init__(self, *, payload: float = 0.5, timestep: float = 0.01, substep: float = 0.001,
                 input_bounds: Sequence = (0.0, 3.4)):
        if not payload >= 0:
            raise ValueError(f"payload is {payload} kg; expected 0 or more")
        self.timestep = float(timestep)
        self.input_bounds = input_range(input_bounds, RODS, self.input_unit)
        self._start({"payload": payload, "timestep": timestep, "substep": substep,
                     "input_bounds": self.input_bounds.tolist()}, substep, lag=0.0)

    def robot(self):
        from soromox import systems

        ones, none = np.ones((1, RODS)), np.zeros(1)
        params = systems.PlanarHSAParams(
            **{name: np.array([value]) for name, value in GEOMETRY.items()},
            **{name: value * ones for name, value in PER_ROD.items()},
            **{name: 2 * value * ones for name, value in PER_PAIR.items()},
            rod_offset=np.array([[-24e-3, 24e-3]]), reference_strain=np.tile([0.0, 0.0, 1.0], (1, RODS, 1)),
            platform_dimension=np.array([[WIDTH, 12e-3, WIDTH]]), platform_density=np.array([925.0]),
            end_cap_density=np.array([2 * 710.4]), phi_max=LARGEST_TWIST * ones, gravity=np.array(GRAVITY),
            platform_mass=np.array(self.parameters["payload"]), platform_center_of_gravity=np.array([0.0, 13.5e-3]),
            end_effector_offset=np.zeros(3), hysteresis_basis=np.zeros((0, 0)), hysteresis_alpha=np.zeros(0),
            hysteresis_A=none, hysteresis_n=none, hysteresis_beta=none, hysteresis_gamma=none)
        return systems.PlanarHSA(params=params, structure=systems.PlanarHSAStructure(num_gauss_points=3),
                                 base_pose=np.zeros(3))

    def places(self, robot, q):
        import jax.numpy as jnp

        angle, x, y = robot.forward_kinematics_end_effector(q)
        edge = WIDTH / 2 * jnp.stack([jnp.cos(angle), jnp.sin(angle)])
        middle = jnp.stack([x, y])
        return jnp.concatenate([middle - edge, middle + edge])
