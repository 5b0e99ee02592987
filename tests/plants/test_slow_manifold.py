"""The analytic plant keeps what its closed form promises."""

from itertools import product

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from ssmr_torch.collection.excitation import RandomSteps, SmoothRandom
from ssmr_torch.plants.slow_manifold import SlowManifold


def slow_states(count, seed=0):
    """Slow states all over the working range."""
    rng = np.random.default_rng(seed)
    return np.concatenate([rng.uniform(-1.2, 1.2, (count, 3)), rng.uniform(-8.0, 8.0, (count, 3))], axis=1)


def run(plant, inputs):
    states = [plant.state]
    for u in inputs:
        plant.step(u)
        states.append(plant.state)
    return np.array(states)


def directional_difference(function, point, direction, step=1e-5):
    return (function(point + step * direction) - function(point - step * direction)) / (2 * step)


def test_the_manifold_is_invariant_without_input():
    plant = SlowManifold()
    for xi in slow_states(5):
        plant.reset(state=plant.on_manifold(xi))
        states = run(plant, np.zeros((200, 4)))
        assert np.abs(states[:, 6:] - plant.manifold(states[:, :6])).max() < 1e-12


def test_the_closed_form_satisfies_the_invariance_equation():
    plant, xi = SlowManifold(), slow_states(50)
    rate = plant.rate(plant.on_manifold(xi), np.zeros(4))
    transported = plant.manifold_jacobian(xi) @ plant.reduced_drift(xi)[..., None]
    np.testing.assert_allclose(rate[:, 6:], transported[..., 0], rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(rate[:, :6], plant.reduced_drift(xi))


def test_the_manifold_attracts_at_the_fast_rates():
    plant = SlowManifold()
    xi, offset = slow_states(1)[0], np.array([0.3, -0.2, 0.1, 0.4])
    plant.reset(state=plant.on_manifold(xi) + np.concatenate([np.zeros(6), offset]))
    states = run(plant, np.zeros((10, 4)))
    time = plant.timestep * np.arange(11)[:, None]
    np.testing.assert_allclose(states[:, 6:] - plant.manifold(states[:, :6]),
                               offset * np.exp(-plant.fast_rates * time), rtol=1e-9, atol=1e-12)


def test_the_manifold_is_tangent_to_the_slow_eigenspace():
    plant, rest = SlowManifold(), np.zeros(6)
    np.testing.assert_array_equal(plant.manifold(rest), np.zeros(4))
    np.testing.assert_array_equal(plant.manifold_jacobian(rest), np.zeros((4, 6)))


def test_the_manifold_jacobian_is_the_derivative_of_the_manifold():
    plant = SlowManifold()
    for xi, direction in zip(slow_states(20), slow_states(20, seed=1), strict=True):
        np.testing.assert_allclose(plant.manifold_jacobian(xi) @ direction,
                                   directional_difference(plant.manifold, xi, direction),
                                   rtol=1e-7, atol=1e-7)


def test_a_step_solves_the_full_equations_with_the_input_held():
    plant = SlowManifold()
    inputs = RandomSteps(hold=0.05)(np.random.default_rng(0), 40, plant.timestep, plant.input_bounds)
    state = plant.on_manifold(slow_states(1, seed=2)[0]) + 0.05
    plant.reset(state=state)
    for u in inputs:
        plant.step(u)
        state = solve_ivp(lambda _, x: plant.rate(x, u), (0, plant.timestep), state, "DOP853",
                          rtol=1e-12, atol=1e-13).y[:, -1]
    np.testing.assert_allclose(plant.state, state, rtol=1e-8, atol=1e-8 * np.abs(state).max())


def test_one_step_is_accurate_to_a_billionth():
    plant, u = SlowManifold(), np.array([1.5, 0.0, 0.7, 0.2])
    for xi in slow_states(10):
        exact = solve_ivp(lambda _, x: plant.slow_rate(x, u), (0, plant.timestep), xi, "DOP853",
                          rtol=1e-13, atol=1e-13).y[:, -1]
        error = np.linalg.norm(plant.flow(xi, plant.timestep, u) - exact)
        assert error < 1e-9 * np.linalg.norm(exact)


def test_the_integrator_has_order_four():
    xi, u = slow_states(1, seed=4)[0], np.array([1.0, 0.0, 0.5, 0.0])
    exact = SlowManifold(substeps=64).flow(xi, 0.4, u)
    errors = [np.linalg.norm(SlowManifold(substeps=n).flow(xi, 0.4, u) - exact) for n in (1, 2, 4)]
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    np.testing.assert_allclose(orders, 4.0, atol=0.15)


@pytest.mark.parametrize("fast_input_gain", [0.0, 1.0])
def test_the_reduced_dynamics_are_exact_in_the_full_simulation(fast_input_gain):
    plant = SlowManifold(fast_input_gain=fast_input_gain)
    inputs = SmoothRandom()(np.random.default_rng(0), 300, plant.timestep, plant.input_bounds)
    plant.reset()
    states, xi = run(plant, inputs), np.zeros(6)
    for u in inputs:
        xi = plant.flow(xi, plant.timestep, u)
    np.testing.assert_allclose(states[-1, :6], xi, rtol=1e-10, atol=1e-12)
    deviation = np.abs(states[:, 6:] - plant.manifold(states[:, :6])).max()
    assert deviation < 1e-12 if fast_input_gain == 0 else deviation > 0.01


def test_full_force_leaves_the_markers_less_than_a_millimetre_off_the_manifold():
    plant = SlowManifold()
    offset = plant.output_matrix[:, 6:] @ plant.fast_offset @ (1.5 * np.array([*np.eye(4), np.ones(4)]).T)
    tip = np.linalg.norm(offset[:3], axis=0)
    assert (2e-4 < tip).all() and (tip < 1e-3).all()


def test_the_control_field_is_affine_in_the_state_and_the_rate_affine_in_the_input():
    plant = SlowManifold()
    a, b = slow_states(2)
    field = plant.reduced_control_field
    np.testing.assert_allclose(field((a + b) / 2), (field(a) + field(b)) / 2, rtol=1e-12, atol=1e-12)
    assert np.abs(field(a) - field(b)).max() > 1.0
    u = np.array([0.3, 0.1, 1.2, 0.0])
    np.testing.assert_allclose(plant.rate(plant.on_manifold(a), u)[:6], plant.reduced_drift(a) + field(a) @ u)


def test_the_drift_is_a_polynomial_of_degree_three():
    plant, xi = SlowManifold(), slow_states(1)[0]
    along_line = np.array([plant.reduced_drift(s * xi) for s in np.arange(5.0)])
    np.testing.assert_allclose(np.diff(along_line, n=4, axis=0), 0.0, atol=1e-9)
    assert np.abs(np.diff(along_line, n=3, axis=0)).max() > 1.0


def test_the_eigenvalues_are_those_of_the_numeric_jacobian():
    plant = SlowManifold(fast_rate_scale=0.8)
    jacobian = np.array([directional_difference(lambda x: plant.rate(x, np.zeros(4)), np.zeros(10), e)
                         for e in np.eye(10)]).T
    numeric = np.linalg.eigvals(jacobian)
    for eigenvalue in plant.eigenvalues:
        assert np.abs(numeric - eigenvalue).min() < 1e-6
    assert plant.eigenvalues.real.max() < 0


def test_no_combination_of_slow_eigenvalues_resonates_with_a_fast_one():
    plant = SlowManifold()
    slow, fast = plant.eigenvalues[:6], plant.eigenvalues[6:]
    highest = int(np.ceil(np.abs(fast.real).max() / np.abs(slow.real).min()))
    orders = np.array([m for m in product(range(highest + 1), repeat=3) if sum(m) <= highest])
    sums = orders @ (2 * slow[::2].real)
    assert np.abs(sums[:, None] - fast.real).min() > 0.05
    assert np.ptp(np.abs(slow.imag)) > 1.0


def test_the_energy_falls_at_the_rate_of_the_damping_under_constant_forces():
    plant = SlowManifold()
    for xi, u in zip(slow_states(20), np.random.default_rng(0).uniform(0, 1.5, (20, 4)), strict=True):
        change = directional_difference(lambda x: plant.energy(x, u), xi, plant.slow_rate(xi, u), step=1e-7)
        np.testing.assert_allclose(change, -(xi[3:] ** 2) @ np.array([2.4, 2.8, 4.4]), rtol=1e-4, atol=1e-4)


def test_the_rest_is_the_only_equilibrium_of_the_working_range():
    """V is strictly convex there: the numeric Hessian is positive definite on a grid."""
    plant = SlowManifold()
    for q in product(np.linspace(-1.5, 1.5, 7), repeat=3):
        xi = np.array([*q, 0.0, 0.0, 0.0])
        stiffness = -np.array([directional_difference(plant.reduced_drift, xi, e)[3:] for e in np.eye(6)[:3]])
        np.testing.assert_allclose(stiffness, stiffness.T, atol=1e-6)
        assert np.linalg.eigvalsh(stiffness)[0] > 5.0


@pytest.mark.parametrize("excitation", [SmoothRandom(0.25), SmoothRandom(0.4), RandomSteps(0.3)])
def test_the_robot_stays_in_range_for_a_minute_at_full_force_and_then_returns_to_rest(excitation):
    plant = SlowManifold()
    inputs = excitation(np.random.default_rng(1), 6000, plant.timestep, plant.input_bounds)
    plant.reset()
    observations = np.array([plant.step(u) for u in inputs])
    assert 0.02 < np.abs(observations[:, :2]).max() < 0.045
    for _ in range(1500):
        observation = plant.step(np.zeros(4))
    assert np.abs(observation).max() < 1e-8


def test_a_single_cable_at_full_force_moves_the_tip_by_about_twenty_millimetres():
    plant = SlowManifold()
    for cable, axis, sign in ((0, 0, 1), (1, 0, -1), (2, 1, 1), (3, 1, -1)):
        plant.reset()
        for _ in range(1000):
            observation = plant.step(1.5 * np.eye(4)[cable])
        assert 0.018 < sign * observation[axis] < 0.025
        assert observation[2] < -0.004


def test_the_window_ends_in_its_state_and_equals_a_simulated_one():
    plant, delays = SlowManifold(), 4
    plant.reset(state=plant.on_manifold(slow_states(1)[0]))
    states = run(plant, np.zeros((delays, 4)))
    simulated = states @ plant.output_matrix.T
    window = plant.window(states[-1, :6], delays)
    np.testing.assert_allclose(window, simulated, atol=1e-10)
    np.testing.assert_allclose(window[-1], plant.observe_slow(states[-1, :6]), rtol=1e-12, atol=1e-15)
    assert plant.window(slow_states(7), delays).shape == (7, delays + 1, 6)


def test_the_window_rate_is_the_time_derivative_of_the_window():
    plant, step = SlowManifold(), 1e-4
    xi = slow_states(10)
    difference = (plant.window(plant.flow(xi, step), 1) - plant.window(plant.flow(xi, -step), 1)) / (2 * step)
    np.testing.assert_allclose(plant.window_rate(xi, 1), difference, rtol=1e-5, atol=1e-6)


def test_the_observed_rate_contains_the_input():
    plant, u = SlowManifold(), np.array([1.0, 0.0, 0.0, 0.4])
    xi, step = slow_states(5), 1e-4
    later, earlier = plant.flow(xi, step, u), plant.flow(xi, -step, u)
    difference = (plant.observe_slow(later) - plant.observe_slow(earlier)) / (2 * step)
    np.testing.assert_allclose(plant.observe_slow_rate(xi, u), difference, rtol=1e-5, atol=1e-6)


def test_flowing_back_undoes_flowing_forth():
    plant, xi = SlowManifold(), slow_states(10)
    np.testing.assert_allclose(plant.flow(plant.flow(xi, 0.05), -0.05), xi, rtol=1e-8, atol=1e-7)


def test_two_markers_with_one_delay_determine_the_slow_state_but_not_linearly():
    """The window's tangent at rest has rank 6 of 12, and the curved part leaves it by more than 0.1 mm."""
    plant = SlowManifold()
    scaled = np.diag([1.0, 1.0, 1.0, 10.0, 10.0, 10.0])
    tangent = np.array([directional_difference(lambda x: plant.window(x, 1).ravel(), np.zeros(6), e)
                        for e in scaled]).T
    singular_values = np.linalg.svd(tangent, compute_uv=False)
    assert singular_values[-1] > 0.02 * singular_values[0]
    assert np.linalg.matrix_rank(plant.output_matrix) == 6
    basis = np.linalg.qr(tangent)[0]
    windows = plant.window(np.array([[1.0, 0, 0, 0, 0, 0], [0, 1.0, 0, 0, 0, 0]]), 1).reshape(2, 12)
    assert (np.linalg.norm(windows - windows @ basis @ basis.T, axis=1) > 1e-4).all()


def test_the_observed_state_is_the_scaled_state():
    plant = SlowManifold(observe="state")
    state = plant.on_manifold(slow_states(1)[0])
    np.testing.assert_allclose(plant.reset(state=state), 0.02 * state * np.array([1] * 3 + [0.1] * 7))


@pytest.mark.parametrize("arguments", [{"observe": "tip"}, {"timestep": 0.0}, {"substeps": 0},
                                       {"fast_rate_scale": -1.0}, {"input_bounds": (1.5, 0.0)},
                                       {"input_bounds": (0.0, 1.0, 2.0)},
                                       {"input_bounds": (0.0, np.inf)}])
def test_impossible_parameters_are_refused(arguments):
    with pytest.raises(ValueError):
        SlowManifold(**arguments)


def test_a_plant_is_rebuilt_from_its_parameters():
    plant = SlowManifold(input_bounds=[[0, 0, 0, 0], [1, 1, 2, 2]], fast_input_gain=0.5)
    again, u = SlowManifold(**plant.parameters), np.array([1.0, 0.2, 1.7, 0.0])
    np.testing.assert_array_equal(plant.step(u), again.step(u))
