"""Forces are gradients of the energy, tangents are derivatives of forces, masses add up."""

import numpy as np
import pytest
from skfem import Basis, BilinearForm, ElementTetP1, MeshTet

from ssmr_torch.plants.finite_element.structure import Mechanics

TENSIONS = np.array([0.7, 0.0, 1.3, 0.2])
SLACK = np.zeros(4)


def directions(structure, count=5):
    return np.random.default_rng(0).standard_normal((count, structure.sparsity.size))


def moved(structure, positions, way):
    """All nodes, the free ones moved by `way` (n,)."""
    return structure.sparsity.scatter(structure.sparsity.gather(positions) + way, positions)


def slope(function, way, step=1e-7):
    return (function(step * way) - function(-step * way)) / (2 * step)


# energy and forces

def test_the_force_of_the_neo_hookean_law_and_of_gravity_is_minus_the_gradient_of_the_energy(body, arm, deform):
    structure, bent = body("neo_hookean", gravity=(3.0, -2.0, 5.0)), deform(arm.nodes)
    still, force = np.zeros(structure.sparsity.size), structure.forces(bent, SLACK)
    for way in directions(structure):
        found = slope(lambda d: structure.energy(moved(structure, bent, d), still), way)
        np.testing.assert_allclose(force @ way, -found, rtol=1e-6)


def test_the_energy_of_the_undeformed_body_is_that_of_its_weight(body, arm):
    """−∑ m g·x, here m g times half the length."""
    structure = body(gravity=(0, 0, -9.81), mass_distribution="volume")
    np.testing.assert_allclose(structure.energy(arm.nodes, np.zeros(structure.sparsity.size)), 0.04 * 9.81 * 0.05,
                               rtol=1e-12)


def test_velocities_add_their_kinetic_energy(body, arm):
    structure = body()
    velocities = np.tile([0.1, 0.2, -0.2], structure.sparsity.size // 3)
    added = structure.energy(arm.nodes, velocities) - structure.energy(arm.nodes, 0 * velocities)
    free = 90 / 99  # the base holds a share of the mass, and does not move
    np.testing.assert_allclose(added, 0.5 * 0.04 * free * 0.3**2, rtol=1e-11)


def test_the_edge_frame_law_has_no_energy(body, arm):
    structure = body("corotational")
    with pytest.raises(ValueError, match="has no energy"):
        structure.energy(arm.nodes, np.zeros(structure.sparsity.size))


def test_forces_are_weight_and_cables_less_the_internal_ones(body, arm, deform):
    structure, bent = body("corotational"), deform(arm.nodes)
    cables = structure.cables.input_matrix(bent) @ TENSIONS
    weight = structure.nodal_mass[:, None] * [0, 0, -9.81]
    expected = structure.sparsity.gather(weight + cables - structure.internal_force(bent))
    np.testing.assert_allclose(structure.forces(bent, TENSIONS), expected, atol=1e-14)


# tangents

@pytest.mark.parametrize("law", ["corotational", "neo_hookean"])
@pytest.mark.parametrize("tensions", [SLACK, TENSIONS], ids=["slack", "pulled"])
def test_the_tangent_is_minus_the_derivative_of_the_forces(body, arm, deform, law, tensions):
    structure, bent = body(law), deform(arm.nodes)
    tangent = structure.tangent(bent, tensions)
    for way in directions(structure):
        found = slope(lambda d: structure.forces(moved(structure, bent, d), tensions), way)
        np.testing.assert_allclose(tangent @ way, -found, atol=2e-7 * np.abs(found).max())


def test_the_stiffness_that_newton_uses_is_the_exact_tangent_of_the_neo_hookean_law(body, arm, deform):
    structure, bent = body("neo_hookean"), deform(arm.nodes)
    found = structure.zeros()
    structure.forces(bent, TENSIONS, found)
    expected = structure.tangent(bent, TENSIONS)
    assert abs(structure.sparsity.matrix(found) - expected).max() <= 1e-13 * abs(expected).max()


def test_the_stiffness_that_backward_euler_uses_is_the_warped_one_whatever_the_tensions(body, arm, deform):
    structure, bent = body("corotational"), deform(arm.nodes)
    found = structure.zeros()
    structure.forces(bent, TENSIONS, found)
    np.testing.assert_array_equal(found, structure.warped_stiffness(bent))


def test_the_tangent_of_the_edge_frame_law_is_unsymmetric_where_the_body_is_strained(body, arm, deform):
    structure = body("corotational")
    for nodes, asymmetric in ((arm.nodes, False), (deform(arm.nodes), True)):
        tangent = structure.tangent(nodes, TENSIONS)
        assert (abs(tangent - tangent.T).max() > 1e-3 * abs(tangent).max()) == asymmetric


def test_both_laws_share_the_warped_stiffness(body, arm, deform):
    bent = deform(arm.nodes)
    matrices = [s.sparsity.matrix(s.warped_stiffness(bent)).toarray()[np.ix_(*[_rows(s)] * 2)]
                for s in (body("corotational"), body("neo_hookean"))]
    np.testing.assert_allclose(*matrices, atol=1e-12 * np.abs(matrices[0]).max())


def _rows(structure):
    """Degrees of freedom in the order of the nodes."""
    return (3 * np.argsort(structure.sparsity.order)[:, None] + np.arange(3)).ravel()


# the linearization

@pytest.mark.parametrize("law", ["corotational", "neo_hookean"])
def test_the_linearization_has_the_matrices_of_the_equation_of_motion(body, arm, deform, law):
    structure, bent = body(law), deform(arm.nodes)
    found = structure.linearization(bent, TENSIONS)
    warped = structure.sparsity.matrix(structure.warped_stiffness(bent))
    damping = 1.0 * np.diag(structure.mass) + 0.01 * warped.toarray()
    np.testing.assert_allclose(found.damping.toarray(), damping, atol=1e-14 * damping.max())
    np.testing.assert_array_equal(found.mass, structure.nodal_mass[found.free_nodes].repeat(3))
    np.testing.assert_array_equal(found.residual, structure.forces(bent, TENSIONS))
    for way in directions(structure, 2):
        pull = slope(lambda d: structure.forces(moved(structure, bent, d), TENSIONS), way)
        np.testing.assert_allclose(found.stiffness @ way, -pull, atol=2e-7 * np.abs(pull).max())
    more = structure.forces(bent, TENSIONS + [0, 1, 0, 0]) - structure.forces(bent, TENSIONS)
    np.testing.assert_allclose(found.input_matrix @ [0, 1, 0, 0], more, atol=1e-12)


# masses

def test_equal_shares_go_to_all_nodes_clamped_ones_too(body):
    np.testing.assert_allclose(body(mass_distribution="nodal").nodal_mass, 0.04 / 99, rtol=1e-13)


def test_shares_by_volume_are_the_integrals_of_the_shape_functions(body, arm):
    basis = Basis(MeshTet(arm.nodes.T, arm.tetrahedra.T), ElementTetP1())
    consistent = BilinearForm(lambda u, v, _: u * v).assemble(basis)
    expected = consistent.sum(axis=1) * 0.04 / (0.02 * 0.02 * 0.1)
    np.testing.assert_allclose(body(mass_distribution="volume").nodal_mass, np.ravel(expected), rtol=1e-12)


def test_the_payload_hangs_at_the_tip(body, arm):
    more = body(payload=0.02).nodal_mass - body().nodal_mass
    assert np.flatnonzero(more).tolist() == [arm.nearest_node((0, 0, 0.1))]
    np.testing.assert_allclose(more.sum(), 0.02, rtol=1e-13)


def test_the_stiffness_scale_multiplies_the_modulus(body, arm, deform):
    bent = deform(arm.nodes)
    np.testing.assert_allclose(body(stiffness_scale=1.3).internal_force(bent),
                               1.3 * body().internal_force(bent), atol=1e-12)


# material data

GOOD = {"young": 1e5, "poisson": 0.4, "mass": 1.0, "mass_damping": 0.0, "stiffness_damping": 0.0, "gravity": (0, 0, 0)}


@pytest.mark.parametrize(("changes", "match"), [
    ({"young": 0}, "young is 0 Pa"), ({"poisson": 0.5}, "poisson is 0.5"),
    ({"stiffness_scale": 0}, "stiffness_scale is 0"), ({"stiffness_scale": -1}, "stiffness_scale is -1"),
    ({"mass": 0}, "mass is 0 kg"),
    ({"mass": np.nan}, "mass is nan"),
    ({"payload": -1e-3}, "payload is -0.001 kg"), ({"mass_damping": -1}, "mass_damping is -1 1/s; expected"),
    ({"stiffness_damping": np.inf}, "stiffness_damping is inf s; expected"), ({"law": "hookean"}, "expected one of"),
    ({"mass_distribution": "even"}, "expected one of"),
], ids=str)
def test_impossible_mechanics_are_refused(changes, match):
    with pytest.raises(ValueError, match=match):
        Mechanics(**{**GOOD, **changes})


@pytest.mark.parametrize("gravity", [(0, 0), (0, 0, np.nan), (0, 0, 0, 0)], ids=str)
def test_a_gravity_that_is_not_a_vector_is_refused(gravity):
    with pytest.raises(ValueError, match="gravity"):
        Mechanics(**{**GOOD, "gravity": gravity})


def test_mechanics_change_by_name_and_refuse_unknown_names():
    changed = Mechanics(**GOOD).changed({"payload": 0.1, "stiffness_scale": 1.2})
    assert (changed.payload, changed.stiffness_scale, changed.young) == (0.1, 1.2, 1e5)
    assert changed.nominal == Mechanics(**GOOD)
    with pytest.raises(ValueError, match="unknown \\['elasticity'\\]; expected some of .*young"):
        Mechanics(**GOOD).changed({"elasticity": 1.0})
