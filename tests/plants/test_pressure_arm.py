"""The arm with late pressure against what is known of chambers and beams."""

import numpy as np
import pytest
from scipy.integrate import solve_bvp

from ssmr_torch.plants.pressure_arm import PressureArm

LOSSLESS = {"material_damping": 0.0, "drag": 0.0}
BEAM = {"length": 0.24, "line_density": 0.5, "bending_stiffness": 0.0134}
CANTILEVER = 1.87510407  # ω = (1.8751 / L)² √(EI / μ)


def slowest(**settings):
    rates = PressureArm(pressure_lag=0.0, substeps=400, **LOSSLESS, **settings).eigenvalues
    return np.abs(rates.imag)[np.abs(rates.imag) > 0.1].min()


def test_the_pressure_follows_a_step_with_its_time_constant():
    arm = PressureArm(pressure_lag=0.08)
    command = np.array([3e4, -1e4])
    pressures = []
    for _ in range(20):
        arm.step(command)
        pressures.append(arm.pressure)
    expected = (1 - np.exp(-0.02 * np.arange(1, 21) / 0.08))[:, None] * command
    np.testing.assert_allclose(pressures, expected, rtol=1e-10)


def test_without_lag_the_pressure_is_the_command():
    arm = PressureArm(pressure_lag=0.0)
    arm.step(np.array([3e4, -1e4]))
    np.testing.assert_array_equal(arm.pressure, [3e4, -1e4])


def test_its_frequency_tends_to_the_cantilevers_with_the_square_of_the_arcs():
    exact = (CANTILEVER / BEAM["length"]) ** 2 * np.sqrt(BEAM["bending_stiffness"] / BEAM["line_density"])
    errors = np.array([slowest(arcs=arcs, gravity=0.0, **BEAM) / exact - 1 for arcs in (1, 2, 4)])
    assert errors[-1] < 5e-3
    np.testing.assert_allclose(errors[:-1] / errors[1:], 4.0, rtol=0.1)


def hanging_tip(moment):
    """Tip of the beam that hangs, m: EI θ'' = μ g (L − s) θ, θ(0) = 0, EI θ'(L) = moment, for small angles θ(s)."""
    length, stiffness, weight = BEAM["length"], BEAM["bending_stiffness"], 9.81 * BEAM["line_density"]
    solved = solve_bvp(lambda s, y: np.stack([y[1], weight * (length - s) * y[0] / stiffness, y[0]]),
                       lambda a, b: np.array([a[0], b[1] - moment / stiffness, a[2]]),
                       np.linspace(0, length, 50), np.zeros((3, 50)), tol=1e-8)
    return solved.y[2, -1]


def test_its_weight_straightens_it_as_it_does_a_beam():
    pressure, errors = 100.0, []
    for arcs in (1, 2):
        arm = PressureArm(arcs=arcs, drag=8.0, pressure_lag=0.0, hardening=0.0)
        for _ in range(250):
            displacement = arm.step(np.full(2, pressure))
        errors.append(displacement[0] / hanging_tip(1.05e-6 * pressure) - 1)
    assert abs(errors[1]) < 0.02
    assert 3 < errors[0] / errors[1] < 5


def test_without_weight_each_bellows_bends_by_its_moment_alone():
    arm = PressureArm(gravity=0.0, hardening=0.0, material_damping=0.05, drag=8.0, substeps=200)
    command = np.array([4e4, -2e4])
    for _ in range(300):
        arm.step(command)
    bent = arm.state[:4].reshape(2, 2).sum(axis=1)
    flexibility = (BEAM["length"] / 2) / BEAM["bending_stiffness"]
    np.testing.assert_allclose(bent, flexibility * 1.05e-6 * command, rtol=1e-6)


def released(**settings):
    """Energies at the samples after a bend that empty chambers let go."""
    arm = PressureArm(pressure_lag=0.0, **settings)
    arm.reset(state=np.concatenate([np.full(4, 0.25), np.zeros(4), np.zeros(2)]))
    energies = [arm.energy()]
    for _ in range(40):
        arm.step(np.zeros(2))
        energies.append(arm.energy())
    return np.array(energies)


def test_released_it_only_loses_energy():
    energies = released()
    assert (np.diff(energies) < 0).all()
    assert energies[-1] < 0.05 * energies[0]


def test_without_losses_its_energy_stays_to_the_order_of_the_integrator():
    drifts = np.array([np.abs(energies / energies[0] - 1).max()
                       for energies in (released(substeps=substeps, **LOSSLESS) for substeps in (50, 100))])
    assert drifts[1] < 1e-4
    assert drifts[0] / drifts[1] > 2 ** 3.5


def test_opposite_commands_bend_it_to_opposite_sides():
    left, right = PressureArm(), PressureArm()
    for command in np.random.default_rng(0).uniform(-6e4, 6e4, (50, 2)):
        np.testing.assert_allclose(left.step(-command), right.step(command) * [-1, 1, -1, 1], atol=1e-14)


@pytest.mark.parametrize("setting", ["length", "lever", "substeps", "arcs"])
def test_a_setting_that_must_be_positive_is_refused_with_its_value(setting):
    with pytest.raises(ValueError, match=f"{setting} is 0.*; expected"):
        PressureArm(**{setting: 0})


def test_a_diverging_integration_is_refused_with_its_inputs_and_the_state_is_kept():
    arm = PressureArm(substeps=5)
    with pytest.raises(ValueError, match="diverged"):
        for _ in range(200):
            before = arm.state
            arm.step(np.array([6e4, -6e4]))
    np.testing.assert_array_equal(arm.state, before)
