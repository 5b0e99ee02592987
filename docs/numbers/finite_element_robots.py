"""Size, rest and slow modes of the finite-element robots: python docs/numbers/finite_element_robots.py [MESHES]

MESHES: the folder with the authors' trunk.vtk and diamond.vtu; without it the table has our own meshes alone.
"""

import sys
from pathlib import Path

from ssmr_torch.documents.results import store_tables
from ssmr_torch.plants.diamond import Diamond
from ssmr_torch.plants.finite_element.modes import undamped_frequencies
from ssmr_torch.plants.trunk import Trunk

ROOT = Path(__file__).resolve().parents[2]
COMMAND = "python docs/numbers/finite_element_robots.py MESHES"
ROBOTS = {"trunk": (Trunk, "trunk"), "trunk_coarse": (Trunk, "trunk_coarse"), "diamond": (Diamond, "diamond"),
          "diamond_coarse": (Diamond, "diamond_coarse")}


def row(name, robot, mesh):
    """Name, nodes, height of the tip at rest, frequencies, and one eigenvalue of each slow pair."""
    plant = robot(mesh=mesh)
    slow = [rate for rate in plant.eigenvalues if rate.imag > 0][:3 if robot is Diamond else 2]
    return [name, int(plant.origin["nodes"]), f"{1e3 * plant.rest[2]:.2f}",
            ", ".join(f"{value:.3g}" for value in undamped_frequencies(plant, 4)),
            ", ".join(f"{rate.real:.2f} ± {rate.imag:.2f}i".replace("-", "−") for rate in slow)]


def main(meshes=None):
    robots = dict(ROBOTS)
    if meshes is not None:
        robots |= {"authors' trunk": (Trunk, Path(meshes) / "trunk.vtk"),
                   "authors' diamond": (Diamond, Path(meshes) / "diamond.vtu")}
    columns = ["robot", "nodes", "tip at rest, z (mm)", "undamped frequencies (rad/s)", "eigenvalues of a step (1/s)"]
    return {"finite_element_robots": (columns, [row(name, *made) for name, made in robots.items()])}


if __name__ == "__main__":
    store_tables(ROOT, main(*sys.argv[1:]), COMMAND)
