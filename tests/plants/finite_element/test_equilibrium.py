"""Equilibria balance all forces, are where motion ends, and converge to continuum mechanics under refinement."""

import numpy as np
import pytest
from skfem import Basis, ElementTetP1, ElementVector, LinearForm, MeshTet
from skfem.helpers import dot

from ssmr_torch.plants.finite_element.elements import lame_parameters
from ssmr_torch.plants.finite_element.equilibrium import equilibrium
from ssmr_torch.plants.finite_element.linear_solvers import linear_solver
from ssmr_torch.plants.finite_element.time_stepping import DivergenceError

LAWS = ("corotational", "neo_hookean")
PULLED = np.array([1.0, 0.0, 0.3, 0.5])
SLACK = np.zeros(4)


def residual(structure, positions, tensions):
    """In units of the weight."""
    return np.linalg.norm(structure.forces(positions, tensions)) / (0.04 * 9.81)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("tensions", [SLACK, PULLED], ids=["slack", "pulled"])
def test_all_forces_balance(body, law, tensions):
    structure = body(law)
    assert residual(structure, equilibrium(structure, tensions), tensions) < 1e-8


@pytest.mark.parametrize("law", LAWS)
def test_clamped_nodes_stay(body, arm, law):
    base = arm.nodes[:, 2] == 0
    np.testing.assert_array_equal(equilibrium(body(law), PULLED)[base], arm.nodes[base])


@pytest.mark.parametrize("law", LAWS)
def test_it_is_the_same_from_a_guess_nearby_which_stays_as_it_was(body, law):
    structure = body(law)
    guess = equilibrium(structure, 0.8 * PULLED)
    kept = guess.copy()
    np.testing.assert_allclose(equilibrium(structure, PULLED, guess), equilibrium(structure, PULLED), atol=1e-9)
    np.testing.assert_array_equal(guess, kept)


@pytest.mark.parametrize(("law", "before"), [("corotational", (0, 2, 0, 0)), ("corotational", (0, 0, 2, 0)),
                                             ("neo_hookean", (4, 0, 0, 0))], ids=str)
def test_it_is_the_same_from_the_equilibrium_of_another_pull(body, law, before):
    structure = body(law)
    guess = equilibrium(structure, np.array(before, dtype=float))
    np.testing.assert_allclose(equilibrium(structure, PULLED, guess), equilibrium(structure, PULLED), atol=1e-9)


@pytest.mark.parametrize("scheme", ["backward_euler", "generalized_alpha", "bdf2"])
def test_a_robot_under_constant_tensions_comes_to_the_equilibrium(robot, scheme):
    """The slowest mode loses a factor of 10⁶ within 4 s."""
    arm = robot(scheme, mass_damping=4.0)
    for _ in range(400):
        arm.step(PULLED)
    np.testing.assert_allclose(arm.positions, equilibrium(arm.structure, PULLED), atol=1e-7)


@pytest.mark.parametrize("law", LAWS)
def test_a_pull_beyond_the_body_is_refused_with_the_residual(body, law):
    with pytest.raises(DivergenceError, match="no equilibrium under the tensions .* the residual is .* expected .* N"):
        equilibrium(body(law, young=10.0), 1e3 * np.ones(4))


@pytest.mark.parametrize("scheme", ["backward_euler", "generalized_alpha", "bdf2"])
def test_a_weightless_robot_rests_undeformed(robot, arm, scheme):
    weightless = robot(scheme, gravity=(0.0, 0.0, 0.0))
    weightless.step(SLACK)
    np.testing.assert_allclose(weightless.positions, arm.nodes, atol=1e-12)


# against continuum mechanics

def pulled_bar(box, body, cells, law):
    """A bar of 1 m under its own weight ρ g = 10⁻³ E / m, ν = 0."""
    mesh = box((2, 2, cells), (0.2, 0.2, 1.0))
    structure = body(law, mesh=mesh, young=1e6, poisson=0.0, mass=40.0, gravity=(0, 0, 1.0),
                     mass_distribution="volume")
    return mesh, equilibrium(structure, SLACK)


@pytest.mark.parametrize("law", LAWS)
def test_a_hanging_bar_grows_by_its_weight(box, body, law):
    """u(z) = ρ g (z − z²/2) / E: linear elements are exact at the nodes of a bar, here to 1 % of what the end moves,

    as the strain is 10⁻³ and the nodes of the end do not carry equal shares of it.
    """
    mesh, found = pulled_bar(box, body, 8, law)
    z = mesh.nodes[:, 2]
    np.testing.assert_allclose((found - mesh.nodes)[:, 2], 1e-3 * (z - z**2 / 2), atol=5e-6)
    np.testing.assert_allclose((found - mesh.nodes)[:, :2], 0, atol=5e-6)


def cube_error(box, body, cells):
    """L2 error of the discrete solution of a problem that u = (1, −2, 0.5) s(x) s(y) s(z), s = sin π·, solves.

    −div σ(u) = b on the unit cube, u = 0 on its surface; b follows from σ = λ div u I + 2 μ sym ∇u, so that
    b = −(λ + μ) ∇ div u − μ Δ u.
    """
    mesh = box((cells,) * 3, (1.0, 1.0, 1.0)).moved(np.eye(3), (0.5, 0.5, 0.0))
    boundary = ((mesh.nodes < 1e-9) | (mesh.nodes > 1 - 1e-9)).any(axis=1)
    structure = body("corotational", mesh=mesh, clamped=np.flatnonzero(boundary), young=1.0, poisson=0.3)
    lame, shear = lame_parameters(1.0, 0.3)
    slope = np.array([1.0, -2.0, 0.5])

    def exact(x):
        return np.einsum("i,...->i...", slope, np.prod(np.sin(np.pi * x), axis=0))

    def load(x):
        sine, cosine = np.sin(np.pi * x), np.cos(np.pi * x)
        curvatures = [[-np.prod(sine, axis=0) if i == j else cosine[i] * cosine[j] * sine[3 - i - j]
                       for j in range(3)] for i in range(3)]  # ∂_i ∂_j of the product of sines, over π²
        gradient = np.einsum("j,ij...->i...", slope, np.array(curvatures))
        return np.pi**2 * (3 * shear * exact(x) - (lame + shear) * gradient)

    basis = Basis(MeshTet(mesh.nodes.T, mesh.tetrahedra.T), ElementVector(ElementTetP1()), intorder=4)
    right = LinearForm(lambda v, w: dot(load(w.x), v)).assemble(basis)[basis.nodal_dofs.T]
    solver = linear_solver("block_ldl", structure.sparsity)
    moved = solver.solve(structure.warped_stiffness(mesh.nodes), structure.sparsity.gather(right))
    nodal = structure.sparsity.scatter(moved, np.zeros_like(mesh.nodes))
    field = np.zeros(basis.N)
    field[basis.nodal_dofs.T] = nodal
    difference = basis.interpolate(field) - exact(basis.global_coordinates())
    return np.sqrt((difference**2 * basis.dx).sum())


def test_the_elements_converge_to_linear_elasticity_at_second_order(box, body):
    errors = np.array([cube_error(box, body, cells) for cells in (4, 8, 12)])
    orders = np.log(errors[:-1] / errors[1:]) / np.log([8 / 4, 12 / 8])
    assert (orders > 1.75).all() and (orders < 2.2).all(), orders
