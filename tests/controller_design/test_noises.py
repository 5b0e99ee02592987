"""Claims about noises by likelihood, and the observer that belongs to them."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import in_short, linear_model
from oscillators import Oscillators, dithered, recordings

import ssmr_torch as ssmr
from ssmr_torch.controller_design.noises import Likelihood, Noises
from ssmr_torch.controller_design.recordings import Piece, recordings_of

DRAWN = Noises(inputs=0.03, states=2e-3, disturbance=7e-4, sensor=2e-3)


def noisy_run(model, robot, reach, scale, rng, seconds=40.0):
    """A run of the observer's own model with the noises `DRAWN`."""
    commands = dithered(robot, seconds, rng)
    z, d, seen = np.zeros(model.state_dim), np.zeros(model.output_dim), []
    for command in commands:
        seen.append(model.decode(z) + d + DRAWN.sensor * reach * rng.standard_normal(len(d)))
        acting = command + DRAWN.inputs * 0.5 * np.ptp(robot.input_bounds, axis=0) * rng.standard_normal(len(command))
        z = model.step(z, acting) + DRAWN.states * scale * rng.standard_normal(len(z))
        d = d + DRAWN.disturbance * reach * rng.standard_normal(len(d))
    return Piece(np.array(seen), commands, False)


@pytest.fixture(scope="module")
def known():
    """Likelihood of a linear model on runs of itself, and the noises of these in its units."""
    robot, rng = Oscillators(), np.random.default_rng(3)
    clean = recordings_of(recordings(robot, runs=3, seconds=10.0, test=0), (0, 1), robot.input_bounds)
    model = linear_model(clean)
    scale = Likelihood(model, clean).scale
    runs = [noisy_run(model, robot, clean.reach, scale, rng) for _ in range(4)]
    likelihood = Likelihood(model, replace(clean, train=runs[:1], held=runs[1:]))
    likelihood.scale, share = scale, clean.reach / likelihood.acted.reach
    return likelihood, replace(DRAWN, disturbance=share * DRAWN.disturbance, sensor=share * DRAWN.sensor)


def test_known_white_noises_are_found(known):
    likelihood, true = known
    with in_short():
        found = likelihood.most_likely()
    assert found.sensor == pytest.approx(true.sensor, rel=0.2)
    for name in ("inputs", "states", "disturbance"):
        assert 0.5 < getattr(found, name) / getattr(true, name) < 2.0, (name, found)


def test_the_stationary_gain_is_that_of_the_kalman_iteration(known):
    likelihood, true = known
    A, B, C = likelihood.linear
    n, p = len(A), len(C)
    observer = likelihood.observer(true)
    G, H = np.eye(n + p), np.hstack([C, np.eye(p)])
    G[:n, :n] = A
    Q = np.zeros((n + p, n + p))
    Q[:n, :n] = true.inputs**2 * B @ B.T + np.diag((true.states * likelihood.scale)**2)
    Q[n:, n:] = true.disturbance**2 * np.eye(p)
    R, P = np.diag(true.sensor**2 + likelihood.decoding**2), np.eye(n + p)
    for _ in range(5000):
        P = G @ P @ G.T + Q
        S = H @ P @ H.T + R
        K = P @ H.T @ np.linalg.inv(S)
        P = P - K @ H @ P
    np.testing.assert_allclose(observer.gain, K, rtol=0, atol=1e-8 * np.abs(K).max())
    np.testing.assert_allclose(observer.covariance, S, rtol=1e-7, atol=1e-7 * np.abs(S).max())


def test_innovations_under_the_true_noises_are_white_and_as_large_as_their_covariance_says(known):
    likelihood, true = known
    observer = likelihood.observer(true)
    e = likelihood.innovations(observer)
    covariance = np.einsum("tki,tkj->ij", e, e) / (e.shape[0] * e.shape[1])
    next_one = np.einsum("tki,tkj->ij", e[:, 1:], e[:, :-1]) / (e.shape[0] * (e.shape[1] - 1))
    size = np.sqrt(np.outer(np.diag(observer.covariance), np.diag(observer.covariance)))
    assert np.abs((covariance - observer.covariance) / size).max() < 0.1
    assert np.abs(next_one / size).max() < 0.08


def test_worse_noises_are_less_likely_than_the_true_ones(known):
    likelihood, true = known
    at = np.log([true.inputs, true.states, true.disturbance, true.sensor])
    for step in np.vstack([np.eye(4), -np.eye(4)]) * np.log(3.0):
        assert likelihood.cost(at + step) > likelihood.cost(at)


def test_an_outlier_counts_linearly(known):
    """Ten times the error costs ten times as much beyond the limit, not a hundred times."""
    likelihood, true = known
    def cost(size):
        outputs = likelihood.outputs.copy()
        outputs[0, 100] += size * likelihood.acted.reach
        spoiled = Likelihood(likelihood.model, likelihood.acted)
        spoiled.outputs = outputs
        return spoiled.cost(np.log([true.inputs, true.states, true.disturbance, true.sensor]))

    least, some, much = (cost(size) for size in (0.0, 1.0, 10.0))
    assert 8.0 < (much - least) / (some - least) < 12.0


def test_a_constant_state_of_a_lifting_is_not_filtered(robot, data):
    trained = ssmr.fit(data, "edmd_bilinear", progress=False)
    model = trained.reduced.numpy().at_timestep(data.timestep)
    assert model.constant_states.sum() == 1
    likelihood = Likelihood(model, recordings_of(data, (0, 1), robot.input_bounds))
    observer = likelihood.observer(Noises(0.01, 1e-3, 1e-3, 1e-3))
    gain = likelihood.whole_gain(observer)
    assert gain.shape == (model.state_dim + 6, 6) and np.isfinite(gain).all()
    assert (gain[:-6][model.constant_states] == 0.0).all() and np.abs(gain).max() > 0.0
    assert np.isfinite(likelihood.innovations(observer)).all()


def test_runs_that_are_too_short_for_a_segment_are_refused_with_both_lengths(known):
    likelihood, true = known
    short = replace(likelihood.acted, held=[Piece(run.observation[:100], run.input[:100], False)
                                       for run in likelihood.acted.held])
    with pytest.raises(ValueError, match=r"100 samples long; expected more than 161"):
        Likelihood(likelihood.model, short)
