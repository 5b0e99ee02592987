"""Cables pull along their paths: forces and stiffnesses against the lengths of the paths and against statics."""

import numpy as np
import pytest

from ssmr_torch.plants.finite_element.cables import Cables

TENSIONS = np.array([0.7, 0.0, 1.3, 0.2])


@pytest.fixture
def four(cables, arm):
    return cables(arm)


@pytest.fixture
def forces(four, arm):
    """(positions, tensions) -> nodal forces (N, 3) N."""

    def add(positions, tensions):
        force = np.zeros_like(arm.nodes)
        four.add_force(positions, np.asarray(tensions, dtype=float), force)
        return force

    return add


def straight(anchor, *points):
    return np.linalg.norm(np.diff([anchor, *points], axis=0), axis=1).sum()


def test_the_length_is_that_of_the_path_from_anchor_to_end(four, arm):
    np.testing.assert_allclose(four.lengths(arm.nodes), 0.110, rtol=1e-13)
    path = np.array([[0.001, 0.002, 0.01], [0.004, -0.002, 0.05], [-0.003, 0.005, 0.09]])
    np.testing.assert_allclose(Cables(arm, [[0, 0.1, 0]], [path]).lengths(arm.nodes), straight([0, 0.1, 0], *path),
                               rtol=1e-13)


def test_waypoints_follow_the_body(four, arm):
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    np.testing.assert_allclose(four.points(arm.nodes @ turn.T + 1), four.points(arm.nodes) @ turn.T + 1, atol=1e-14)


def test_the_force_of_a_unit_tension_is_minus_the_gradient_of_the_length(four, arm, deform, forces):
    bent, rng, step = deform(arm.nodes), np.random.default_rng(0), 1e-7
    for _ in range(5):
        way = rng.standard_normal(arm.nodes.shape)
        slopes = (four.lengths(bent + step * way) - four.lengths(bent - step * way)) / (2 * step)
        for cable, unit in enumerate(np.eye(4)):
            np.testing.assert_allclose((forces(bent, unit) * way).sum(), -slopes[cable], rtol=1e-6)


def test_the_body_is_pulled_towards_the_anchor_with_the_tension(four, arm, deform, forces):
    bent = deform(arm.nodes)
    first = four.points(bent)[four.starts[:-1]]
    towards = (four.anchors - first) / np.linalg.norm(four.anchors - first, axis=1, keepdims=True)
    for cable, unit in enumerate(np.eye(4)):
        np.testing.assert_allclose(forces(bent, 2.5 * unit).sum(axis=0), 2.5 * towards[cable], atol=1e-14)


def test_the_moment_on_the_body_is_that_of_the_pull_at_the_anchor(four, arm, deform, forces):
    bent = deform(arm.nodes)
    force = forces(bent, TENSIONS)
    points = four.points(bent)[four.starts[:-1]]
    pulls = TENSIONS[:, None] * (four.anchors - points) / np.linalg.norm(four.anchors - points, axis=1, keepdims=True)
    np.testing.assert_allclose(np.cross(bent, force).sum(axis=0), np.cross(four.anchors, pulls).sum(axis=0), atol=1e-15)


def test_the_force_is_linear_in_the_tensions(four, arm, deform, forces):
    bent = deform(arm.nodes)
    sums = sum(tension * forces(bent, unit) for tension, unit in zip(TENSIONS, np.eye(4)))
    np.testing.assert_allclose(forces(bent, TENSIONS), sums, atol=1e-15)
    np.testing.assert_allclose(four.input_matrix(bent) @ TENSIONS, sums, atol=1e-15)


def test_a_slack_cable_has_no_force(arm, deform, forces):
    assert not forces(deform(arm.nodes), np.zeros(4)).any()


def test_a_straight_cable_presses_only_where_it_ends(four, arm, forces):
    """Equal directions cancel at every waypoint but the last."""
    force = forces(arm.nodes, [1, 0, 0, 0])
    np.testing.assert_allclose(force[arm.nodes[:, 2] < 0.09 - 1e-9], 0, atol=1e-13)
    np.testing.assert_allclose(force.sum(axis=0), [0, 0, -1], atol=1e-13)


@pytest.mark.parametrize("law", ["corotational", "neo_hookean"])
def test_the_geometric_stiffness_is_minus_the_derivative_of_the_force(body, arm, deform, law):
    """The part of the tangent that the tensions add."""
    structure, bent, step = body(law), deform(arm.nodes), 1e-7
    matrix = structure.tangent(bent, TENSIONS) - structure.tangent(bent, np.zeros(4))
    np.testing.assert_allclose(abs(matrix - matrix.T).max(), 0, atol=1e-13 * abs(matrix).max())
    for seed in range(5):
        way = np.random.default_rng(seed).standard_normal(structure.sparsity.size)

        def pull(size, way=way):
            positions = structure.sparsity.scatter(structure.sparsity.gather(bent) + size * way, bent)
            return structure.forces(positions, TENSIONS) - structure.forces(positions, np.zeros(4))

        slope = (pull(step) - pull(-step)) / (2 * step)
        np.testing.assert_allclose(matrix @ way, -slope, atol=1e-6 * np.abs(slope).max())


# refusals

def test_waypoints_that_coincide_are_refused(arm):
    point = [0.0, 0.0, 0.05]
    for anchor, path in (([0, 0, 0], [point, point]), (point, [point]), ([0, 0, 0], [[0, 0, 0.07], point, point])):
        with pytest.raises(ValueError, match="cable 1 has waypoints that coincide"):
            Cables(arm, [[0, 0, -1], anchor], [[point], path])


@pytest.mark.parametrize("paths", [[[[0, 0, 0.05]]], [[[0, 0, 0.05]], np.empty((0, 3))]], ids=["one path", "no point"])
def test_every_anchor_needs_its_path(arm, paths):
    with pytest.raises(ValueError, match="expected a list of one point or more for each anchor"):
        Cables(arm, [[0, 0, -1], [0, 0, -2]], paths)
