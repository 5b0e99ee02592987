"""The paper's trunk: a hanging cone with grooves and eight cables, four to the tip and four to its middle."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np

from ssmr_torch.checked_arguments import checked
from ssmr_torch.keywords import configurable
from ssmr_torch.plants.finite_element.cables import Cables
from ssmr_torch.plants.finite_element.mesh_files import read_mesh
from ssmr_torch.plants.finite_element.robot import FiniteElementRobot, plain
from ssmr_torch.plants.finite_element.structure import Mechanics
from ssmr_torch.quantities import INPUT_BOUNDS, PATH, PLACES, TEXT, TIMESTEP

SILICONE = Mechanics(young=450e3, poisson=0.45, mass=0.042, mass_damping=0.1, stiffness_damping=0.1,
                     gravity=(0.0, 0.0, 9.81))
CLAMP = (-0.020, -0.020, 0.0), (0.020, 0.020, 0.020)  # m
# The authors' tip node lies at the rim, (5, 0, 195) mm, ours at the centre. This point is nearest to both.
MARKERS = MappingProxyType({"tip": (0.002, 0.0, 0.195), "middle": (0.0, 0.0, 0.130), "upper": (0.0, 0.0, 0.065)})
ANCHORS = np.array([[0.0, 0.010, 0.0], [-0.010, 0.0, 0.0], [0.0, -0.010, 0.0], [0.010, 0.0, 0.0]])  # m
TURN = 1.57  # rad between two cables, the authors' number
LONG, SHORT = 20, 9  # waypoints besides the anchor
INPUTS = tuple(f"{length}_{side}" for length in ("long", "short") for side in ("+y", "-x", "-y", "+x"))


class Trunk(FiniteElementRobot):
    """195 mm of silicone hanging along +z, clamped in the box of 40 x 40 x 20 mm at its base (paper, Fig. 2).

    mesh: name of a mesh of this package, or a file; the cables run as in the authors' model.   length_unit: of the
    file.   input: tensions in N of the four long cables, then of the four short ones.   mechanics: changes of
    `SILICONE`, by name.   Everything else is as in `FiniteElementRobot`.
    """

    @configurable(SILICONE)
    @checked(mesh=PATH, length_unit=TEXT, markers=PLACES, timestep=TIMESTEP, input_bounds=INPUT_BOUNDS, scheme=TEXT,
             linear_solver=TEXT)
    def __init__(self, mesh: str = "trunk", length_unit: str = "mm", markers: Mapping = MARKERS,
                 input_bounds: Sequence = (0.0, 0.8), timestep: float = 0.01, scheme: str = "backward_euler",
                 linear_solver: str = "block_ldl", **mechanics):
        body = read_mesh(mesh, length_unit)
        super().__init__("trunk", body, Cables(body, *cable_paths()), SILICONE.changed(mechanics),
                         body.nodes_in_box(*CLAMP), markers, INPUTS, input_bounds, timestep, scheme, linear_solver)
        self.parameters = plain({"mesh": str(mesh), "length_unit": length_unit, "markers": markers,
                                 "input_bounds": input_bounds, "timestep": timestep, "scheme": scheme,
                                 "linear_solver": linear_solver, **mechanics})


def cable_paths() -> tuple[np.ndarray, list[np.ndarray]]:
    """Anchors (8, 3) m and waypoints of the long and short cables, m.

    Along d = (0, −8, 195)/‖·‖: (d_x, 17.5 k d_y + 10, 17.5 k d_z + 21), and the same with 27 mm, k = 0, 1, …; cable i
    is rotated about z by 1.57 i rad.
    """
    direction = np.array([0.0, -8.0, 195.0]) / np.hypot(8.0, 195.0)
    k = np.repeat(np.arange(LONG // 2), 2)
    heights = np.tile([21.0, 27.0], LONG // 2)
    first = np.stack([np.full(LONG, direction[0]), 17.5 * k * direction[1] + 10.0,
                      17.5 * k * direction[2] + heights], axis=1)
    paths = []
    for waypoints in (LONG, SHORT):
        for i in range(len(ANCHORS)):
            cosine, sine = np.cos(TURN * i), np.sin(TURN * i)
            turn = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
            paths.append(1e-3 * first[:waypoints] @ turn.T)
    return np.tile(ANCHORS, (2, 1)), paths
