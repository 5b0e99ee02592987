"""Frictionless cables through waypoints: the nodal forces of their tensions, and their geometric stiffness."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ssmr_torch.plants.finite_element.compiled import kernel
from ssmr_torch.plants.finite_element.mesh import TetrahedralMesh


class Cables:
    """m cables. Each is pulled at its anchor, a point fixed in space.

    anchors: (m, 3) m.   waypoints: m arrays (K_i, 3) m of points in the undeformed body, starting at the anchor; the
    last one is the end of the cable. A point outside the mesh moves with the tetrahedron of nearest centre.

    A tension T acts on waypoint k with T (d_{k+1} − d_k), where d_k is the unit vector from waypoint k − 1 (0: the
    anchor) to waypoint k, and on the last waypoint with −T d_K. Barycentric weights distribute it over the nodes.
    Raises ValueError for wrong shapes and for waypoints that coincide.
    """

    def __init__(self, mesh: TetrahedralMesh, anchors: np.ndarray, waypoints: Sequence[np.ndarray]):
        self.anchors = np.array(anchors, dtype=np.float64).reshape(-1, 3)
        paths = [np.asarray(path, dtype=np.float64).reshape(-1, 3) for path in waypoints]
        if len(paths) != len(self.anchors) or not all(len(path) for path in paths):
            raise ValueError(f"{len(self.anchors)} anchors and {len(paths)} lists of {[len(p) for p in paths]} "
                             "waypoints; expected a list of one point or more for each anchor")
        if not (np.isfinite(self.anchors).all() and all(np.isfinite(path).all() for path in paths)):
            raise ValueError("an anchor or a waypoint is not finite; expected points in m")
        for number, (anchor, path) in enumerate(zip(self.anchors, paths)):
            if (np.linalg.norm(np.diff(path, axis=0, prepend=anchor[None]), axis=1) < 1e-9).any():
                raise ValueError(f"cable {number} has waypoints that coincide: {path.tolist()} from {anchor.tolist()}; "
                                 "expected different points, because they give the direction of the cable")
        self.starts = np.concatenate([[0], np.cumsum([len(path) for path in paths])])
        self.nodes, self.weights = mesh.embed(np.concatenate(paths))

    @property
    def count(self) -> int:
        return len(self.anchors)

    def points(self, positions: np.ndarray) -> np.ndarray:
        """(Σ K_i, 3) m, the present positions of the waypoints."""
        return np.einsum("ka,kai->ki", self.weights, positions[self.nodes])

    def lengths(self, positions: np.ndarray) -> np.ndarray:
        """(m,) m from the anchor to the end; −∂length/∂x is the force of a unit tension on node x."""
        points = self.points(positions)
        return np.array([np.linalg.norm(np.diff(points[start:stop], axis=0, prepend=anchor[None]), axis=1).sum()
                         for anchor, start, stop in zip(self.anchors, self.starts, self.starts[1:])])

    def add_force(self, positions: np.ndarray, tensions: np.ndarray, force: np.ndarray) -> None:
        """Add the nodal forces of tensions (m,), N, to force (N, 3)."""
        _add_force(positions, tensions, self.anchors, self.starts, self.nodes, self.weights, force)

    def input_matrix(self, positions: np.ndarray) -> np.ndarray:
        """H (N, 3, m): nodal forces of unit tensions."""
        matrix = np.zeros((self.count, *positions.shape))
        for unit, force in zip(np.eye(self.count), matrix):
            self.add_force(positions, unit, force)
        return np.moveaxis(matrix, 0, -1)

    def add_stiffness(self, positions: np.ndarray, tensions: np.ndarray, places: np.ndarray, strides: np.ndarray,
                      data: np.ndarray) -> None:
        """Add −∂(H u)/∂x, which is symmetric: T/ℓ (I − d ⊗ d) between the ends of each stretch.

        places, strides: of the groups `stretches` in `data`, see `Sparsity.places`.
        """
        _add_stiffness(positions, tensions, self.anchors, self.starts, self.nodes, self.weights, places, strides, data)

    @property
    def stretches(self) -> np.ndarray:
        """(Σ K_i, 8) nodes of the two ends of each stretch. A stretch from an anchor has its far end's nodes twice."""
        previous = np.where(np.isin(np.arange(len(self.nodes)), self.starts[:-1])[:, None],
                            self.nodes, np.roll(self.nodes, 1, axis=0))
        return np.concatenate([previous, self.nodes], axis=1)


@kernel
def _waypoint(positions, nodes, weights, k, point):
    for i in range(3):
        total = 0.0
        for a in range(4):
            total += weights[k, a] * positions[nodes[k, a], i]
        point[i] = total


@kernel
def _add_force(positions, tensions, anchors, starts, nodes, weights, force):
    previous, point = np.empty(3), np.empty(3)
    for cable in range(len(anchors)):
        tension = tensions[cable]
        if tension == 0.0:
            continue
        previous[:] = anchors[cable]
        for k in range(starts[cable], starts[cable + 1]):
            _waypoint(positions, nodes, weights, k, point)
            length = np.sqrt((point[0] - previous[0]) ** 2 + (point[1] - previous[1]) ** 2
                             + (point[2] - previous[2]) ** 2)
            for i in range(3):
                pull = tension * (point[i] - previous[i]) / length
                for a in range(4):
                    force[nodes[k, a], i] -= weights[k, a] * pull
                    if k > starts[cable]:
                        force[nodes[k - 1, a], i] += weights[k - 1, a] * pull
            previous[:] = point


@kernel
def _add_stiffness(positions, tensions, anchors, starts, nodes, weights, places, strides, data):
    previous, point, direction = np.empty(3), np.empty(3), np.empty(3)
    ends = np.empty(8)
    for cable in range(len(anchors)):
        tension = tensions[cable]
        previous[:] = anchors[cable]
        for k in range(starts[cable], starts[cable + 1]):
            _waypoint(positions, nodes, weights, k, point)
            direction[:] = point - previous
            length = np.sqrt((direction ** 2).sum())
            direction /= length
            for a in range(4):
                ends[a] = -weights[k - 1, a] if k > starts[cable] else 0.0
                ends[4 + a] = weights[k, a]
            for a in range(8):
                for b in range(8):
                    place, factor = places[k, a, b], tension / length * ends[a] * ends[b]
                    if place < 0 or factor == 0.0:
                        continue
                    for j in range(3):
                        for i in range(3):
                            data[place + j * strides[k, b] + i] += factor * ((i == j) - direction[i] * direction[j])
            previous[:] = point
