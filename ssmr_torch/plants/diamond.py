"""The paper's diamond: a frame of four arms on a base, each elbow pulled by a cable."""

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

SILICONE = Mechanics(young=175e3, poisson=0.45, mass=0.45, mass_damping=2.5, stiffness_damping=0.01,
                     gravity=(0.0, 0.0, -9.81))
CLAMP = (-0.015, -0.015, -0.040), (0.015, 0.015, 0.010)  # m
# The authors' tip node lies at (-4.8, 1.6, 125.4) mm, ours at (0, 0, 125.7). This point is nearest to both.
MARKERS = MappingProxyType({"tip": (-0.0035, 0.001, 0.1255), "elbow1": (0.0, 0.097, 0.046),
                            "elbow2": (-0.097, 0.0, 0.046), "elbow3": (0.0, -0.097, 0.046),
                            "elbow4": (0.097, 0.0, 0.046)})
# The mesh files lie on the side: their y is the robot's z.
ROTATION = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
RAISED = (0.0, 0.0, 0.035)  # m
ATTACHMENTS = np.array([[0.0, 0.097, 0.045], [-0.097, 0.0, 0.045], [0.0, -0.097, 0.045], [0.097, 0.0, 0.045]])  # m
ANCHORS = np.array([[0.0, 0.010, 0.030], [-0.010, 0.0, 0.030], [0.0, -0.010, 0.030], [0.010, 0.0, 0.030]])  # m
INPUTS = ("cable1", "cable2", "cable3", "cable4")


class Diamond(FiniteElementRobot):
    """A frame of silicone, 200 mm wide and 160 mm high, standing on its clamped base (paper, Fig. 2).

    mesh: name of a mesh of this package, or a file in the orientation of the authors' mesh.   length_unit: of the file.
    Elbows and their cables are counted from +y over −x and −y to +x. The cables end at fixed points above the base.
    input: tensions of the cables, N.
    mechanics: changes of `SILICONE`, by name.   Everything else is as in `FiniteElementRobot`.
    """

    @configurable(SILICONE)
    @checked(mesh=PATH, length_unit=TEXT, markers=PLACES, timestep=TIMESTEP, input_bounds=INPUT_BOUNDS, scheme=TEXT,
             linear_solver=TEXT)
    def __init__(self, mesh: str = "diamond", length_unit: str = "mm", markers: Mapping = MARKERS,
                 input_bounds: Sequence = (0.0, 1.5), timestep: float = 0.01, scheme: str = "backward_euler",
                 linear_solver: str = "block_ldl", **mechanics):
        body = read_mesh(mesh, length_unit).moved(ROTATION, RAISED)
        super().__init__("diamond", body, Cables(body, ANCHORS, ATTACHMENTS[:, None]), SILICONE.changed(mechanics),
                         body.nodes_in_box(*CLAMP), markers, INPUTS, input_bounds, timestep, scheme, linear_solver)
        self.parameters = plain({"mesh": str(mesh), "length_unit": length_unit, "markers": markers,
                                 "input_bounds": input_bounds, "timestep": timestep, "scheme": scheme,
                                 "linear_solver": linear_solver, **mechanics})
