"""A fast state with known eigenvalues, noise of known size, and a chart for noisier windows."""

from dataclasses import replace

import numpy as np
import pytest

from ssmr_torch.selection.closed_form import ALL, ClosedForm
from ssmr_torch.selection.fast_state import SLOWEST, _realized, with_fibre
from ssmr_torch.selection.folds_and_starts import Samples
from ssmr_torch.selection.noise import measured_noise, recharted
from ssmr_torch.selection.rollouts import rolled_out
from ssmr_torch.selection.specification import Specification
from ssmr_torch.selection.stability import decays_at_rest, stays_bounded


def kicked(modes, count=3, steps=900):
    """y_{k+1} = b u_k + w_{k+1}, of which w⁺ = Λ w is kicked every 40 samples or so; two outputs, two inputs."""
    runs = []
    for seed in range(count):
        rng = np.random.default_rng(seed)
        u, w = np.repeat(rng.uniform(-1, 1, (steps // 5, 2)), 5, axis=0), np.zeros(2)
        y, before = [], np.zeros(2)
        for now in u:
            y.append(0.01 * before + 0.02 * np.array([[1.0, 0.4], [-0.3, 1.0]]) @ w)
            w, before = modes * w + rng.normal(size=2) * (rng.random() < 0.025), now
        runs.append((np.array(y), u))
    return Samples([], runs, 0.02, coordinates={"identity": None}, targets=[0, 1])


def slow_alone(samples):
    """The model z⁺ = b u of the newest sample, which knows nothing of w."""
    closed = ClosedForm(samples, Specification(delays=0, memory=("shift", 1), decays=False))
    chart, assembly = closed.charts[ALL], closed.assembly
    theta = np.zeros((2, len(assembly.linear)))
    place = {row: k for k, row in enumerate(assembly.linear)}
    directions = chart.V[:, 1:3]
    theta[:, [place[0,], place[1,]]] = -np.eye(2)
    to_inputs = directions * 0.01 * samples.input_scale / samples.scale
    theta[:, [place[4,], place[5,]]] = to_inputs
    theta[:, place[()]] = directions @ (0.01 * samples.input_mean) / samples.scale
    return assembly.model(chart, theta, None, np.full(2, 10.0))


def test_a_residual_of_known_eigenvalues_is_realized_exactly():
    """ξ_j = C Λʲ K x of two real modes and an oscillating pair."""
    rng, J = np.random.default_rng(0), 12
    A, c, s = np.zeros((4, 4)), 0.7 * np.cos(0.9), 0.7 * np.sin(0.9)
    A[:2, :2], A[2:, 2:] = np.diag([0.8, 0.45]), [[c, -s], [s, c]]
    C, K, X = rng.normal(size=(2, 4)), rng.normal(size=(4, 9)), rng.normal(size=(400, 9))
    left = np.stack([X @ (C @ np.linalg.matrix_power(A, j) @ K).T for j in range(1, J + 1)], axis=1)
    found, outputs, first = _realized(X, left, 12)
    values = np.linalg.eigvals(found)
    assert max(np.abs(values - each).min() for each in np.linalg.eigvals(A)) < 1e-3
    again = np.stack([X @ (outputs @ np.linalg.matrix_power(found, j) @ first).T for j in range(1, J + 1)], axis=1)
    assert np.abs(again - left).max() < 1e-3 * np.abs(left).max()


def test_a_fast_fibre_is_found_and_lowers_the_error():
    """Two fibres of 0.8, of which windows say how far each is gone; what kicks them later, nobody knows."""
    samples = kicked(np.array([0.8, 0.8]), count=6)
    slow = slow_alone(samples)
    model = with_fibre(slow, samples, 2)
    np.testing.assert_allclose(np.linalg.eigvals(model.linear_part[4:, 4:]).real, 0.8, rtol=0.1)
    starts = samples.held_out(0)
    before, after = (np.square(rolled_out(each, starts) - starts.follows)[:, :4].mean() for each in (slow, model))
    assert after < 0.75 * before


def test_eigenvalues_above_the_largest_modulus_are_moved_onto_it():
    samples = kicked(np.array([0.985, 0.5]))
    model = with_fibre(slow_alone(samples), samples, 12)
    assert np.abs(np.linalg.eigvals(model.linear_part[4:, 4:])).max() < SLOWEST + 1e-9


def test_the_fast_state_has_no_input(systems):
    samples = systems.samples(systems.configuration_affine)
    slow = ClosedForm(samples, Specification(features="linear")).model(1e-4)
    model, n = with_fibre(slow, samples, 4), slow.state_dim
    state = np.random.default_rng(0).normal(size=(5, model.state_dim))
    fast = model.step(state, np.ones((5, 2)))[:, n:]
    state[:, :n] = 0.0
    np.testing.assert_allclose(model.step(state, np.zeros((5, 2)))[:, n:], fast, atol=1e-14)


@pytest.mark.parametrize("sigma", [1e-5, 1e-4, 1e-3])
@pytest.mark.parametrize("seconds", [2.0, 10.0])
def test_the_noise_of_decays_is_measured_within_15_percent(sigma, seconds):
    t, rng = np.arange(0.0, seconds, 0.01), np.random.default_rng(0)
    runs = [np.stack([0.02 * np.exp(-2 * t) * np.cos(8 * t + k), 0.01 * np.exp(-3 * t), 0 * t], axis=1)
            + sigma * rng.normal(size=(len(t), 3)) for k in range(8)]
    assert measured_noise(runs) == pytest.approx(sigma, rel=0.15)


def test_a_slow_motion_without_noise_has_none():
    t = np.arange(0.0, 5.0, 0.01)
    assert measured_noise([np.stack([np.cos(4 * t), np.sin(3 * t)], axis=1)]) < 1e-5
    assert measured_noise([np.zeros((3, 2))]) == 0.0


def test_a_chart_for_noisy_windows_lowers_the_error_of_a_linear_oscillator(systems):
    samples, noise, rng = systems.samples(), 5e-4, np.random.default_rng(0)
    model = ClosedForm(samples, Specification(memory=("shift", 1))).model(0.0)
    starts = samples.held_out(0)
    noisy = type(starts)(starts.window + noise * rng.normal(size=starts.window.shape), starts.past, starts.inputs,
                         starts.follows)
    filtered = recharted(model, samples, noise)
    before, after, clean = (np.sqrt(np.square(rolled_out(each, given) - starts.follows).mean())
                            for each, given in ((model, noisy), (filtered, noisy), (filtered, starts)))
    assert after < 0.6 * before and clean < after
    unchanged = rolled_out(recharted(model, samples, 0.0), starts)
    np.testing.assert_allclose(unchanged, rolled_out(model, starts), atol=1e-5 * samples.scale)


def test_a_model_that_grows_at_rest_or_under_faster_inputs_is_refused(systems):
    samples = systems.samples()
    model = ClosedForm(samples, Specification(memory=("shift", 1))).model(0.0)
    assert decays_at_rest(model) and stays_bounded(model, samples)
    for change in (lambda table: table + 0.3 * np.eye(*table.shape), lambda table: 1.15 * table):
        table = model.dynamics.copy()
        columns = [model.structure.dynamics.factors.index((k,)) for k in range(4)]
        table[:4, columns] = change(table[:4, columns])
        worse = replace(model, dynamics=table)
        assert not decays_at_rest(worse) and not stays_bounded(worse, samples)
