"""A symmetric arm answers mirrored pulls with mirrored motions, and so does a mirrored mesh."""

import numpy as np
import pytest

from ssmr_torch.plants.finite_element.equilibrium import equilibrium
from ssmr_torch.plants.finite_element.mesh import TetrahedralMesh

LAWS = ("corotational", "neo_hookean")
MIRROR = np.array([-1.0, 1.0, 1.0])
PULL = np.array([0.9, 0.4, 0.0, 0.0])  # +x and +y
MIRRORED_PULL = np.array([0.0, 0.4, 0.9, 0.0])  # −x and +y


def partners(mesh):
    """Number of each node's mirror image."""
    distances = np.linalg.norm(mesh.nodes[:, None] * MIRROR - mesh.nodes, axis=2)
    assert distances.min(axis=1).max() < 1e-15
    return distances.argmin(axis=1)


def as_sets(tetrahedra):
    return {frozenset(nodes) for nodes in tetrahedra.tolist()}


def mirrored(mesh, swapped):
    """The mirror image of any mesh; two nodes of each tetrahedron are swapped, so that none is inverted."""
    order = np.arange(4)
    order[list(swapped)] = order[list(swapped)[::-1]]
    return TetrahedralMesh(mesh.nodes * MIRROR, mesh.tetrahedra[:, order])


def lopsided(arm):
    """The arm with its inner nodes moved: no longer symmetric."""
    shift = np.random.default_rng(0).uniform(-1e-3, 1e-3, arm.nodes.shape)
    return TetrahedralMesh(arm.nodes + shift * (arm.nodes[:, 2:] > 0), arm.tetrahedra)


def test_the_arm_is_its_own_mirror_image(arm):
    assert as_sets(partners(arm)[arm.tetrahedra]) == as_sets(arm.tetrahedra)


@pytest.mark.parametrize("law", LAWS)
def test_the_symmetric_arm_comes_to_rest_in_mirror_images(body, arm, law):
    structure = body(law)
    found = [equilibrium(structure, pull) for pull in (PULL, MIRRORED_PULL)]
    assert np.abs(found[0] - found[1]).max() > 5e-3
    np.testing.assert_allclose(found[1][partners(arm)], found[0] * MIRROR, atol=1e-10)


@pytest.mark.parametrize("scheme", ["backward_euler", "generalized_alpha", "bdf2"])
def test_the_symmetric_arm_moves_in_mirror_images(robot, arm, scheme):
    """To rounding: both element laws, the cables, the solver and the schemes keep the symmetry."""
    ends = []
    for pull in (PULL, MIRRORED_PULL):
        moving = robot(scheme)
        for _ in range(50):
            moving.step(pull)
        ends.append(moving.positions)
    # what Newton's tolerance leaves, for the schemes that iterate
    tolerance = 1e-13 if scheme == "backward_euler" else 1e-10
    np.testing.assert_allclose(ends[1][partners(arm)], ends[0] * MIRROR, atol=tolerance)


@pytest.mark.parametrize("scheme", ["backward_euler", "generalized_alpha"])
def test_a_robot_pulled_in_its_plane_of_symmetry_stays_there(robot, scheme):
    moving = robot(scheme)
    for _ in range(50):
        y = moving.step([0, 0.9, 0, 0])
    assert abs(y[1]) > 5e-3 and abs(y[0]) < 1e-13


# a mirrored mesh: which nodes are swapped matters to the edge-frame law, which turns with nodes 0, 1, 2

@pytest.mark.parametrize(("law", "swapped"), [("corotational", (0, 1)), ("neo_hookean", (0, 1)),
                                              ("neo_hookean", (2, 3)), ("neo_hookean", (0, 3))], ids=str)
def test_forces_of_the_mirrored_mesh_are_mirrored_to_rounding(body, arm, deform, law, swapped):
    """Swapping 0 and 1 keeps the edge and the face of the frame, and so R; the neo-Hookean law knows no order."""
    mesh = lopsided(arm)
    bent = deform(mesh.nodes)
    force = body(law, mesh=mesh).internal_force(bent)
    found = body(law, mesh=mirrored(mesh, swapped)).internal_force(bent * MIRROR)
    np.testing.assert_allclose(found, force * MIRROR, atol=1e-13 * np.abs(force).max())


def test_forces_of_an_edge_frame_on_another_face_differ_by_the_square_of_the_strain(body, arm, deform):
    """Swapping 2 and 3 turns with the face 0, 1, 3 instead: the same to first order only."""
    mesh, differences = lopsided(arm), []
    structures = body("corotational", mesh=mesh), body("corotational", mesh=mirrored(mesh, (2, 3)))
    way = np.random.default_rng(1).uniform(-1e-4, 1e-4, mesh.nodes.shape)
    for size in (1, 0.5, 0.25):
        moved = mesh.nodes + size * way
        force = structures[0].internal_force(moved) * MIRROR
        differences.append(np.abs(structures[1].internal_force(moved * MIRROR) - force).max())
        assert differences[-1] < 0.1 * np.abs(force).max()
    np.testing.assert_allclose(np.log2(np.array(differences[:-1]) / differences[1:]), 2, atol=0.1)


def deflection_difference(body, mesh, swapped, load):
    """Of the mirrored mesh from the mesh, under a share of the pull and of the weight, m."""
    def rest(mesh, pull):
        return equilibrium(body("corotational", mesh=mesh, gravity=(0, 0, -9.81 * load)), load * pull)

    return np.abs(rest(mirrored(mesh, swapped), MIRRORED_PULL) * MIRROR - rest(mesh, PULL)).max()


def test_the_order_of_nodes_moves_the_edge_frame_arm_by_the_square_of_the_load(body, arm):
    """A tenth of the deflection, 1 mm, at the full load; a law of small strains is not sharper than that."""
    mesh = lopsided(arm)
    assert deflection_difference(body, mesh, (0, 1), 1.0) < 1e-10
    full, quarter = (deflection_difference(body, mesh, (2, 3), load) for load in (1.0, 0.25))
    assert 1e-4 < full < 2e-3 and full > 12 * quarter
