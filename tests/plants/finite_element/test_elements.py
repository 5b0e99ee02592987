"""Both element laws against linear elasticity, rigid motions, affine fields, and their own definitions."""

import numpy as np
import pytest
from skfem import Basis, ElementTetP1, ElementVector, MeshTet
from skfem.models.elasticity import linear_elasticity

from ssmr_torch.plants.finite_element import elements
from ssmr_torch.plants.finite_element.mesh import TetrahedralMesh
from ssmr_torch.plants.finite_element.mesh_files import read_mesh

LAWS = ("corotational", "neo_hookean")
YOUNG, WIDTH = 60e3, 0.020
SLACK = np.zeros(4)


def rotation(rng):
    """Uniform among all rotations, half turns included."""
    w, x, y, z = rng.standard_normal(4)
    q = np.array([[w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
                  [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
                  [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z]])
    return q / (w * w + x * x + y * y + z * z)


def internal(structure, nodes):
    """Internal forces in units of E w²."""
    return structure.internal_force(nodes) / (YOUNG * WIDTH**2)


def assert_it_is_linear_elasticity(structure):
    """The stiffness at rest is that of scikit-fem's linear elements."""
    mesh = structure.mesh
    basis = Basis(MeshTet(mesh.nodes.T, mesh.tetrahedra.T), ElementVector(ElementTetP1()))
    lame = elements.lame_parameters(YOUNG, structure.mechanics.poisson)
    rows = basis.nodal_dofs[:, structure.sparsity.order].T.ravel()
    expected = linear_elasticity(*lame).assemble(basis).tocsr()[rows][:, rows]
    warped = structure.sparsity.matrix(structure.warped_stiffness(mesh.nodes))
    for found in (warped, structure.tangent(mesh.nodes, SLACK)):
        assert abs(found - expected).max() <= 1e-12 * abs(expected).max()


@pytest.mark.parametrize("law", LAWS)
def test_the_stiffness_at_rest_is_that_of_linear_elasticity(body, law):
    assert_it_is_linear_elasticity(body(law, clamped=[], young=YOUNG))
    assert_it_is_linear_elasticity(body(law, young=YOUNG, poisson=0.3))


@pytest.mark.parametrize("law", LAWS)
def test_the_stiffness_of_the_authors_trunk_at_rest_is_that_of_linear_elasticity(measurements, body, law):
    mesh = read_mesh(measurements("meshes") / "trunk.vtk")
    assert_it_is_linear_elasticity(body(law, mesh=mesh, young=YOUNG))


def test_the_lame_parameters_are_those_of_a_bar_under_tension():
    """σ = λ tr(ε) + 2 μ ε with ε = (1, −ν, −ν) must give σ = (E, 0, 0)."""
    lame, shear = elements.lame_parameters(2.0, 0.3)
    np.testing.assert_allclose(lame * (1 - 2 * 0.3) + 2 * shear * np.array([1, -0.3, -0.3]), [2.0, 0, 0], atol=1e-15)


# rigid motions

@pytest.mark.parametrize("law", LAWS)
def test_no_rigid_motion_makes_a_force(body, arm, law):
    structure, rng = body(law, young=YOUNG), np.random.default_rng(0)
    for turn in (np.eye(3), np.diag([1, -1, -1]), np.diag([-1, -1, 1]), *(rotation(rng) for _ in range(20))):
        assert np.abs(internal(structure, arm.nodes @ turn.T + rng.uniform(-1, 1, 3))).max() < 1e-12


@pytest.mark.parametrize("law", LAWS)
def test_forces_turn_with_the_body(body, arm, deform, law):
    structure, turn, bent = body(law, young=YOUNG), rotation(np.random.default_rng(1)), deform(arm.nodes)
    force = internal(structure, bent)
    assert np.abs(force).max() > 1e-3
    np.testing.assert_allclose(internal(structure, bent @ turn.T + 0.1), force @ turn.T, atol=1e-12)


@pytest.mark.parametrize("law", LAWS)
def test_internal_forces_have_no_resultant(body, arm, deform, law):
    force = internal(body(law, young=YOUNG), deform(arm.nodes))
    np.testing.assert_allclose(force.sum(axis=0), 0, atol=1e-13)


def test_neo_hookean_forces_have_no_moment(body, arm, deform):
    bent = deform(arm.nodes)
    force = internal(body("neo_hookean", young=YOUNG), bent)
    assert np.abs(np.cross(bent, force).sum(axis=0)).max() < 1e-13 * 0.1


def test_the_warped_stiffness_of_a_tetrahedron_is_semidefinite_with_six_zero_modes(body):
    rng = np.random.default_rng(2)
    mesh = TetrahedralMesh(0.01 * np.array([[0.0, 0, 0], [1, 0.1, 0], [0.2, 1, 0], [0.1, 0.3, 1]]), [[0, 1, 2, 3]])
    structure = body("corotational", mesh=mesh, clamped=[])
    for _ in range(10):
        deformed = mesh.nodes @ rotation(rng).T + rng.uniform(-2e-3, 2e-3, (4, 3))
        matrix = structure.sparsity.matrix(structure.warped_stiffness(deformed)).toarray()
        np.testing.assert_allclose(matrix, matrix.T, atol=1e-13 * matrix.max())
        values = np.linalg.eigvalsh(matrix) / matrix.max()
        assert np.abs(values[:6]).max() < 1e-13 and values[6] > 1e-2


def test_the_warped_stiffness_of_a_turned_body_has_its_six_rigid_modes(body, arm):
    structure, turn = body("corotational", clamped=[]), rotation(np.random.default_rng(3))
    nodes = arm.nodes @ turn.T
    matrix = structure.sparsity.matrix(structure.warped_stiffness(nodes)).toarray()
    values = np.linalg.eigvalsh(matrix) / matrix.max()
    assert np.abs(values[:6]).max() < 1e-13 and values[6] > 1e-5
    spins = np.cross(np.eye(3)[:, None], nodes[None])
    for moved in (*spins, *np.broadcast_to(np.eye(3)[:, None], spins.shape)):
        assert np.abs(matrix @ structure.sparsity.gather(moved)).max() < 1e-12 * matrix.max()


# affine deformations: every tetrahedron has the same stress P, and nodal forces are those of P on the surface

def tractions(mesh, stress):
    """∮ φ_a P n dA of every node, (N, 3) N: a third of P times the area vector of each of its triangles."""
    a, b, c = mesh.nodes[mesh.surface].swapaxes(0, 1)
    force = np.zeros_like(mesh.nodes)
    np.add.at(force, mesh.surface, (np.cross(b - a, c - a) / 6 @ stress.T)[:, None])
    return force


def inner(mesh):
    """Numbers of the nodes not on the surface."""
    return np.setdiff1d(np.arange(len(mesh.nodes)), mesh.surface)


def test_the_neo_hookean_law_passes_the_patch_test_at_large_strain(body, arm):
    """P = μ (F − F⁻ᵀ) + λ ln det F · F⁻ᵀ; no force on the nodes inside."""
    gradient = np.array([[1.3, 0.2, -0.1], [0.05, 0.9, 0.3], [-0.2, 0.1, 1.1]])
    lame, shear = elements.lame_parameters(YOUNG, 0.45)
    inverse = np.linalg.inv(gradient).T
    stress = shear * (gradient - inverse) + lame * np.log(np.linalg.det(gradient)) * inverse
    force = internal(body("neo_hookean", young=YOUNG), arm.nodes @ gradient.T)
    np.testing.assert_allclose(force, tractions(arm, stress) / (YOUNG * WIDTH**2), atol=1e-12)
    assert len(inner(arm)) == 9 and np.abs(force[inner(arm)]).max() < 1e-12


def test_the_edge_frame_law_passes_the_patch_test_of_a_turned_dilation(body, arm):
    """F = c R: P = (3 λ + 2 μ)(c − 1) R."""
    lame, shear = elements.lame_parameters(YOUNG, 0.45)
    turn = rotation(np.random.default_rng(4))
    force = internal(body("corotational", young=YOUNG), 1.2 * arm.nodes @ turn.T)
    expected = tractions(arm, 0.2 * (3 * lame + 2 * shear) * turn) / (YOUNG * WIDTH**2)
    np.testing.assert_allclose(force, expected, atol=1e-12)
    assert np.abs(force[inner(arm)]).max() < 1e-12


def test_the_edge_frame_law_passes_the_patch_test_to_second_order_in_the_strain(body, arm):
    """P = R (λ tr(ε) I + 2 μ ε) + O(ε²): each tetrahedron turns with edges of its own, which a strain turns too."""
    structure, lame, shear = body("corotational", young=YOUNG), *elements.lame_parameters(YOUNG, 0.45)
    strain = np.array([[1.0, 0.3, -0.2], [0.3, -0.5, 0.4], [-0.2, 0.4, 0.2]])
    turn, errors = rotation(np.random.default_rng(5)), []
    for size in (1e-2, 5e-3, 2.5e-3):
        stress = turn @ (lame * np.trace(strain) * np.eye(3) + 2 * shear * strain) * size
        force = internal(structure, arm.nodes @ (turn @ (np.eye(3) + size * strain)).T)
        errors.append(np.abs(force - tractions(arm, stress) / (YOUNG * WIDTH**2)).max())
    np.testing.assert_allclose(np.log2(np.array(errors[:-1]) / errors[1:]), 2, atol=0.05)


# the edge frame

def test_the_edge_frame_has_the_edge_and_the_normal_of_the_face():
    frame = np.empty((3, 3))
    elements.edge_frame(np.array([[0.0, 0, 0], [0, 2, 0], [-3, 1, 0], [0, 0, 1]]), np.arange(4), frame)
    np.testing.assert_allclose(frame, [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-15)


@pytest.mark.parametrize(("node", "direction"), [(1, (1, 0, 0)), (2, (1, 0, 0)), (2, (0, 1, 0)),
                                                 (3, (1, 0, 0)), (3, (0, 1, 0)), (3, (0, 0, 1))])
def test_the_force_is_linear_in_the_motions_that_do_not_turn_the_edge_frame(body, node, direction):
    """Node 1 along its edge, node 2 in the face, node 3 anywhere."""
    corner = 0.01 * np.array([[0.0, 0, 0], [1, 0, 0], [0.4, 1, 0], [0.2, 0.3, 1]])
    structure = body("corotational", mesh=TetrahedralMesh(corner, [[0, 1, 2, 3]]), clamped=[])
    moved = np.zeros((4, 3))
    moved[node] = 1e-3 * np.array(direction)
    forces = [structure.internal_force(corner + k * moved) for k in range(4)]
    np.testing.assert_allclose(np.diff(forces, n=2, axis=0), 0, atol=1e-13 * np.abs(forces[3]).max())
    assert np.abs(forces[1]).max() > 0


# what is inverted or impossible

def test_an_inverted_tetrahedron_has_no_neo_hookean_force(body, arm):
    assert np.isnan(body("neo_hookean").internal_force(arm.nodes * [1, 1, -1])).all()
    assert np.isfinite(body("corotational").internal_force(arm.nodes * [1, 1, -1])).all()


@pytest.mark.parametrize(("young", "poisson"), [(0, 0.3), (-1, 0.3), (np.inf, 0.3), (np.nan, 0.3), (1, 0.5), (1, -1),
                                                (1, np.nan)])
def test_an_impossible_material_is_refused(young, poisson):
    with pytest.raises(ValueError, match="expected a positive modulus"):
        elements.lame_parameters(young, poisson)
