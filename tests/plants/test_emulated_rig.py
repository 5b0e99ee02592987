"""Each part of a rig does what its equation says, and nothing else."""

import pickle

import numpy as np
import pytest

from ssmr_torch.plants.emulated_rig import Rig, rig
from ssmr_torch.plants.slow_manifold import SlowManifold

H = 0.01
EVERYTHING = {"noise_std": 1e-4, "sensor_delay": 3 * H, "drop_probability": 0.2, "actuator_lag": 0.03,
              "rate_limit": 20.0, "saturation": 1.2, "cable_friction": 0.1}


def random_inputs(count, seed=0):
    return np.random.default_rng(seed).uniform(0.0, 1.5, (count, 4))


def run(plant, inputs, seed=0):
    """All observations, the first at reset: (T + 1, p)."""
    return np.array([plant.reset(seed), *(plant.step(u) for u in inputs)])


def forces(settings, commands, **plant):
    """What reaches a cable after each of the commands to it, from rest; the others get their lowest force."""
    robot = Rig(SlowManifold(**plant), **settings)
    lowest, applied = robot.applied, []
    for command in commands:
        robot.step([command, *lowest[1:]])
        np.testing.assert_array_equal(robot.applied[1:], lowest[1:])
        applied.append(robot.applied[0])
    return np.array(applied)


def at_rest(samples=4000, **settings):
    """Measurements of a robot that does not move: what the sensors make of zero, (samples, 6)."""
    return run(Rig(SlowManifold(), **settings), np.zeros((samples - 1, 4)))


def drops(observations):
    """Which samples repeat the one before."""
    return np.concatenate([[False], (observations[1:] == observations[:-1]).all(axis=1)])


# everything off

@pytest.mark.parametrize("settings", [{}, {"noise_std": 0, "rate_limit": None}, {"dropped": "missing"}])
def test_a_rig_with_every_part_off_is_the_plant_itself(settings):
    plant = SlowManifold()
    assert rig(plant, **settings) is plant


@pytest.mark.parametrize("setting", EVERYTHING.items(), ids=lambda setting: setting[0])
def test_a_rig_with_one_part_on_is_a_rig(setting):
    assert isinstance(rig(SlowManifold(), **dict([setting])), Rig)


def test_parts_that_are_off_change_no_digit():
    inputs = random_inputs(50)
    np.testing.assert_array_equal(run(Rig(SlowManifold()), inputs), run(SlowManifold(), inputs))


@pytest.mark.parametrize("settings", [{"noise": 1e-3}, {"noise_std": 0.0, "delay": 0.0}])
def test_a_misspelled_setting_is_refused_even_where_all_is_off(settings):
    with pytest.raises(TypeError, match="unexpected keyword"):
        rig(SlowManifold(), **settings)


# actuators

def test_the_lag_is_the_exponential_of_a_first_order_system():
    time = H * np.arange(1, 21)
    np.testing.assert_allclose(forces({"actuator_lag": 0.03}, np.ones(20)), 1 - np.exp(-time / 0.03), rtol=1e-13)


def test_the_lag_does_not_depend_on_the_timestep():
    commands = random_inputs(20)[:, 0]
    fine = forces({"actuator_lag": 0.03}, np.repeat(commands, 2), timestep=H / 2)
    np.testing.assert_allclose(fine[1::2], forces({"actuator_lag": 0.03}, commands), rtol=1e-12)


def test_forces_change_at_the_rate_limit_until_they_arrive():
    applied = forces({"rate_limit": 10.0}, [1.0] * 12 + [0.35] * 10)
    np.testing.assert_allclose(applied, [*np.arange(0.1, 1.0, 0.1), 1, 1, 1, 0.9, 0.8, 0.7, 0.6, 0.5, 0.4, *[0.35] * 4],
                               rtol=0, atol=1e-14)


def test_limits_can_differ_between_inputs():
    robot = Rig(SlowManifold(), rate_limit=[10, 20, 40, 80], saturation=[1.5, 1.5, 0.3, 0.7])
    robot.step(np.full(4, 9.0))
    np.testing.assert_allclose(robot.applied, [0.1, 0.2, 0.3, 0.7])


def test_no_force_exceeds_the_saturation_or_the_bounds():
    commands = [0.0, 0.5, 1.0, 2.0, -1.0]
    np.testing.assert_array_equal(forces({"saturation": 0.8}, commands), [0, 0.5, 0.8, 0.8, 0])
    np.testing.assert_array_equal(forces({"saturation": 0.8}, commands, input_bounds=(0.6, 1.5))[[0, 4]], [0.6, 0.6])


def test_the_actuators_start_from_the_forces_that_the_robot_rests_under():
    """Of a robot whose cables are never slack, all of them keep their lowest force until another is commanded."""
    settings = {"actuator_lag": 0.03, "rate_limit": 50.0, "cable_friction": 0.1}
    np.testing.assert_array_equal(forces(settings, [0.0, 0.6], input_bounds=(0.6, 1.5)), [0.6, 0.6])
    np.testing.assert_allclose(forces({"actuator_lag": 0.03}, [1.0], input_bounds=(0.6, 1.5)),
                               1 - 0.4 * np.exp(-H / 0.03))


RAMP = np.linspace(0.0, 1.4, 141)
SLIP = np.exp(0.2)


def rubbed(commands):
    return forces({"cable_friction": 0.2}, commands)


def test_pulling_transmits_less_and_releasing_more_by_the_factor_of_the_capstan_equation():
    up, down = np.split(rubbed([*RAMP, *RAMP[::-1]]), 2)
    np.testing.assert_allclose(up, RAMP / SLIP, rtol=1e-14)
    slips = RAMP * SLIP < RAMP[-1] / SLIP
    np.testing.assert_allclose(down[::-1][slips], RAMP[slips] * SLIP, rtol=1e-14)
    np.testing.assert_allclose(down[::-1][~slips], RAMP[-1] / SLIP, rtol=1e-14)
    assert down[-1] == 0.0


def test_minor_loops_stay_inside_the_major_loop_and_close():
    swing = 0.8 + 0.5 * np.sin(np.linspace(0, 2 * np.pi, 201))
    approach, first, second = np.split(rubbed([*RAMP[:81], *swing, *swing]), [81, 282])
    assert (first >= swing / SLIP - 1e-15).all() and (first <= swing * SLIP + 1e-15).all()
    assert ((first > swing / SLIP + 1e-3) & (first < swing * SLIP - 1e-3)).any()
    np.testing.assert_array_equal(second[51:], first[51:])  # from the first turn on


def test_swings_smaller_than_the_friction_transmit_nothing():
    inner = 1.0 + 0.19 * np.sin(np.linspace(0, 2 * np.pi, 51))
    np.testing.assert_array_equal(rubbed([1.4, 0.8, *inner])[1:], 0.8 * SLIP)


def test_friction_depends_on_the_turning_points_and_not_on_the_time():
    corners = np.array([0.0, 1.2, 0.2, 0.9, 0.5, 1.4, 0.3])
    walk = np.interp(np.arange(0, 6.001, 0.02), np.arange(7), corners)
    np.testing.assert_allclose(rubbed(walk)[::50], rubbed(corners), rtol=1e-12)
    np.testing.assert_array_equal(rubbed(np.repeat(corners, 3))[2::3], rubbed(corners))


def test_the_actuators_act_one_after_the_other():
    """One cable worked through by hand: bounds, saturation, rate limit, lag, friction."""
    commands = [2.0, 2.0, 2.0, 2.0, 2.0, -1.0, -1.0, 0.9, 0.9]
    limited, lagged, transmitted, expected = 0.0, 0.0, 0.0, []
    for command in commands:
        force = min(min(max(command, 0.0), 1.5), 1.2)
        limited += min(max(force - limited, -0.4), 0.4)
        lagged += (1 - np.exp(-H / 0.02)) * (limited - lagged)
        transmitted = min(max(transmitted, lagged * np.exp(-0.2)), lagged * np.exp(0.2))
        expected.append(transmitted)
    settings = {"saturation": 1.2, "rate_limit": 40.0, "actuator_lag": 0.02, "cable_friction": 0.2}
    np.testing.assert_allclose(forces(settings, commands), expected, rtol=1e-13)


def test_saturated_forces_follow_a_smaller_command_at_once():
    """Saturation comes before the rate limit: nothing winds up."""
    np.testing.assert_allclose(forces({"saturation": 1.0, "rate_limit": 50.0}, [1.5] * 5 + [0.0]),
                               [0.5, 1.0, 1.0, 1.0, 1.0, 0.5])


def test_the_displacement_follows_the_applied_forces_and_not_the_measurement():
    robot, bare = Rig(SlowManifold(), **EVERYTHING), SlowManifold()
    for u in random_inputs(40):
        robot.step(u)
        np.testing.assert_array_equal(robot.displacement, bare.step(robot.applied))
    np.testing.assert_array_equal(robot.plant.state, bare.state)


# sensors

@pytest.mark.parametrize("samples", [1, 2, 7])
def test_a_delay_shifts_the_observations_exactly(samples):
    inputs = random_inputs(30)
    late, prompt = run(Rig(SlowManifold(), sensor_delay=samples * H), inputs), run(SlowManifold(), inputs)
    np.testing.assert_array_equal(late[samples:], prompt[:-samples])
    np.testing.assert_array_equal(late[:samples], np.tile(prompt[0], (samples, 1)))


def test_the_noise_is_white_and_of_the_given_size():
    noise = at_rest(noise_std=2e-4) / 2e-4
    n = len(noise)
    assert np.abs(noise.std(axis=0) - 1).max() < 4 / np.sqrt(2 * n)
    assert np.abs(noise.mean(axis=0)).max() < 4 / np.sqrt(n)
    for lag in range(4):
        correlation = noise[lag:].T @ noise[:n - lag] / n
        assert np.abs(correlation - (lag == 0) * np.diag(np.diag(correlation))).max() < 4 / np.sqrt(n), lag


@pytest.mark.parametrize("probability", [0.01, 0.3])
def test_samples_are_dropped_at_the_given_rate_independently_of_each_other(probability):
    lost = np.isnan(at_rest(drop_probability=probability, dropped="missing")[:, 0])[1:]
    n, spread = len(lost), np.sqrt(probability * (1 - probability))
    assert abs(lost.mean() - probability) < 4 * spread / np.sqrt(n)
    together = (lost[1:] & lost[:-1]).mean()
    assert abs(together - probability ** 2) < 4 * np.sqrt(probability ** 2 / n)


def test_a_held_sample_repeats_the_last_one_to_the_last_digit_and_a_missing_one_is_not_a_number():
    settings = {"noise_std": 1e-4, "drop_probability": 0.3}
    held, missing = at_rest(200, **settings), at_rest(200, **settings, dropped="missing")
    lost = np.isnan(missing[:, 0])
    assert 20 < lost.sum() < 100 and np.isnan(missing[lost]).all()
    np.testing.assert_array_equal(drops(held), lost)
    np.testing.assert_array_equal(held[~lost], missing[~lost])


def test_the_sample_at_reset_always_arrives():
    robot = Rig(SlowManifold(), drop_probability=0.9, dropped="missing", noise_std=1e-4)
    assert all(np.isfinite(robot.reset(seed)).all() for seed in range(20))


def test_samples_are_dropped_when_they_would_arrive_and_get_their_noise_then():
    """Delay, then drop, then noise: of the same numbers, only what was on its way comes later."""
    inputs, sensors = random_inputs(100), {"drop_probability": 0.3, "noise_std": 1e-4, "dropped": "missing"}
    prompt, late = (run(Rig(SlowManifold(), **sensors, sensor_delay=d * H), inputs) for d in (0, 4))
    truth = run(SlowManifold(), inputs)
    np.testing.assert_array_equal(np.isnan(late), np.isnan(prompt))
    np.testing.assert_allclose((late - np.vstack([np.zeros((4, 6)), truth[:-4]])), prompt - truth, rtol=0, atol=1e-15)


# random numbers, state, provenance

def test_the_seed_and_only_the_seed_decides_the_random_numbers():
    settings = {"noise_std": 1e-4, "drop_probability": 0.3}
    robot, inputs = Rig(SlowManifold(), **settings), random_inputs(30)
    first = run(robot, inputs, seed=5)
    np.testing.assert_array_equal(run(Rig(SlowManifold(), **settings), inputs, seed=5), first)
    assert (run(robot, inputs, seed=6)[:, 0] != first[:, 0]).sum() > 20
    np.testing.assert_array_equal(run(robot, inputs, seed=None), run(robot, inputs, seed=0))
    with pytest.raises(ValueError):
        robot.reset(seed=-1)


def test_noise_and_drops_do_not_disturb_each_others_numbers():
    quiet = at_rest(100, drop_probability=0.3, dropped="missing")
    both, noisy = (at_rest(100, noise_std=1e-4, drop_probability=p, dropped="missing") for p in (0.3, 0.0))
    np.testing.assert_array_equal(np.isnan(both), np.isnan(quiet))
    np.testing.assert_array_equal(both[~np.isnan(both)], noisy[~np.isnan(both)])


@pytest.mark.parametrize("generator", [np.random.PCG64, np.random.Philox])
def test_a_rig_draws_other_numbers_than_a_generator_of_the_same_seed(generator):
    noise = Rig(SlowManifold(), noise_std=1.0).reset(seed=0)
    drawn = np.random.Generator(generator(0)).standard_normal(1000)
    assert (noise != 0).all() and np.abs(noise[:, None] - drawn).min() > 1e-8


@pytest.mark.parametrize("dropped", ["held", "missing"])
def test_a_saved_state_returns_the_same_observation_and_continues_the_same_way(dropped):
    robot, inputs = Rig(SlowManifold(), **EVERYTHING, dropped=dropped), random_inputs(30)
    observations, states = [robot.reset(seed=1)], [robot.state]
    for u in inputs:
        observations.append(robot.step(u))
        states.append(robot.state)
    assert np.isnan(observations).any() == (dropped == "missing")
    for k, state in enumerate(states):
        np.testing.assert_array_equal(robot.reset(seed=1, state=state), observations[k])
        np.testing.assert_array_equal([robot.step(u) for u in inputs[k:k + 5]], observations[k + 1:k + 6])


def test_a_state_that_no_rig_returned_is_refused_and_the_rig_unharmed():
    robot = Rig(SlowManifold(), **EVERYTHING)
    run(robot, random_inputs(5))
    before, size = robot.state, SlowManifold().state.size
    for index, value in ((size, -1.0), (size, 2.5), (-1, 0.5)):
        state = before.copy()
        state[index] = value
        with pytest.raises(ValueError, match="expected a whole number of 0 or more and 0 or 1"):
            robot.reset(state=state)
        np.testing.assert_array_equal(robot.state, before)


def test_a_rig_goes_on_in_another_process_as_it_would_here():
    robot, inputs = Rig(SlowManifold(), **EVERYTHING), random_inputs(20)
    run(robot, inputs)
    sent = pickle.loads(pickle.dumps(robot))
    np.testing.assert_array_equal([sent.step(u) for u in inputs], [robot.step(u) for u in inputs])


def test_a_rig_is_rebuilt_from_its_parameters():
    robot = Rig(SlowManifold(observe="state", input_bounds=(0.0, 1.3)), **EVERYTHING)
    settings = pickle.loads(pickle.dumps(robot.parameters))
    plant = settings.pop("plant")
    assert plant["class"] == "ssmr_torch.plants.slow_manifold.SlowManifold"
    again = Rig(SlowManifold(**plant["parameters"]), **settings)
    assert again.parameters == robot.parameters
    np.testing.assert_array_equal(run(again, random_inputs(20)), run(robot, random_inputs(20)))


def test_a_plant_that_fails_leaves_the_rigs_memory_as_it_was():
    robot = Rig(SlowManifold(), **EVERYTHING)
    run(robot, random_inputs(5))
    before = robot.state

    def fail(input):
        raise RuntimeError("the mesh is inverted")

    robot.plant.step = fail
    with pytest.raises(RuntimeError):
        robot.step(np.ones(4))
    np.testing.assert_array_equal(robot.state, before)


# outputs

def test_a_rig_with_some_outputs_gives_their_values_in_the_given_order():
    plant, inputs = SlowManifold(), random_inputs(50)
    names = [plant.output_names[4], plant.output_names[0]]
    seen = Rig(SlowManifold(), outputs=names)
    assert seen.output_names == tuple(names) and seen.rest.tolist() == plant.rest[[4, 0]].tolist()
    np.testing.assert_array_equal(run(seen, inputs), run(plant, inputs)[:, [4, 0]])
    assert seen.parameters["outputs"] == names and Rig(plant).parameters["outputs"] is None
    assert isinstance(rig(plant, outputs=names), Rig) and rig(plant, outputs=list(plant.output_names)) is plant
