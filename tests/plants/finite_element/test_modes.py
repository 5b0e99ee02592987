"""Frequencies and the rates of the step map, against dense algebra, differences, and the published robots."""

from functools import cache

import numpy as np
import pytest
from scipy.linalg import eigh

from ssmr_torch.plants.diamond import Diamond
from ssmr_torch.plants.finite_element.modes import continuous_eigenvalues, step_map_eigenvalues, undamped_frequencies
from ssmr_torch.plants.trunk import Trunk


@pytest.fixture
def diamond(measurements):
    """(timestep) -> the diamond on the authors' mesh, at rest."""
    return lambda timestep: made(measurements("meshes") / "diamond.vtu", timestep)


@cache
def made(mesh, timestep):
    return Diamond(mesh=mesh, timestep=timestep)


def test_the_frequencies_are_those_of_the_dense_problem(robot):
    arm = robot()
    structure = arm.structure
    stiffness = structure.sparsity.matrix(structure.warped_stiffness(arm.positions)).toarray()
    expected = np.sqrt(eigh(stiffness, np.diag(structure.mass), eigvals_only=True)[:6])
    np.testing.assert_allclose(undamped_frequencies(arm, 6), expected, rtol=1e-9)


def test_a_slender_cantilever_swings_as_beam_theory_says(box, robot):
    """ω = 1.8751² √(E I / (ρ A L⁴)) for ν = 0; linear elements are stiffer, the less so the finer they are."""
    expected = 1.875104**2 * np.sqrt(60e3 * 0.02**2 / 12 / (0.04 / (0.02**2 * 0.1)) / 0.1**4)
    excess = []
    for cells in ((2, 2, 10), (4, 4, 20)):
        arm = robot(mesh=box(cells, (0.02, 0.02, 0.1)), poisson=0.0, gravity=(0, 0, -0.1), mass_distribution="volume")
        excess.append(undamped_frequencies(arm, 1)[0] / expected - 1)
    # shear and rotary inertia lower the frequency of a beam five times as long as wide by 4 %
    assert 0 < excess[1] + 0.04 < 0.35 * (excess[0] + 0.04), excess


def step_map_jacobian(arm, step=1e-8):
    """∂(q₊, v₊)/∂(q, v) at rest by differences of the robot's own steps; free degrees of freedom."""
    sparsity, rest, size = arm.structure.sparsity, arm.positions, arm.structure.sparsity.size

    def after(change):
        positions = sparsity.scatter(sparsity.gather(rest) + change[:size], rest)
        arm.reset(state=np.concatenate([positions.ravel(), change[size:]]))
        arm.step(arm.input_bounds[0])
        return np.concatenate([sparsity.gather(arm.positions - rest), arm.state[rest.size:]])

    # velocities are larger than displacements by a frequency
    scales, still = np.repeat([step, 100 * step], size), after(np.zeros(2 * size))
    return np.stack([(after(scale * unit) - still) / scale for scale, unit in zip(scales, np.eye(2 * size))], axis=1)


def test_the_rates_of_the_step_map_are_those_of_the_actual_step(robot):
    arm = robot(gravity=(2.0, 1.0, -9.81), input_bounds=(0.1, 2.0))
    found = step_map_eigenvalues(arm, 8)
    expected = np.log(np.linalg.eigvals(step_map_jacobian(arm)).astype(complex)) / arm.timestep
    expected = expected[np.argsort(-expected.real)][:8]
    for rate in found:
        assert np.abs(expected - rate).min() < 1e-4 * abs(rate), (found, expected)
    assert (np.diff(found.real) < 1e-9).all()


def test_the_rates_come_in_conjugate_pairs_and_none_grows(robot):
    found = step_map_eigenvalues(robot(), 8)
    assert (found.real < 0).all()
    for rate in found:
        assert np.abs(found - rate.conj()).min() < 1e-8 * abs(rate)


def test_the_step_map_is_that_of_backward_euler_only(robot):
    with pytest.raises(ValueError, match="expected a robot with scheme=backward_euler"):
        step_map_eigenvalues(robot("bdf2"))


@pytest.mark.parametrize("scheme", ["backward_euler", "bdf2"])
def test_the_continuous_eigenvalues_are_those_of_the_dense_problem_nearest_to_the_lowest_frequency(robot, scheme):
    """Of [[0, I], [−M⁻¹ K, −M⁻¹ D]]."""
    arm = robot(scheme, gravity=(2.0, 1.0, -9.81))
    at, shift = arm.linearization(), undamped_frequencies(arm, 1)[0]
    zero, one = np.zeros_like(at.stiffness.toarray()), np.eye(len(at.mass))
    inverse = 1 / at.mass[:, None]
    rates = np.linalg.eigvals(np.block([[zero, one], [-inverse * at.stiffness.toarray(),
                                                      -inverse * at.damping.toarray()]]))
    expected = rates[np.argsort(np.abs(rates - shift))][:8]
    found = continuous_eigenvalues(arm, 8)
    assert np.abs(found[:, None] - expected).min(axis=1).max() < 1e-6 * shift
    assert np.abs(found[:, None] - expected).min(axis=0).max() < 1e-6 * shift
    assert (np.diff(found.real) < 1e-9).all()


@pytest.mark.parametrize(("scheme", "at_rest"), [("backward_euler", step_map_eigenvalues),
                                                 ("bdf2", continuous_eigenvalues)])
def test_the_eigenvalues_of_a_robot_are_those_at_rest_wherever_it_is(robot, scheme, at_rest):
    arm = robot(scheme)
    expected = at_rest(arm, 12)
    arm.step([1.0, 0, 0, 0])
    before = arm.state
    np.testing.assert_array_equal(arm.eigenvalues, expected)
    np.testing.assert_array_equal(arm.state, before)


# the published robots

def test_the_diamond_has_its_published_frequencies(diamond):
    np.testing.assert_allclose(undamped_frequencies(diamond(0.01)), [20.005, 20.376, 21.185, 29.163, 40.705], atol=5e-4)


@pytest.mark.parametrize(("timestep", "rates"), [
    (0.01, [-5.16 + 16.06j, -5.22 + 16.24j, -5.41 + 17.55j]),
    pytest.param(0.001, [-3.53 + 16.85j], marks=pytest.mark.slow),
])
def test_the_diamonds_step_has_its_published_rates(diamond, timestep, rates):
    found = step_map_eigenvalues(diamond(timestep))
    assert_rates(found[found.imag > 0][:len(rates)], rates)


def test_the_trunks_step_has_its_published_rates(measurements):
    found = step_map_eigenvalues(Trunk(mesh=measurements("meshes") / "trunk.vtk"))
    swinging, creeping = found[found.imag > 1e-3], found[np.abs(found.imag) < 1e-3]
    assert_rates(swinging[:2], [-1.53 + 10.72j, -1.57 + 10.77j])
    np.testing.assert_allclose(creeping.real[:2], [-9.4, -9.5], atol=0.05)


def assert_rates(found, published):
    """To the printed digits."""
    np.testing.assert_allclose(found.real, np.real(published), atol=5.1e-3)
    np.testing.assert_allclose(found.imag, np.imag(published), atol=5.1e-3)
