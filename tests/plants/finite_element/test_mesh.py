"""Geometry of tetrahedral meshes, against what is known of boxes and of single tetrahedra."""

import numpy as np
import pytest

from ssmr_torch.plants.finite_element.mesh import TetrahedralMesh

CORNER = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
ONE = [[0, 1, 2, 3]]


@pytest.fixture
def flawed():
    """(nodes=, tetrahedra=) -> two tetrahedra that share a face, or what is given instead."""

    def make(nodes=None, tetrahedra=None):
        return TetrahedralMesh(np.vstack([CORNER, [1, 1, 1]]) if nodes is None else nodes,
                               [[0, 1, 2, 3], [1, 2, 3, 4]] if tetrahedra is None else tetrahedra)

    return make


def area_vectors(mesh):
    """Of the surface's triangles, outward, m²."""
    a, b, c = mesh.nodes[mesh.surface].swapaxes(0, 1)
    return np.cross(b - a, c - a) / 2


def rotation(seed=0):
    q, r = np.linalg.qr(np.random.default_rng(seed).standard_normal((3, 3)))
    return q * np.linalg.det(q)


# volumes and shape functions

def test_the_corner_of_a_cube_has_a_sixth_of_its_volume():
    np.testing.assert_allclose(TetrahedralMesh(CORNER, ONE).volumes, [1 / 6], rtol=1e-15)


def test_the_shape_functions_of_the_corner_are_the_coordinates():
    expected = [[[-1, -1, -1], [1, 0, 0], [0, 1, 0], [0, 0, 1]]]
    np.testing.assert_allclose(TetrahedralMesh(CORNER, ONE).shape_gradients, expected, atol=1e-15)


def test_shape_gradients_reproduce_every_linear_field(arm):
    slope = np.random.default_rng(0).standard_normal(3)
    found = np.einsum("ea,eai->ei", (arm.nodes @ slope + 3.0)[arm.tetrahedra], arm.shape_gradients)
    np.testing.assert_allclose(found, np.tile(slope, (len(arm.tetrahedra), 1)), rtol=1e-11)


def test_the_tetrahedra_fill_the_box(arm):
    assert len(arm.nodes) == 99
    np.testing.assert_allclose(arm.volumes.sum(), 0.02 * 0.02 * 0.1, rtol=1e-14)


def test_moving_a_body_keeps_its_volume_and_its_surface(arm):
    moved = arm.moved(rotation(), (0.3, -0.2, 0.1))
    np.testing.assert_allclose(moved.volumes, arm.volumes, rtol=1e-11)
    np.testing.assert_array_equal(moved.surface, arm.surface)
    np.testing.assert_allclose(moved.nodes - [0.3, -0.2, 0.1], arm.nodes @ rotation().T, atol=1e-16)


# surface

def test_the_surface_of_the_box_has_its_area(arm):
    np.testing.assert_allclose(np.linalg.norm(area_vectors(arm), axis=1).sum(), 4 * 0.02 * 0.1 + 2 * 0.02**2,
                               rtol=1e-13)


def test_the_surface_is_closed(arm):
    np.testing.assert_allclose(area_vectors(arm).sum(axis=0), 0, atol=1e-18)
    edges = np.sort(arm.surface[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()


def test_the_surface_faces_outward_as_the_divergence_theorem_asks(arm):
    centres = arm.nodes[arm.surface].mean(axis=1)
    np.testing.assert_allclose((centres * area_vectors(arm)).sum() / 3, arm.volumes.sum(), rtol=1e-13)


@pytest.mark.parametrize("name", ["trunk.vtk", "diamond.vtu"])
def test_the_authors_meshes_are_closed_bodies(measurements, name):
    from ssmr_torch.plants.finite_element.mesh_files import read_mesh

    mesh = read_mesh(measurements("meshes") / name)
    centres = mesh.nodes[mesh.surface].mean(axis=1)
    np.testing.assert_allclose((centres * area_vectors(mesh)).sum() / 3, mesh.volumes.sum(), rtol=1e-10)


# embedded points

@pytest.mark.parametrize("reach", [1.0, 3.0], ids=["inside", "mostly outside"])
def test_embedded_points_are_the_weighted_sum_of_their_nodes(arm, reach):
    points = reach * np.random.default_rng(1).uniform([-0.01, -0.01, 0], [0.01, 0.01, 0.1], (200, 3))
    nodes, weights = arm.embed(points)
    np.testing.assert_allclose(np.einsum("ka,kai->ki", weights, arm.nodes[nodes]), points, atol=1e-15)
    np.testing.assert_allclose(weights.sum(axis=1), 1, rtol=1e-13)


def test_points_inside_have_positive_weights_and_follow_every_affine_motion(arm):
    points = np.random.default_rng(2).uniform([-0.01, -0.01, 0], [0.01, 0.01, 0.1], (200, 3))
    nodes, weights = arm.embed(points)
    assert weights.min() >= -1e-12
    slope = np.random.default_rng(3).standard_normal((3, 3))
    np.testing.assert_allclose(np.einsum("ka,kai->ki", weights, (arm.nodes @ slope)[nodes]), points @ slope, atol=1e-15)


def test_a_point_outside_belongs_to_the_tetrahedron_of_nearest_centre(arm):
    points = np.random.default_rng(4).uniform([0.011, -0.02, -0.02], [0.03, 0.02, 0.12], (100, 3))
    centres = arm.nodes[arm.tetrahedra].mean(axis=1)
    nearest = np.linalg.norm(centres - points[:, None], axis=2).argmin(axis=1)
    nodes, weights = arm.embed(points)
    np.testing.assert_array_equal(nodes, arm.tetrahedra[nearest])
    assert (weights.min(axis=1) < 0).all()


def test_a_node_is_embedded_in_itself(arm):
    nodes, weights = arm.embed(arm.nodes)
    np.testing.assert_array_equal(nodes[np.arange(99), weights.argmax(axis=1)], np.arange(99))
    np.testing.assert_allclose(weights.max(axis=1), 1, rtol=1e-12)


def test_the_nearest_node_is_nearest(arm):
    for point in np.random.default_rng(5).uniform(-0.1, 0.1, (20, 3)):
        distances = np.linalg.norm(arm.nodes - point, axis=1)
        assert distances[arm.nearest_node(point)] == distances.min()


def test_the_box_holds_the_nodes_on_its_faces_too(arm):
    np.testing.assert_array_equal(arm.nodes_in_box((-1, -1, 0), (1, 1, 0)), np.flatnonzero(arm.nodes[:, 2] == 0))


# refusals

@pytest.mark.parametrize(("spoilt", "match"), [
    ({"nodes": np.zeros((5, 2))}, "expected \\(N, 3\\)"),
    ({"tetrahedra": [[0, 1, 2]]}, "expected \\(N, 3\\) and \\(E, 4\\)"),
    ({"tetrahedra": np.empty((0, 4), int)}, "one tetrahedron at least"),
    ({"nodes": np.vstack([CORNER, [np.nan, 1, 1]])}, "1 of 5 nodes are not finite"),
    ({"nodes": np.vstack([CORNER, [np.inf, 1, 1]])}, "1 of 5 nodes are not finite"),
    ({"tetrahedra": [[0, 1, 2, 3], [1, 2, 3, 5]]}, "there are 5"),
    ({"tetrahedra": [[0, 1, 2, 3], [1, 2, 3, -1]]}, "counted from 0"),
    ({"tetrahedra": ONE}, "1 of 5 nodes belong to no tetrahedron; the first is node 4"),
    ({"tetrahedra": [[0, 1, 2, 3], [3, 2, 1, 4]]}, "1 of 2 tetrahedra are inverted or flat; the first is number 1"),
    ({"nodes": np.vstack([CORNER, [1 / 3] * 3])}, "inverted or flat"),
    ({"nodes": np.vstack([CORNER, CORNER + 2]), "tetrahedra": [[0, 1, 2, 3], [4, 5, 6, 7]]}, "in 2 pieces"),
], ids=["flat space", "triangles", "nothing", "NaN", "infinite", "too large a number", "negative number", "orphan",
        "inverted", "flat", "two pieces"])
def test_a_mesh_that_is_not_a_body_is_refused(flawed, spoilt, match):
    flawed()
    with pytest.raises(ValueError, match=match):
        flawed(**spoilt)


def test_an_empty_box_is_refused_with_the_extent_of_the_mesh(arm):
    with pytest.raises(ValueError, match="no node lies in the box .* check the unit"):
        arm.nodes_in_box((1, 1, 1), (2, 2, 2))


def test_a_mesh_does_not_share_memory_with_the_arrays_of_the_caller():
    nodes, tetrahedra = CORNER.copy(), np.array(ONE)
    mesh = TetrahedralMesh(nodes, tetrahedra)
    nodes[:] = tetrahedra[:] = 7
    np.testing.assert_array_equal(mesh.nodes, CORNER)
    np.testing.assert_array_equal(mesh.tetrahedra, ONE)
    for array in (mesh.nodes, mesh.tetrahedra):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1
