"""What the finite-element robots promise beyond being plants, on meshes of the package."""

import json
import pickle
from functools import cache

import numpy as np
import pytest
from scipy.sparse.linalg import spsolve

from ssmr_torch.plants.diamond import Diamond
from ssmr_torch.plants.finite_element.time_stepping import DivergenceError
from ssmr_torch.plants.trunk import Trunk

SECOND = {"law": "neo_hookean", "mass_distribution": "volume"}
ROBOTS = {
    "trunk": (Trunk, {"mesh": "trunk_coarse"}),
    "trunk, bdf2": (Trunk, {"mesh": "trunk_coarse", "scheme": "bdf2", **SECOND}),
    "diamond": (Diamond, {"mesh": "diamond_coarse"}),
    "diamond, generalized_alpha": (Diamond, {"mesh": "diamond_coarse", "scheme": "generalized_alpha", **SECOND}),
}


@pytest.fixture(params=ROBOTS)
def name(request):
    return request.param


@pytest.fixture
def make(name):
    """(changes of the constructor's arguments) -> a new robot on a coarse mesh."""
    kind, options = ROBOTS[name]
    return lambda **changes: kind(**{**options, **changes})


@cache
def made(kind, **options):
    return kind(**options)


@pytest.fixture
def robot(name):
    """One that tests share, at rest."""
    kind, options = ROBOTS[name]
    made(kind, **options).reset()
    return made(kind, **options)


def random_inputs(robot, count, share=0.3, seed=0):
    return np.random.default_rng(seed).uniform(0, share * robot.input_bounds[1], (count, len(robot.input_names)))


def run(robot, inputs):
    return np.array([robot.step(u) for u in inputs])


def slack(robot):
    return np.zeros(len(robot.input_names))


def with_solver(kind, options, solver):
    """A robot with another linear solver; skips where its library is missing."""
    try:
        return kind(**{**options, "linear_solver": solver})
    except ValueError as missing:
        if "not installed" not in str(missing):
            raise
        pytest.skip(str(missing))


@pytest.mark.parametrize("solver", ["superlu", "pardiso"])
def test_every_linear_solver_gives_the_same_motion(robot, solver):
    other, inputs = with_solver(type(robot), robot.parameters, solver), random_inputs(robot, 10)
    np.testing.assert_allclose(run(other, inputs), run(robot, inputs), atol=1e-9)


# geometry

def test_the_diamonds_cables_act_alike():
    """A quarter turn takes the robot onto itself, and each cable's effect to the next one's."""
    kind, options = ROBOTS["diamond, generalized_alpha"]
    robot, tips = kind(**options), []
    for unit in np.eye(4):
        tips.append(robot.settle(0.3 * unit)[:3])
        robot.reset()
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    assert abs(tips[0][1]) > 1e-3
    for tip, following in zip(tips, tips[1:]):
        np.testing.assert_allclose(following, turn @ tip, atol=1e-9)


def test_each_cable_of_the_trunk_bends_it_to_its_own_side():
    robot = Trunk(mesh="trunk_coarse")
    for cable, name in enumerate(robot.input_names):
        robot.reset()
        tip = robot.settle(0.1 * np.eye(8)[cable])[:3]
        side, axis = name.split("_")[1], "xy".index(name[-1])
        assert (1 if side[0] == "+" else -1) * tip[axis] > 1e-3
        assert abs(tip[1 - axis]) < 0.1 * abs(tip[axis])


def test_the_trunk_hangs_and_the_diamond_stands():
    trunk, diamond = Trunk(mesh="trunk_coarse"), Diamond(mesh="diamond_coarse")
    assert 0 < trunk.rest[2] - 0.195 < 2e-3
    assert -0.040 < diamond.rest[2] - 0.1257 < -0.010


# what a step refuses, and what it counts

def test_an_input_of_the_wrong_size_is_refused_and_the_state_is_unchanged(robot):
    run(robot, random_inputs(robot, 3))
    before = robot.state
    for misfit in (slack(robot)[1:], np.append(slack(robot), 0), np.nan * slack(robot), slack(robot)[None], 0.1):
        for act in (robot.step, robot.settle):
            with pytest.raises(ValueError, match="input .* expected"):
                act(misfit)
    np.testing.assert_array_equal(robot.state, before)
    assert robot.clipped == 0


def test_tensions_out_of_bounds_are_clipped_and_the_steps_counted(robot, make):
    limited = make()
    low, high = robot.input_bounds
    inputs = random_inputs(robot, 6)
    inputs[1, 0], inputs[2], inputs[4, -1] = -0.5, -1.0, 1e3
    observed = run(robot, inputs[:4])
    assert robot.clipped == 2
    np.testing.assert_array_equal(observed, run(limited, np.clip(inputs[:4], low, high)))
    assert limited.clipped == 0
    with pytest.raises(ValueError, match="input"):
        robot.step(slack(robot)[1:])
    assert robot.clipped == 2
    robot.reset()
    assert robot.clipped == 0


def test_tensions_beyond_the_upper_bound_act_as_the_bound(make):
    robot, limited = make(input_bounds=(0.0, 0.1)), make(input_bounds=(0.0, 0.1))
    np.testing.assert_array_equal(robot.step(slack(robot) + 5), limited.step(slack(robot) + 0.1))
    assert (robot.clipped, limited.clipped) == (1, 0)


def test_a_step_that_diverges_is_refused_and_the_robot_goes_on_unharmed(make):
    robot, careful = make(input_bounds=(0.0, 1e7)), make(input_bounds=(0.0, 1e7))
    inputs = np.random.default_rng(0).uniform(0, 0.2, (8, len(robot.input_names)))
    run(robot, inputs[:4])
    before = robot.state
    with pytest.raises(DivergenceError, match="lower the inputs or the timestep"):
        robot.step(slack(robot) + 1e7)
    np.testing.assert_array_equal(robot.state, before)
    run(careful, inputs[:4])
    np.testing.assert_array_equal(run(robot, inputs[4:]), run(careful, inputs[4:]))


# state

def test_a_state_is_restored_exactly_with_all_that_the_scheme_remembers(robot, make):
    inputs = random_inputs(robot, 12)
    run(robot, inputs[:6])
    saved = robot.state
    continued = run(robot, inputs[6:])
    other = make()
    other.reset(state=saved)
    np.testing.assert_array_equal(other.state, saved)
    np.testing.assert_array_equal(run(other, inputs[6:]), continued)


def test_two_robots_move_bitwise_alike(robot, make):
    other, inputs = make(), random_inputs(robot, 15)
    np.testing.assert_array_equal(run(robot, inputs), run(other, inputs))
    np.testing.assert_array_equal(robot.state, other.state)
    np.testing.assert_array_equal(robot.rest, other.rest)


def assert_it_goes_on_after_pickling(robot):
    inputs = random_inputs(robot, 10)
    run(robot, inputs[:5])
    robot.linearization()  # what it computes once must travel too
    other = pickle.loads(pickle.dumps(robot))
    np.testing.assert_array_equal(other.state, robot.state)
    np.testing.assert_array_equal(run(other, inputs[5:]), run(robot, inputs[5:]))


def test_a_pickled_robot_goes_on_where_it_was(robot):
    assert_it_goes_on_after_pickling(robot)


@pytest.mark.parametrize("solver", ["superlu", "pardiso"])
def test_a_robot_with_another_solver_is_pickled_too(solver):
    assert_it_goes_on_after_pickling(with_solver(Trunk, {"mesh": "trunk_coarse"}, solver))


def test_the_undeformed_state_is_the_mesh_without_motion(robot):
    robot.reset(state=robot.undeformed)
    np.testing.assert_array_equal(robot.positions, robot.structure.mesh.nodes)
    assert not robot.state[robot.positions.size:][:robot.structure.sparsity.size].any()


def test_a_robot_at_rest_stays_there(robot):
    for u in np.zeros((20, len(robot.input_names))):
        np.testing.assert_allclose(robot.step(u), 0, atol=1e-9)


def test_its_parameters_are_plain_and_make_it_again(make):
    robot = make(markers={"tip": np.array([0.0, 0.0, 0.19]), "other": 3}, payload=np.float64(0.001))
    written = json.loads(json.dumps(robot.parameters))
    again = type(robot)(**written)
    inputs = random_inputs(robot, 3)
    np.testing.assert_array_equal(run(again, inputs), run(robot, inputs))
    assert again.markers == robot.markers
    assert json.loads(json.dumps(again.parameters)) == written


# loads and deviations of the material

def test_a_payload_moves_the_rest_but_not_the_origin(robot, make):
    nominal, loaded = robot, make(payload=0.005)
    np.testing.assert_allclose(loaded.rest, nominal.rest, atol=1e-9)
    down = np.sign(nominal.structure.mechanics.gravity[2])
    assert down * loaded.reset()[2] > 1e-5
    np.testing.assert_allclose(run(loaded, np.zeros((5, len(loaded.input_names)))), [loaded.reset()] * 5, atol=1e-9)


def test_a_softer_robot_sags_more_and_keeps_the_origin(robot, make):
    nominal, soft = robot, make(stiffness_scale=0.9)
    np.testing.assert_allclose(soft.rest, nominal.rest, atol=1e-9)
    down = np.sign(nominal.structure.mechanics.gravity[2])
    assert down * soft.reset()[2] > 1e-5


# equilibria and linearization

@pytest.mark.parametrize("name", ["trunk", "diamond, generalized_alpha"])
def test_settling_is_where_a_long_simulation_ends(make):
    """Damped so that all is quiet after 3 s."""
    robot, settled = make(mass_damping=15.0), make(mass_damping=15.0)
    inputs = np.tile(random_inputs(robot, 1, share=0.1), (300, 1))
    moved = run(robot, inputs)[-1]
    assert np.abs(moved[:3]).max() > 1e-3
    np.testing.assert_allclose(settled.settle(inputs[0]), moved, atol=1e-7)
    assert not settled.state[settled.positions.size:].any()
    np.testing.assert_allclose(settled.step(inputs[0]), moved, atol=1e-7)


@pytest.mark.parametrize(("scheme", "tensions"), [
    ("backward_euler", (0.0, 0.0, 0.0, 0.785, 0.0, 0.0, 0.784, 0.0)),
    ("bdf2", (0.0, 0.433, 0.0, 0.0, 0.0, 0.0, 0.0, 0.518)),
])
def test_settling_finds_what_a_simulation_finds_under_strong_pulls(scheme, tensions):
    kind, options = ROBOTS["trunk" if scheme == "backward_euler" else "trunk, bdf2"]
    robot = kind(**options, mass_damping=15.0)
    settled = robot.settle(tensions)
    robot.reset()
    np.testing.assert_allclose(run(robot, np.tile(tensions, (400, 1)))[-1], settled, atol=1e-5)


def test_the_stiffness_and_the_input_matrix_predict_how_the_rest_shifts(robot):
    """K δq = H δu about the rest under a pull, δy = C δq."""
    pull = random_inputs(robot, 1, share=0.1)[0]
    change = 1e-5 * robot.input_bounds[1] * np.random.default_rng(1).uniform(0.5, 1, len(pull))
    before = robot.settle(pull)
    found = robot.linearization(input=pull)
    assert np.linalg.norm(found.residual) < 1e-7
    shift = robot.output_matrix @ spsolve(found.stiffness, found.input_matrix @ change)
    np.testing.assert_allclose(robot.settle(pull + change) - before, shift, atol=1e-3 * np.abs(shift).max())


@pytest.mark.parametrize("name", ["trunk", "diamond"])
def test_the_linearization_predicts_a_step_of_backward_euler_from_the_undeformed_body(name):
    """M (v₊ − v)/h + D v₊ + K δq = H δu + r, δq = h v₊; exact there, as the step is one linear solve."""
    kind, options = ROBOTS[name]
    robot, h = kind(**options), 0.01
    found = robot.linearization(state=robot.undeformed)
    change = random_inputs(robot, 1)[0]
    before = robot.reset(state=robot.undeformed)
    after = robot.step(change)
    sparsity, start = robot.structure.sparsity, robot.structure.mesh.nodes
    moved = sparsity.gather(robot.positions - start)
    forces = found.input_matrix @ change + found.residual
    left = found.mass * moved / h**2 + found.damping @ moved / h + found.stiffness @ moved - forces
    assert np.linalg.norm(left) < 1e-7 * np.linalg.norm(forces)
    np.testing.assert_allclose(after - before, robot.output_matrix @ moved, atol=1e-15)


def test_the_linearization_predicts_a_small_step_of_bdf2_under_a_pull():
    """M a + D v + K δq = H δu + O(δ²) with a = 3 v / (2h) and δq = 2h v / 3, from rest under a pull."""
    robot, h = Diamond(**{**ROBOTS["diamond, generalized_alpha"][1], "scheme": "bdf2"}), 0.01
    pull, way = random_inputs(robot, 2)
    rest_under_pull = make_rest(robot, pull)
    found, remaining = robot.linearization(input=pull), []
    for size in (1e-2, 5e-3):
        robot.reset(state=rest_under_pull)
        start = robot.positions
        robot.step(pull + size * way)
        moved = robot.structure.sparsity.gather(robot.positions - start)
        speed = 1.5 * moved / h
        left = found.mass * 1.5 * speed / h + found.damping @ speed + found.stiffness @ moved
        forces = found.input_matrix @ (size * way)
        remaining.append(np.linalg.norm(left - forces) / np.linalg.norm(forces))
    assert remaining[0] < 1e-2 and remaining[1] < 0.6 * remaining[0], remaining


def make_rest(robot, pull):
    robot.settle(pull)
    return robot.state


def test_the_mass_of_the_linearization_adds_up_to_that_of_the_free_nodes(make):
    robot = make(mass_distribution="nodal")
    found = robot.linearization()
    share = len(found.free_nodes) / len(robot.positions)
    np.testing.assert_allclose(found.mass.sum() / 3, share * robot.structure.mechanics.mass, rtol=1e-12)


def test_a_clamped_marker_is_not_moved_by_the_free_nodes(make):
    robot = make(markers={"tip": (0.0, 0.0, 0.2), "base": (0.0, 0.0, 0.0)})
    clamped = np.setdiff1d(np.arange(len(robot.positions)), robot.linearization().free_nodes)
    assert robot.markers["base"] in clamped
    assert robot.output_matrix[:3].sum() == 3 and not robot.output_matrix[3:].any()
    assert not robot.step(random_inputs(robot, 1)[0])[3:].any()
