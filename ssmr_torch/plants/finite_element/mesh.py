"""Tetrahedral meshes: nodes, elements, surface, and points inside the elements."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

FACES = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])  # seen from outside, counter-clockwise

ON_A_FACE = 1e-9  # of a barycentric coordinate: a point on a face counts as inside in spite of rounding


@dataclass(frozen=True, eq=False)
class TetrahedralMesh:
    """An elastic body in its undeformed shape.

    nodes: (N, 3) m.   tetrahedra: (E, 4) node numbers; their order matters for the edge-frame law.
    Raises ValueError for wrong shapes, numbers out of range, non-finite nodes, inverted or flat tetrahedra, nodes
    that belong to no tetrahedron, and a body in several pieces.
    """

    nodes: np.ndarray
    tetrahedra: np.ndarray

    def __post_init__(self):
        object.__setattr__(self, "nodes", np.array(self.nodes, dtype=np.float64))
        object.__setattr__(self, "tetrahedra", np.array(self.tetrahedra, dtype=np.int64))
        _validate(self)
        self.nodes.setflags(write=False)
        self.tetrahedra.setflags(write=False)

    @property
    def volumes(self) -> np.ndarray:
        """(E,) m³, signed: positive where node 3 lies on the side to which the normal of face 0, 1, 2 points."""
        return np.linalg.det(_edges(self)) / 6

    @property
    def size(self) -> float:
        """The longest side of the box around the body, m."""
        return float(np.ptp(self.nodes, axis=0).max())

    @property
    def shape_gradients(self) -> np.ndarray:
        """(E, 4, 3) gradients of the linear shape functions, 1/m."""
        last = np.linalg.inv(_edges(self)).transpose(0, 2, 1)
        return np.concatenate([-last.sum(axis=1, keepdims=True), last], axis=1)

    @property
    def surface(self) -> np.ndarray:
        """(F, 3) triangles that belong to only one tetrahedron, counter-clockwise from outside."""
        faces = self.tetrahedra[:, FACES].reshape(-1, 3)
        _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
        return faces[np.sort(first[count == 1])]

    def moved(self, rotation: np.ndarray, translation: Sequence[float]) -> TetrahedralMesh:
        """The body rotated by a (3, 3) matrix about the origin, then shifted by (3,) m."""
        return TetrahedralMesh(self.nodes @ np.asarray(rotation, dtype=np.float64).T + translation, self.tetrahedra)

    def nodes_in_box(self, lowest: Sequence[float], highest: Sequence[float]) -> np.ndarray:
        """Numbers of the nodes with lowest ≤ x ≤ highest, m. Raises ValueError when there are none."""
        found = np.flatnonzero(((self.nodes >= lowest) & (self.nodes <= highest)).all(axis=1))
        if not len(found):
            raise ValueError(f"no node lies in the box from {list(lowest)} to {list(highest)} m; the mesh spans "
                             f"{self.nodes.min(axis=0).tolist()} to {self.nodes.max(axis=0).tolist()} m: check the "
                             "unit of its lengths and its position")
        return found

    def nearest_node(self, point: Sequence[float]) -> int:
        """Number of the node nearest to a point, m."""
        return int(np.argmin(np.linalg.norm(self.nodes - np.asarray(point, dtype=np.float64), axis=1)))

    def embed(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Nodes (K, 4) and barycentric weights (K, 4) of points (K, 3) m: x = Σ weight · node, also when deformed.

        A point outside the mesh gets the tetrahedron with the nearest centre, with extrapolated weights.
        """
        first, inverse = self.nodes[self.tetrahedra[:, 0]], np.linalg.inv(_edges(self).transpose(0, 2, 1))
        centres = self.nodes[self.tetrahedra].mean(axis=1)
        nodes, weights = [], []
        for point in np.asarray(points, dtype=np.float64).reshape(-1, 3):
            last = np.einsum("eij,ej->ei", inverse, point - first)
            outside = np.maximum((-last).max(axis=1), last.sum(axis=1) - 1)
            deepest = int(np.argmin(outside))
            if outside[deepest] > ON_A_FACE:
                deepest = int(np.argmin(np.linalg.norm(centres - point, axis=1)))
            nodes.append(self.tetrahedra[deepest])
            weights.append([1 - last[deepest].sum(), *last[deepest]])
        return np.array(nodes).reshape(-1, 4), np.array(weights).reshape(-1, 4)


def _edges(mesh: TetrahedralMesh) -> np.ndarray:
    """(E, 3, 3), row k the edge from node 0 to node k + 1."""
    return mesh.nodes[mesh.tetrahedra[:, 1:]] - mesh.nodes[mesh.tetrahedra[:, :1]]


def _validate(mesh: TetrahedralMesh) -> None:
    nodes, tetrahedra = mesh.nodes, mesh.tetrahedra
    if nodes.ndim != 2 or nodes.shape[1] != 3 or tetrahedra.ndim != 2 or tetrahedra.shape[1] != 4 \
            or not len(tetrahedra):
        raise ValueError(f"nodes have shape {nodes.shape} and tetrahedra {tetrahedra.shape}; expected (N, 3) and "
                         "(E, 4) with one tetrahedron at least")
    if not np.isfinite(nodes).all():
        raise ValueError(f"{(~np.isfinite(nodes).all(axis=1)).sum()} of {len(nodes)} nodes are not finite")
    if tetrahedra.min() < 0 or tetrahedra.max() >= len(nodes):
        raise ValueError(f"tetrahedra use the nodes {tetrahedra.min()} to {tetrahedra.max()}; there are {len(nodes)}, "
                         "counted from 0")
    orphans = np.setdiff1d(np.arange(len(nodes)), tetrahedra)
    if len(orphans):
        raise ValueError(f"{len(orphans)} of {len(nodes)} nodes belong to no tetrahedron; the first is node "
                         f"{orphans[0]}. Remove them from the mesh")
    flat = np.flatnonzero(mesh.volumes <= 1e-12 * mesh.size ** 3)
    if len(flat):
        raise ValueError(f"{len(flat)} of {len(tetrahedra)} tetrahedra are inverted or flat; the first is number "
                         f"{flat[0]}, with a volume of {mesh.volumes[flat[0]]:.3g} m³. Repair the mesh; if all are "
                         "inverted, swap two nodes of each")
    links = tetrahedra[:, [0, 0, 0]].ravel(), tetrahedra[:, 1:].ravel()
    pieces, _ = connected_components(coo_array((np.ones(len(links[0])), links), (len(nodes),) * 2), directed=False)
    if pieces > 1:
        raise ValueError(f"the body is in {pieces} pieces; expected one")
