"""Make the tetrahedral meshes of the package: `python tools/make_meshes.py`; it takes seconds.

    outline ──gmsh──▶ one wedge ──copies──▶ the whole robot ──checks──▶ ssmr_torch/plants/meshes/*.vtu

The made meshes are in the repository, so that only this script needs gmsh: `pip install gmsh meshio` and the Debian
packages libglu1-mesa libgl1 libxrender1 libxcursor1 libxfixes3 libxext6 libxft2 libxinerama1 libx11-6 libfontconfig1.
One thread and fixed options: the same versions (gmsh 4.15.2, meshio 5.3.5) make the same files.

A wedge and its copies, rather than the whole at once, give every mesh the symmetry of its robot to the last digit:
the trunk that of a quarter turn about its axis, the diamond also its two mirror planes, so that all cables of a robot
act alike. Lengths in mm.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import gmsh
import meshio
import numpy as np
from scipy.spatial import cKDTree

from ssmr_torch.plants.finite_element.mesh import TetrahedralMesh

FOLDER = Path(__file__).resolve().parents[1] / "ssmr_torch" / "plants" / "meshes"
DIGITS = 4
CLOSEST, WORST_QUALITY = 0.5, 0.25  # what a mesh must keep: mm between nodes, quality of every tetrahedron

# Sizes are those asked for on curves and by the callback alone, and MeshAdapt (algorithm 1) adds the fewest nodes
# inside of faces: all is as coarse as its edges allow.
OPTIONS = {"General.Verbosity": 2, "General.NumThreads": 1, "Mesh.Algorithm": 1, "Mesh.MeshSizeMin": 0,
           "Mesh.MeshSizeMax": 30, "Mesh.MeshSizeFromPoints": 0, "Mesh.MeshSizeExtendFromBoundary": 0}

QUARTER_TURN = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
TURNS = [np.linalg.matrix_power(QUARTER_TURN, k) for k in range(4)]
SWAP_X_Y = np.array([[0, 1, 0], [1, 0, 0], [0, 0, 1]])

TRUNK_LENGTH, TRUNK_BASE, TRUNK_TIP = 195.0, 13.0, 5.0
GROOVES, GROOVE_START, GROOVE_PITCH, GROOVE_WIDTH = 10, 21.0, 17.4855, 6.0
CORE_BASE, CORE_TIP = 2.5, 2.0

# (x, z) of half the diamond's frame, the robot standing. The corners of its top lie where the arms meet, 11.5 mm
# from the axis: fused arms with corners at 11 or 12 mm would leave steps and edges of half a millimetre.
ARM_HALF_WIDTH = 11.5
OUTER = [(0, -37), (40, -37), (58, -33), (75, -14), (83, 5), (97, 42), (97, 50), (90, 58), (11.5, 122.6), (0, 125.7)]
INNER = [(0, 113.5), (11.5, 113), (23, 103), (41, 72), (80, 54), (88.5, 48), (88.5, 41), (36, -9.6), (0, -9.6)]
ELBOW = (97.0, 0.0, 46.0)
HOLE_RADIUS = 5.0
CLAMP_FACE = 14.0  # a face of elements inside the clamped box of 15 mm: the same clamp for every mesh
CLAMP_SIZE = 27.0  # as coarse as the base is thick: what is clamped need not be resolved


@dataclass(frozen=True)
class Mesh:
    """points: (N, 3) mm.   tetrahedra: (E, 4) node numbers, signed volumes positive."""

    points: np.ndarray
    tetrahedra: np.ndarray

    @property
    def volumes(self) -> np.ndarray:
        """(E,) mm³, det[x₁ − x₀, x₂ − x₀, x₃ − x₀] / 6."""
        return np.linalg.det(self.points[self.tetrahedra[:, 1:]] - self.points[self.tetrahedra[:, :1]]) / 6

    @property
    def quality(self) -> np.ndarray:
        """(E,) mean ratio 12 (3 V)^⅔ / Σ ℓ², 1 for the regular tetrahedron and 0 for a flat one."""
        corners = self.points[self.tetrahedra]
        lengths = sum(((corners[:, a] - corners[:, b]) ** 2).sum(axis=1) for a, b in combinations(range(4), 2))
        return 12 * np.cbrt(3 * self.volumes) ** 2 / lengths


def trunk(size: float) -> Mesh:
    """A cone with V grooves, base at z = 0, tip at z = 195; `size`: length of the edges of its outline."""
    gmsh.clear()
    start = _polygon([(r, 0, z) for r, z in _trunk_outline()])
    (_, end), *_ = gmsh.model.occ.revolve([(2, start)], 0, 0, 0, 0, 0, 1, np.pi / 2)
    gmsh.model.occ.synchronize()
    for _, curve in gmsh.model.getEntities(1):
        # two chords at least on a quarter of the rim; one on the core, as thin as it is
        rim = gmsh.model.getType(1, curve) == "Circle" and gmsh.model.getBoundingBox(1, curve)[3] > CORE_BASE + 0.1
        pieces = round(gmsh.model.occ.getMass(1, curve) / size)
        gmsh.model.mesh.setTransfiniteCurve(curve, 1 + max(pieces, 2 if rim else 1))
    turn = np.eye(4)
    turn[:3, :3] = QUARTER_TURN
    gmsh.model.mesh.setPeriodic(2, [end], [start], turn.ravel().tolist())
    return _copied(_wedge(), TURNS)


def _trunk_outline() -> list[tuple[float, float]]:
    """(r, z), up the outside and down the axis."""
    def radius(z):
        return TRUNK_BASE + (TRUNK_TIP - TRUNK_BASE) * z / TRUNK_LENGTH

    starts = GROOVE_START + GROOVE_PITCH * np.arange(GROOVES)
    cores = np.linspace(CORE_BASE, CORE_TIP, GROOVES)
    outside = [(0.0, 0.0), (TRUNK_BASE, 0.0)]
    for z, core in zip(starts.tolist(), cores.tolist()):
        outside += [(radius(z), z), (core, z + GROOVE_WIDTH / 2), (radius(z + GROOVE_WIDTH), z + GROOVE_WIDTH)]
    # nodes on the axis at every groove, where the core would not bend without them, and between
    bottoms = starts + GROOVE_WIDTH / 2
    axis = np.sort(np.concatenate([[8, 16, 188], bottoms, (bottoms[1:] + bottoms[:-1]) / 2]))
    for z in (65.0, 130.0):  # observed: a third and two thirds of the length
        axis[np.argmin(abs(axis - z))] = z
    return [*outside, (TRUNK_TIP, TRUNK_LENGTH), (0.0, TRUNK_LENGTH), *((0.0, z) for z in axis[::-1].tolist())]


def diamond(size: float) -> Mesh:
    """Two closed frames crossed at a right angle, in the frame of its file: (x, −z, y + 35) is the robot standing.

    One eighth of it, 0 ≤ y ≤ x, is meshed: half an arm, mitred where the arms meet.   size: of the elements.
    """
    gmsh.clear()
    occ = gmsh.model.occ
    frame = _polygon([(x, 0, z) for x, z in OUTER + INNER])
    arm = [entity for entity in occ.extrude([(2, frame)], 0, ARM_HALF_WIDTH, 0) if entity[0] == 3]
    corner = _polygon([(0, 0, -50), (150, 0, -50), (150, 150, -50)])
    eighth, _ = occ.intersect(arm, [entity for entity in occ.extrude([(2, corner)], 0, 0, 200) if entity[0] == 3])
    eighth, _ = occ.cut(eighth, [(3, occ.addCylinder(0, 0, -50, 0, 0, 60, HOLE_RADIUS))])
    base, floor = OUTER[0][1], INNER[-1][1]
    face = _polygon([(CLAMP_FACE, y, z) for y, z in ((0, base), (ARM_HALF_WIDTH, base), (ARM_HALF_WIDTH, floor),
                                                     (0, floor))])
    occ.fragment(eighth, [(2, face), (0, occ.addPoint(*ELBOW))])
    occ.synchronize()
    gmsh.model.mesh.setSizeCallback(
        lambda dimension, tag, x, y, z, proposed: CLAMP_SIZE if z < 0 and x < CLAMP_FACE + 0.1 else size)
    wedge = _wedge()
    gmsh.model.mesh.removeSizeCallback()
    whole = _copied(wedge, [*TURNS, *(turn @ SWAP_X_Y for turn in TURNS)])
    x, y, z = whole.points.T
    return Mesh(np.round(np.column_stack([x, z - 35, -y]), DIGITS) + 0.0, whole.tetrahedra)


def _polygon(corners: list[tuple[float, float, float]]) -> int:
    points = [gmsh.model.occ.addPoint(*corner) for corner in corners]
    lines = [gmsh.model.occ.addLine(a, b) for a, b in zip(points, points[1:] + points[:1])]
    return gmsh.model.occ.addPlaneSurface([gmsh.model.occ.addCurveLoop(lines)])


def _wedge() -> Mesh:
    """The current model, meshed by gmsh."""
    gmsh.model.mesh.generate(3)
    gmsh.model.mesh.optimize("", niter=5)
    gmsh.model.mesh.optimize("Netgen")
    tags, points, _ = gmsh.model.mesh.getNodes()
    (kind,), _, (corners,) = gmsh.model.mesh.getElements(3)
    assert kind == 4, f"gmsh made elements of its type {kind}; expected tetrahedra only, type 4"
    order = np.argsort(tags)
    used, numbers = np.unique(np.searchsorted(tags[order], corners), return_inverse=True)
    return Mesh(points.reshape(-1, 3)[order][used], numbers.reshape(-1, 4))


def _copied(wedge: Mesh, operations: list[np.ndarray]) -> Mesh:
    """The union of Q x over (3, 3) orthogonal Q of 0 and ±1, nodes that coincide merged.

    A reflection swaps the nodes 0 and 1 of a tetrahedron: its volume stays positive, and the frame of its edge 0, 1
    and face 0, 1, 2, from which the corotational law reads its rotation, is the mirrored one.
    """
    points = np.round(wedge.points, DIGITS) + 0.0  # + 0.0: no negative zeros
    copies = [points @ operation.T + 0.0 for operation in operations]
    orders = [[0, 1, 2, 3] if np.linalg.det(operation) > 0 else [1, 0, 2, 3] for operation in operations]
    tetrahedra = [wedge.tetrahedra[:, order] + k * len(points) for k, order in enumerate(orders)]
    nodes, numbers = np.unique(np.concatenate(copies), axis=0, return_inverse=True)
    return Mesh(nodes, numbers.ravel()[np.concatenate(tetrahedra)])


def check(mesh: Mesh) -> None:
    """Raise ValueError for a mesh that no plant should be made of."""
    TetrahedralMesh(mesh.points * 1e-3, mesh.tetrahedra)  # refuses orphans, pieces, inverted and flat tetrahedra
    distances, _ = cKDTree(mesh.points).query(mesh.points, k=2)
    if distances[:, 1].min() < CLOSEST:
        raise ValueError(f"two nodes are {distances[:, 1].min():.2g} mm apart, expected {CLOSEST} mm: the copies of "
                         "the wedge do not meet node to node; use the version and the options of gmsh given here")
    if mesh.quality.min() < WORST_QUALITY:
        raise ValueError(f"the worst tetrahedron has a quality of {mesh.quality.min():.2f}, expected {WORST_QUALITY}: "
                         "change the size of its elements a little")


def save(mesh: Mesh, path: Path) -> None:
    """Write a VTU file, aside first: a run that is interrupted leaves the old one."""
    aside = path.with_suffix(".part")
    cells = [("tetra", mesh.tetrahedra.astype(np.int32))]
    meshio.write(aside, meshio.Mesh(mesh.points, cells), file_format="vtu", binary=True, compression="zlib")
    os.replace(aside, path)


def main() -> None:
    made = {"trunk": (trunk, 5.4), "trunk_coarse": (trunk, 7.5), "diamond": (diamond, 12.5),
            "diamond_coarse": (diamond, 26.0)}
    FOLDER.mkdir(exist_ok=True)
    gmsh.initialize()
    for option, value in OPTIONS.items():
        gmsh.option.setNumber(option, value)
    for name, (make, size) in made.items():
        mesh, path = make(size), FOLDER / f"{name}.vtu"
        check(mesh)
        save(mesh, path)
        low, high = mesh.points.min(axis=0), mesh.points.max(axis=0)
        print(f"{name}: {len(mesh.points)} nodes, {len(mesh.tetrahedra)} tetrahedra, {mesh.volumes.sum():.0f} mm³, "
              f"{low.tolist()} to {high.tolist()} mm, quality {mesh.quality.min():.2f} at worst and "
              f"{np.median(mesh.quality):.2f} in the middle, {path.stat().st_size / 1000:.0f} kB")
    gmsh.finalize()


if __name__ == "__main__":
    main()
