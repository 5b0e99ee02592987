"""Each scheme solves its equation, converges at its order, and treats energy as it should."""

from typing import NamedTuple

import numpy as np
import pytest
from scipy.linalg import eigh
from scipy.sparse import diags_array
from scipy.sparse.linalg import spsolve

from ssmr_torch.plants.finite_element.equilibrium import equilibrium
from ssmr_torch.plants.finite_element.linear_solvers import linear_solver
from ssmr_torch.plants.finite_element.modes import undamped_frequencies
from ssmr_torch.plants.finite_element.time_stepping import (
    BDF2,
    BackwardEuler,
    DivergenceError,
    GeneralizedAlpha,
    State,
)

PULLED = np.array([0.5, 0.0, 0.0, 0.2])
SLACK = np.zeros(4)
SIDEWAYS = (4.0, 2.0, -9.81)  # m/s²


class Run(NamedTuple):
    """positions: (T, N, 3) m.   velocities: (T, n) m/s.   energies: (T,) J, where the law has one."""

    positions: np.ndarray
    velocities: np.ndarray
    energies: np.ndarray


@pytest.fixture
def released(body):
    """(law, changes) -> structure, and where it hangs when gravity pulls it aside, which lets go: a smooth start."""

    def make(law, tensions, **changes):
        aside = equilibrium(body(law, **{**changes, "gravity": SIDEWAYS}), tensions)
        return body(law, **changes), aside

    return make


def simulate(structure, scheme, positions, tensions, timestep, duration):
    solver = linear_solver("block_ldl", structure.sparsity)
    still = np.zeros(structure.sparsity.size)
    states = [scheme.start(structure, positions, still, tensions, timestep)]
    for _ in range(round(duration / timestep)):
        states.append(scheme.step(structure, solver, states[-1], tensions, timestep))
    energies = [structure.energy(s.positions, s.velocities) for s in states] if structure.law else []
    return Run(np.array([s.positions for s in states]), np.array([s.velocities for s in states]), np.array(energies))


def moving(structure, deform, scheme, timestep=0.01):
    """A state in motion, with the memory that the scheme would have."""
    still = deform(structure.mesh.nodes)
    velocities = structure.sparsity.gather(deform(structure.mesh.nodes, seed=1) - structure.mesh.nodes)
    return scheme.start(structure, still, velocities, PULLED, timestep)


def damping(structure, positions):
    """C = α M + β K_w."""
    warped = structure.sparsity.matrix(structure.warped_stiffness(positions))
    return structure.mechanics.mass_damping * diags_array(structure.mass) \
        + structure.mechanics.stiffness_damping * warped


def displaced(structure, positions, way):
    return structure.sparsity.scatter(structure.sparsity.gather(positions) + way, positions)


# the equations, recomputed

@pytest.mark.parametrize("law", ["corotational", "neo_hookean"])
@pytest.mark.parametrize("solver", ["block_ldl", "superlu"])
def test_a_step_of_backward_euler_solves_its_equation(body, deform, law, solver):
    """[(1 + hα) M + h (h + β) K] Δv = h [M g + H(q) u − f(q) − (h + β) K v − α M v],  q₊ = q + h (v + Δv)."""
    structure, scheme, h = body(law), BackwardEuler(), 0.01
    state = moving(structure, deform, scheme)
    found = scheme.step(structure, linear_solver(solver, structure.sparsity), state, PULLED, h)
    data = structure.zeros()
    force = structure.forces(state.positions, PULLED, data)
    stiffness, mass = structure.sparsity.matrix(data), diags_array(structure.mass)
    alpha, beta, v = structure.mechanics.mass_damping, structure.mechanics.stiffness_damping, state.velocities
    right = h * (force - (h + beta) * (stiffness @ v) - alpha * (mass @ v))
    change = spsolve(((1 + h * alpha) * mass + h * (h + beta) * stiffness).tocsc(), right)
    scale = np.abs(found.velocities).max()
    np.testing.assert_allclose(found.velocities, v + change, atol=1e-10 * scale)
    np.testing.assert_allclose(found.positions, displaced(structure, state.positions, h * found.velocities), atol=1e-16)


@pytest.mark.parametrize("radius", [0.0, 0.8, 1.0])
def test_a_step_of_generalized_alpha_solves_its_equation(body, deform, radius):
    """M a_m + C v_f + f(q_f) = M g + H(q_f) u with Newmark's relations between the ends of the step."""
    structure, scheme, h = body("neo_hookean"), GeneralizedAlpha(radius), 0.002
    state = moving(structure, deform, scheme)._replace(memory=np.zeros((1, structure.sparsity.size)))
    after = scheme.step(structure, linear_solver("block_ldl", structure.sparsity), state, PULLED, h)
    alpha_m, alpha_f = (2 * radius - 1) / (radius + 1), radius / (radius + 1)
    gamma, beta = 0.5 - alpha_m + alpha_f, 0.25 * (1 - alpha_m + alpha_f) ** 2
    (a,), (a_after,), v, v_after = state.memory, after.memory, state.velocities, after.velocities
    np.testing.assert_allclose(v_after, v + h * ((1 - gamma) * a + gamma * a_after), atol=1e-12)
    moved = structure.sparsity.gather(after.positions - state.positions)
    np.testing.assert_allclose(moved, h * v + h**2 * ((0.5 - beta) * a + beta * a_after), atol=1e-15)
    force = structure.forces(displaced(structure, state.positions, (1 - alpha_f) * moved), PULLED)
    damper = damping(structure, displaced(structure, state.positions, (1 - alpha_f) * h * v))
    inertia = structure.mass * ((1 - alpha_m) * a_after + alpha_m * a)
    left = inertia + damper @ ((1 - alpha_f) * v_after + alpha_f * v) - force
    assert np.linalg.norm(left) < 1e-8 * np.linalg.norm(inertia)


def test_a_step_of_bdf2_solves_its_equation(body, deform):
    """(3 x₊ − 4 x + x₋) / (2h) is q̇ and v̇ at the end: M v̇ + C v₊ + f(q₊) = M g + H(q₊) u."""
    structure, scheme, h = body("neo_hookean"), BDF2(), 0.002
    before = moving(structure, deform, scheme)
    rng = np.random.default_rng(0)
    memory = np.stack([-h * before.velocities, rng.normal(0, 1e-2, structure.sparsity.size)])
    state = before._replace(memory=memory)
    after = scheme.step(structure, linear_solver("block_ldl", structure.sparsity), state, PULLED, h)
    moved = structure.sparsity.gather(after.positions - state.positions)
    v, v_after = state.velocities, after.velocities
    np.testing.assert_allclose((3 * moved + memory[0]) / (2 * h), v_after, atol=1e-12)
    inertia = structure.mass * (3 * v_after - 4 * v + (v + memory[1])) / (2 * h)
    damper = damping(structure, displaced(structure, state.positions, h * v))
    left = inertia + damper @ v_after - structure.forces(after.positions, PULLED)
    assert np.linalg.norm(left) < 1e-8 * np.linalg.norm(inertia)
    np.testing.assert_allclose(after.memory, [-moved, v - v_after], atol=1e-15)


@pytest.mark.parametrize("scheme", [BDF2(), GeneralizedAlpha()], ids=["bdf2", "generalized_alpha"])
def test_the_start_is_consistent_with_the_equation_of_motion(body, deform, scheme):
    """The acceleration that the memory holds is M⁻¹ (M g + H u − f − C v)."""
    structure = body("neo_hookean")
    state = moving(structure, deform, scheme)
    force = structure.forces(state.positions, PULLED) - damping(structure, state.positions) @ state.velocities
    expected = force / structure.mass
    found = state.memory[0] if isinstance(scheme, GeneralizedAlpha) else -state.memory[1] / 0.01
    np.testing.assert_allclose(found, expected, atol=1e-10 * np.abs(expected).max())


# order

def observed_orders(structure, positions, scheme, timestep, halvings=3, duration=0.1):
    """log₂ of the ratios of the differences that halving the timestep makes, of positions and of velocities."""
    ends = [simulate(structure, scheme, positions, PULLED, timestep / 2**k, duration) for k in range(halvings + 1)]
    orders = []
    for attribute in ("positions", "velocities"):
        last = [getattr(run, attribute)[-1] for run in ends]
        changes = [np.linalg.norm(a - b) for a, b in zip(last, last[1:])]
        orders.append(np.log2(np.array(changes[:-1]) / changes[1:]))
    return orders


@pytest.mark.parametrize(("law", "scheme", "order", "timestep"), [
    ("corotational", BackwardEuler(), 1, 0.0025),
    ("neo_hookean", GeneralizedAlpha(), 2, 0.01),
    ("neo_hookean", GeneralizedAlpha(0.0), 2, 0.005),
    ("neo_hookean", GeneralizedAlpha(1.0), 2, 0.01),
    ("neo_hookean", BDF2(), 2, 0.005),
], ids=["backward_euler", "generalized_alpha", "generalized_alpha ρ = 0", "generalized_alpha ρ = 1", "bdf2"])
def test_the_scheme_converges_at_its_order(released, law, scheme, order, timestep):
    structure, start = released(law, PULLED)
    for orders in observed_orders(structure, start, scheme, timestep):
        assert (orders > order - 0.2).all() and (orders < order + 0.35).all(), orders


def test_both_second_order_schemes_converge_to_the_same_motion(released):
    structure, start = released("neo_hookean", PULLED)
    ends = {(type(scheme), h): simulate(structure, scheme, start, PULLED, h, 0.1).positions[-1]
            for scheme in (GeneralizedAlpha(), BDF2()) for h in (0.0025, 0.00125)}
    # of both, with the h² error extrapolated away
    limits = [(4 * ends[kind, 0.00125] - ends[kind, 0.0025]) / 3 for kind in (GeneralizedAlpha, BDF2)]
    travelled = np.abs(limits[0] - start).max()
    assert travelled > 5e-3
    assert np.abs(limits[0] - limits[1]).max() < 3e-5 * travelled
    assert np.abs(ends[GeneralizedAlpha, 0.00125] - ends[BDF2, 0.00125]).max() < 1e-3 * travelled


@pytest.mark.parametrize("scheme", ["generalized_alpha", "bdf2"])
def test_a_jump_of_the_tensions_is_met_at_first_order(robot, scheme):
    """A robot at rest remembers no motion: it takes the jump for one that comes within the step."""
    ends = []
    for k in range(4):
        arm = robot(scheme, timestep=0.005 / 2**k)
        for _ in range(20 * 2**k):
            arm.step(PULLED)
        ends.append(arm.positions)
    changes = [np.linalg.norm(a - b) for a, b in zip(ends, ends[1:])]
    assert (np.log2(np.array(changes[:-1]) / changes[1:]) > 0.9).all()


# energy

def robot_energy(arm):
    velocities = arm.state[arm.positions.size:][:arm.structure.sparsity.size]
    return arm.structure.energy(arm.positions, velocities)


def released_energies(arm, samples=100):
    arm.settle([1.0, 0, 0, 0.5])
    energies = [robot_energy(arm)]
    for _ in range(samples):
        arm.step(SLACK)
        energies.append(robot_energy(arm))
    return np.array(energies)


@pytest.mark.parametrize("timestep", [0.01, 0.005])
def test_a_damped_arm_that_is_let_go_loses_energy_in_every_step_of_generalized_alpha(robot, timestep):
    energies = released_energies(robot("generalized_alpha", timestep=timestep))
    assert (np.diff(energies) < 1e-12 * (energies[0] - energies[-1])).all()


@pytest.mark.parametrize("timestep", [0.01, 0.005])
def test_a_damped_arm_that_is_let_go_loses_energy_under_bdf2_but_for_wiggles(robot, timestep):
    """BDF2 dissipates a norm of two samples, not the energy of one: that may rise by 0.01 % of what is released."""
    energies = released_energies(robot("bdf2", timestep=timestep))
    assert np.diff(energies).max() < 1e-4 * (energies[0] - energies[-1])
    assert energies.argmax() == 0


def test_generalized_alpha_of_radius_one_keeps_the_energy_of_an_undamped_arm(released):
    """To within 0.5 % over a second at h = 0.01 s, an error of second order."""
    structure, start = released("neo_hookean", SLACK, gravity=(0, 0, 0), mass_damping=0, stiffness_damping=0)
    errors = []
    for h in (0.01, 0.005):
        energies = simulate(structure, GeneralizedAlpha(1.0), start, SLACK, h, 1.0).energies
        errors.append(np.abs(energies / energies[0] - 1).max())
    assert errors[0] < 5e-3 and errors[0] > 3 * errors[1]


@pytest.mark.parametrize("scheme", ["generalized_alpha", "bdf2"])
def test_small_free_vibrations_have_the_undamped_frequency(robot, scheme):
    """From a deflection by 0.01 mm in the shape of the lowest mode of K φ = ω² M φ, solved densely."""
    h = 0.002
    arm = robot(scheme, timestep=h, gravity=(0, 0, -0.1), mass_damping=0, stiffness_damping=0)
    matrices, rest = arm.linearization(), arm.positions
    squares, shapes = eigh(matrices.stiffness.toarray(), np.diag(matrices.mass), subset_by_index=[0, 0])
    shape = 1e-5 * shapes[:, 0] / np.abs(shapes).max()
    lowest = undamped_frequencies(arm, 1)[0]
    np.testing.assert_allclose(np.sqrt(squares[0]), lowest, rtol=1e-3)  # its weight
    start = displaced(arm.structure, rest, shape)
    arm.reset(state=np.concatenate([start.ravel(), arm.undeformed[rest.size:]]))
    swing = []
    for _ in range(round(3.2 * 2 * np.pi / lowest / h)):
        arm.step(SLACK)
        swing.append(arm.structure.sparsity.gather(arm.positions - rest) @ (matrices.mass * shape))
    np.testing.assert_allclose(frequency(np.array(swing), h), lowest, rtol=(lowest * h) ** 2)


def frequency(swing, timestep):
    """π times the crossings of zero per second, rad/s."""
    at = np.flatnonzero(np.sign(swing[1:]) != np.sign(swing[:-1]))
    crossings = timestep * (at + swing[at] / (swing[at] - swing[at + 1]))
    return np.pi * (len(crossings) - 1) / (crossings[-1] - crossings[0])


# divergence

@pytest.mark.parametrize("scheme", [GeneralizedAlpha(), BDF2()], ids=["generalized_alpha", "bdf2"])
def test_newtons_method_reports_the_residual_when_it_fails(body, arm, scheme):
    structure = body("neo_hookean")
    size = structure.sparsity.size
    state = State(arm.nodes, np.full(size, 1e3), np.zeros((scheme.memory_rows, size)))
    with pytest.raises(DivergenceError, match="Newton's method .* residual of .* lower the inputs or the timestep"), \
            np.errstate(all="ignore"):
        scheme.step(structure, linear_solver("block_ldl", structure.sparsity), state, SLACK, 0.01)


@pytest.mark.parametrize("radius", [-0.1, 1.1, np.nan])
def test_a_spectral_radius_beyond_the_unit_interval_is_refused(radius):
    with pytest.raises(ValueError, match="expected 0 to 1"):
        GeneralizedAlpha(radius)
