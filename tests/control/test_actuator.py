"""Claims about what stands between a command and the input that acts: lag, delay, play, friction, rate, gain."""

import copy
import pickle
from dataclasses import replace

import numpy as np
import pytest

from ssmr_torch.control.actuator import Actuator, ActuatorState, lag_matrix, lagged
from ssmr_torch.plants.emulated_rig import Rig

RANGE, H = (0.6, 0.6, 0.6, 0.6), 0.01
WHOLE = Actuator(H, RANGE, delay=3, lag=0.02, play=0.04, friction=0.1, rate=6.0, gain=(1.0, 0.9, 1.1, 1.2),
                 offset=(0.0, 0.02, -0.01, 0.05))
PARTS = {"nothing": Actuator(H, RANGE), "delay": Actuator(H, RANGE, delay=2), "lag": Actuator(H, RANGE, lag=0.03),
         "play": Actuator(H, RANGE, play=0.1), "friction": Actuator(H, RANGE, friction=0.2),
         "rate": Actuator(H, RANGE, rate=2.0), "gain and offset": replace(WHOLE, delay=0, lag=0.0, play=0.0,
                                                                          friction=0.0, rate=None), "all": WHOLE}


def commands(samples=200, seed=0, lowest=0.0, noise=0.05):
    """Noise on slow waves, (1 + samples, 4), from lowest to 0.6, that begin at zero."""
    rng, time = np.random.default_rng(seed), H * np.arange(samples)[:, None]
    waves = 0.3 + 0.25 * np.sin(3.0 * time + np.arange(4)) + noise * rng.standard_normal((samples, 4))
    return np.concatenate([np.zeros((1, 4)), np.clip(lowest + (0.6 - lowest) / 0.6 * waves, lowest, 0.6)])


def on_a_rig(trial, u, **settings):
    """Forces (T, 4) that reach the plant, and outputs (T + 1, 6), from a rig that is given u (T, 4)."""
    robot = Rig(trial.ModelPlant(trial.oscillators()), **settings)
    outputs, applied = [robot.reset()], []
    for command in u:
        outputs.append(robot.step(command))
        applied.append(robot.applied)
    return np.array(applied), np.array(outputs)


@pytest.mark.parametrize(("settings", "actuator"), [
    ({"actuator_lag": 0.015}, Actuator(H, RANGE, lag=0.015)),
    ({"cable_friction": 0.1}, Actuator(H, RANGE, friction=0.1)),
    ({"rate_limit": 3.0}, Actuator(H, RANGE, rate=5.0)),
    ({"rate_limit": 3.0, "actuator_lag": 0.015}, Actuator(H, RANGE, rate=5.0, lag=0.015))])
def test_the_acting_inputs_equal_those_of_a_rig_step_by_step(trial, settings, actuator):
    u = commands()
    np.testing.assert_allclose(actuator.acting(u), on_a_rig(trial, u, **settings)[0], rtol=0, atol=1e-12)


def test_a_delay_of_the_rigs_sensors_counts_as_a_delay_of_the_actuator(trial):
    u, plain = commands(), trial.ModelPlant(trial.oscillators())
    _, seen = on_a_rig(trial, u, sensor_delay=0.02, actuator_lag=0.01)
    acting = Actuator(H, RANGE, delay=2, lag=0.01).acting(u)
    expected = np.array([plain.reset(), *(plain.step(v) for v in acting)])
    np.testing.assert_allclose(seen, expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize(("noise", "share"), [(0.0, 0.05), (0.05, 0.65)])
def test_friction_before_a_lag_approximates_friction_after_it_better_for_calmer_commands(trial, noise, share):
    """The rig's cables rub behind the motors' lag: another hysteresis. How much of what friction does is missed."""
    u, lag = commands(noise=noise), Actuator(H, RANGE, lag=0.01)
    there = on_a_rig(trial, u, actuator_lag=0.01, cable_friction=0.1)[0][20:]
    missed, whole = (np.sqrt(np.mean((one.acting(u)[20:] - there)**2)) for one in (replace(lag, friction=0.1), lag))
    assert missed < share * whole


@pytest.mark.parametrize("actuator", PARTS.values(), ids=PARTS)
def test_sample_by_sample_is_the_same_as_all_at_once(actuator):
    u, state = commands(lowest=-0.6), ActuatorState(actuator)
    state.rest_at(u[0])
    np.testing.assert_allclose(state.acting, actuator.factor * u[0] + actuator.shift)
    for command, acting in zip(u, actuator.acting(u)):
        state.apply(command)
        np.testing.assert_allclose(state.acting, acting, rtol=0, atol=1e-14)


@pytest.mark.parametrize("actuator", PARTS.values(), ids=PARTS)
def test_delayed_commands_act_whatever_is_commanded_next(actuator):
    u, d, state = commands(60), actuator.delay, ActuatorState(actuator)
    state.rest_at(u[0])
    for command in u[:40]:
        state.apply(command)
    found, x = state.decided()
    for later in (u[40:], 0.6 - u[40:]):
        acting = actuator.acting(np.concatenate([u[:40], later]))
        np.testing.assert_allclose(found, acting[40:40 + d], rtol=0, atol=1e-14)
    following = replace(actuator, play=0.0, friction=0.0, rate=None)
    if not (actuator.rubs or actuator.rate):
        rest = lagged(u[40:], x, following.share, following.factor, following.shift)
        np.testing.assert_allclose(rest[:20 - d], actuator.acting(u)[40 + d:60], rtol=0, atol=1e-14)


@pytest.mark.parametrize("lowest", [0.0, -0.6])
@pytest.mark.parametrize("name", ["play", "friction", "all"])
def test_the_crossing_transmits_the_wanted_input_from_any_held_input(name, lowest):
    actuator, rng = PARTS[name], np.random.default_rng(0)
    bounds = np.tile([[lowest], [0.6]], 4)
    low, high = actuator.reachable(bounds)
    assert (low > bounds[0] - 1e-15).all() and (high < bounds[1]).all()
    for _ in range(300):
        held, wanted = rng.uniform(low, high), rng.uniform(low, high)
        # what is nearer than the play's width is crossed in proportion
        far = np.abs(wanted - held) >= actuator.play * 0.6 + actuator.friction * np.abs(wanted) + 1e-3 * 0.6
        command = actuator.crossing(held, wanted)
        assert (command >= bounds[0] - 1e-12).all() and (command <= bounds[1] + 1e-12).all()
        np.testing.assert_allclose(actuator.transmitted(held, command)[far], wanted[far], rtol=0, atol=1e-12)
        near = actuator.transmitted(held, command)[~far]
        assert ((near - held[~far]) * (near - wanted[~far]) <= 1e-15).all()  # never beyond it, never away from it


def test_the_reachable_range_ends_at_what_the_bounds_transmit():
    bounds = np.array([[0.0, -0.6, 0.1, -0.3], [0.6, 0.6, 0.5, 0.6]])
    low, high = WHOLE.reachable(bounds)
    np.testing.assert_allclose(WHOLE.transmitted(low, bounds[1]), high, atol=1e-15)
    np.testing.assert_allclose(WHOLE.transmitted(high, bounds[0]), low, atol=1e-15)
    np.testing.assert_allclose(WHOLE.crossing(low, high), bounds[1], atol=1e-15)
    np.testing.assert_allclose(WHOLE.crossing(high, low), bounds[0], atol=1e-15)


def test_without_play_and_friction_the_command_is_the_wanted_input():
    actuator, bounds = PARTS["lag"], np.tile([[0.0], [0.6]], 4)
    np.testing.assert_array_equal(actuator.crossing(np.zeros(4), np.full(4, 0.3)), np.full(4, 0.3))
    np.testing.assert_array_equal(actuator.transmitted(np.zeros(4), np.full(4, 0.3)), np.full(4, 0.3))
    np.testing.assert_array_equal(actuator.reachable(bounds), bounds)


def test_the_matrix_of_a_lag_is_the_derivative_of_its_output():
    N, start, step = 7, np.array([0.1, 0.5, 0.0, 0.3]), 1e-3
    u = commands(N)[1:]

    def acting(flat):
        return lagged(flat.reshape(N, 4), start, WHOLE.share, WHOLE.factor, WHOLE.shift).ravel()

    differences = np.stack([(acting(u.ravel() + e) - acting(u.ravel() - e)) / (2 * step)
                            for e in step * np.eye(4 * N)], axis=1)
    np.testing.assert_allclose(lag_matrix(WHOLE, N), differences, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(lag_matrix(PARTS["nothing"], N), np.eye(4 * N))


def test_an_actuator_in_units_of_the_range_serves_inputs_of_any_size():
    small, u = replace(WHOLE, input_range=tuple(0.02 * np.array(RANGE))), commands()
    np.testing.assert_allclose(small.acting(0.02 * u), 0.02 * WHOLE.acting(u), rtol=1e-12, atol=1e-16)


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda one: pickle.loads(pickle.dumps(one))], ids=["copy", "pickle"])
def test_a_copy_goes_on_as_the_original_does(copied):
    u, state = commands(), ActuatorState(WHOLE)
    for command in u[:50]:
        state.apply(command)
    again = copied(state)
    for command in u[50:]:
        state.apply(command)
        again.apply(command)
        np.testing.assert_array_equal(state.acting, again.acting)


@pytest.mark.parametrize(("changes", "said"), [
    ({"timestep": 0.0}, "timestep is 0.0 s"), ({"delay": 1.5}, "delay is 1.5; expected a whole number, 0 or more"),
    ({"lag": -0.01}, "lag is -0.01 s"), ({"play": np.nan}, "play is nan"), ({"friction": -1.0}, "friction is -1.0"),
    ({"rate": 0.0}, "rate is 0.0 1/s"), ({"ease": 0.0}, "ease is 0.0"), ({"input_range": None}, "input_range .* None"),
    ({"input_range": 0.6}, "input_range of an actuator is 0.6; expected one number for each input"),
    ({"input_range": [0.6, 0.0]}, "expected 2 finite numbers, all positive"),
    ({"gain": [1.0]}, r"gain of an actuator is \[1.0\]; expected 4 finite numbers, all positive"),
    ({"gain": [1.0, 1.0, 1.0, -1.0]}, "all positive"), ({"offset": [np.inf] * 4}, "offset of an actuator .* 4 finite")])
def test_impossible_numbers_are_refused_with_what_was_expected(changes, said):
    with pytest.raises(ValueError, match=said):
        Actuator(**{"timestep": H, "input_range": RANGE} | changes)
