"""Claims about the observer of a designed controller: where the disturbance goes, outliers, gaps, copies."""

import copy
import pickle
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from ssmr_torch.control.disturbance_observer import DisturbanceObserver
from ssmr_torch.control.model_step import Stepper
from ssmr_torch.models.monomials import graded

NOISE, LIMIT = 1e-5, 0.05


def gains(model):
    """(gain (n + p, p), covariance (p, p)) of the stationary filter with a disturbance that walks."""
    n, p = model.state_dim, model.output_dim
    A = np.block([[model.linearize(np.zeros(n), np.zeros(4))[0], np.zeros((n, p))], [np.zeros((p, n)), np.eye(p)]])
    C = np.hstack([model.linearize_output(np.zeros(n))[0], np.eye(p)])
    process = np.diag([1e-8] * n + [1e-9] * p)
    P = solve_discrete_are(A.T, C.T, process, NOISE**2 * np.eye(p))
    S = C @ P @ C.T + NOISE**2 * np.eye(p)
    return P @ C.T @ np.linalg.inv(S), S


def observer_of(model, **changes):
    gain, covariance = gains(model)
    settings = {"gain": gain, "covariance": covariance, "limit": LIMIT, "lost": 0.01}
    return DisturbanceObserver(model, **settings | changes)


def linear(trial):
    """Coordinates and their rates, of which the three coordinates are measured."""
    model = trial.oscillators(0, 1, 0)
    return replace(model, chart=np.eye(6)[:, :3], parametrization=np.eye(6)[:3], output_dim=3,
                   structure=model.structure._replace(chart=graded(3, 1, 1), window_order=(0, 1, 2)))


def driven(model, samples, load=0.0, seed=0):
    """Inputs (T, 4), which act from sample to sample, and outputs (T, p) of the model under them and a load (p,)."""
    rng, z, inputs, outputs = np.random.default_rng(seed), np.zeros(model.state_dim), np.zeros((samples, 4)), []
    for k in range(samples):
        inputs[k] = 0.2 + 0.15 * np.sin(0.07 * k + np.arange(4)) if k else 0.0
        z = model.step(z, inputs[k])
        outputs.append(model.decode(z) + load + NOISE * rng.standard_normal(model.output_dim))
    return inputs, np.array(outputs)


def test_the_first_measurement_is_of_a_robot_at_rest_under_what_acts_and_the_rest_of_it_is_disturbance(trial):
    model, v = trial.oscillators(degree=2), np.array([0.2, 0.05, 0.0, 0.1])
    observer, z = observer_of(model), np.zeros(6)
    for _ in range(3000):
        z = model.step(z, v)
    seen = model.decode(z) + 0.01 * np.array([1.0, -2.0, 0.5, 0.0, 0.0, -9.0])
    observer.measure(seen, v)
    found, offset, d = observer.state()
    np.testing.assert_allclose(found, z, atol=1e-7)
    np.testing.assert_allclose(d, [0.01, -0.02, 0.005, 0.0, 0.0, -LIMIT], atol=1e-7)
    assert offset is None and not observer.counts


def test_a_load_from_the_start_is_known_at_once_and_stays_known(trial):
    model, load = linear(trial), np.array([0.027, -0.01, 0.004])
    observer = observer_of(model)
    inputs, outputs = driven(model, 400, load)
    for v, y in zip(inputs, outputs):
        observer.measure(y, v)
        assert np.abs(observer.state()[2] - load).max() < 20 * NOISE
    assert not observer.counts


@pytest.mark.parametrize("where", ["outputs", "inputs"])
def test_a_load_that_is_added_later_is_estimated_without_bias(trial, where):
    """At rest, w(z) + d is the mean of what is measured; and d is the load where that is one of the outputs."""
    model, load, v = linear(trial), np.array([0.005, -0.003, 0.002]), np.array([0.2, 0.0, 0.1, 0.0])
    pull, rng, z, sums, most = np.array([0.02, 0.0, 0.0, 0.01]), np.random.default_rng(1), np.zeros(6), [], 6000
    observer = observer_of(model)
    for k in range(most):
        loaded = k > 100
        z = model.step(z, v + pull * (loaded and where == "inputs"))
        y = model.decode(z) + load * (loaded and where == "outputs")
        observer.measure(y + NOISE * rng.standard_normal(3), v)
        if k >= most // 2:
            found, _, d = observer.state()
            sums.append(np.concatenate([model.decode(found) + d - y, d]))
    bias = np.mean(sums, axis=0)
    assert np.abs(bias[:3]).max() < 0.1 * NOISE
    rest = np.linalg.solve(np.eye(6) - model.linearize(z, v)[0], model.step(np.zeros(6), v))
    expected = load if where == "outputs" else y - model.decode(rest)
    np.testing.assert_allclose(bias[3:], expected, atol=0.1 * NOISE)


@pytest.mark.parametrize("at", [1, 5, 200])
@pytest.mark.parametrize("size", [0.05, 1.0, 1e6])
def test_a_single_outlier_is_left_out_and_over_after_three_samples(trial, at, size):
    model = linear(trial)
    inputs, outputs = driven(model, 260)
    clean, spoilt = observer_of(model), observer_of(model)
    for k, (v, y) in enumerate(zip(inputs, outputs)):
        clean.measure(y, v)
        spoilt.measure(y + size * (k == at), v)
        off = max(np.abs(one - other).max() for one, other in zip(clean.state()[::2], spoilt.state()[::2]))
        assert off < 1e-4 or at <= k < at + 3
    assert spoilt.counts == {"gated": 1} and not clean.counts


def test_a_robot_that_has_really_moved_is_accepted_after_three_samples(trial):
    model, observer = linear(trial), observer_of(linear(trial))
    for k in range(700):
        observer.measure(np.full(3, 0.0 if k < 600 else 0.02), np.zeros(4))
    z, _, d = observer.state()
    assert observer.counts == {"gated": 3} and np.abs(model.decode(z) + d - 0.02).max() < 1e-3


def test_missing_samples_are_bridged_by_the_model_and_counted_by_the_controller(trial):
    model, observer, rng = linear(trial), observer_of(linear(trial)), np.random.default_rng(2)
    inputs, outputs = driven(model, 500, np.full(3, 0.004))
    lost = rng.uniform(size=500) < 0.3
    lost[:3], lost[250:300] = [True, True, False], True
    for v, y, missing in zip(inputs, outputs, lost):
        observer.measure(np.where([missing, missing, False], np.nan, y) if rng.uniform() < 0.5 else
                         np.full(3, np.nan) if missing else y, v)
        if not observer._unloaded:
            assert np.abs(model.decode(observer.state()[0]) + 0.004 - y).max() < 30 * NOISE
    assert not observer.counts  # the controller's sampling counts them, and the two are added


def test_after_a_gap_in_time_the_disturbance_is_kept_and_the_state_is_found_again(trial):
    model, load = linear(trial), np.array([0.02, -0.01, 0.004])
    observer, (inputs, outputs) = observer_of(model), driven(model, 300, load)
    for k in (*range(100), *range(170, 300)):
        if k == 170:
            observer.forget()
        observer.measure(outputs[k], inputs[k])
        assert np.abs(observer.state()[2] - load).max() < (1e-3 if 170 <= k < 250 else 2e-4)
    assert np.abs(model.decode(observer.state()[0]) + load - outputs[-1]).max() < 30 * NOISE


def test_before_the_first_whole_measurement_there_is_no_disturbance(trial):
    model, observer = linear(trial), observer_of(linear(trial))
    inputs, outputs = driven(model, 20, np.full(3, 0.02))
    for k in range(20):
        observer.measure(outputs[k] if k >= 12 else np.array([0.02, np.nan, 0.02]), inputs[k])
        assert np.abs(observer.state()[2] - (0.02 if k >= 12 else 0.0)).max() < 20 * NOISE


def test_a_mispredicting_state_outside_the_recorded_range_restarts_from_the_chart_and_keeps_the_disturbance(trial):
    model = trial.oscillators(0, 1, 0)
    observer, y = observer_of(model, gain=np.vstack([0.05 * np.eye(6), np.zeros((6, 6))])), np.full(6, 0.003)
    observer.measure(y, np.zeros(4))
    samples = 0  # it takes ten, and the gate is shut at first
    while not observer.counts["observer restarted"] and samples < 40:
        observer._z = 2.0 * model.state_scale
        observer.measure(y, np.zeros(4))
        samples += 1
    assert samples > 10 and observer.counts["observer restarted"] == 1
    z, _, d = observer.state()
    np.testing.assert_allclose(z, 0.0, atol=1e-12)
    np.testing.assert_allclose(d, y, atol=1e-12)


def test_a_model_that_leaves_its_range_at_rest_starts_at_the_charts_state(trial):
    model = trial.oscillators(0, 1, 0)
    z, y = observer_of(model).rest(np.array([9.0, 0.0, 0.0, 0.0]))
    np.testing.assert_allclose(z, np.zeros(6))
    np.testing.assert_allclose(y, np.zeros(6))


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda one: pickle.loads(pickle.dumps(one))], ids=["copy", "pickle"])
@pytest.mark.parametrize("degree", [1, 3])
def test_a_copy_goes_on_as_the_original_does(trial, copied, degree):
    model = trial.oscillators(0, degree, int(degree > 1))
    observer, (inputs, outputs) = observer_of(model), driven(model, 200)
    for v, y in zip(inputs[:100], outputs[:100]):
        observer.measure(y, v)
    again = copied(observer)
    for v, y in zip(inputs[100:], outputs[100:]):
        observer.measure(y, v)
        again.measure(y, v)
        np.testing.assert_array_equal(np.concatenate(observer.state()[::2]), np.concatenate(again.state()[::2]))


def test_after_a_reset_the_same_measurements_give_the_same_state_to_the_last_bit(trial):
    model = trial.oscillators()
    observer, (inputs, outputs), found = observer_of(model), driven(model, 100), []
    for _ in range(2):
        observer.reset()
        for k, (v, y) in enumerate(zip(inputs, outputs)):
            observer.measure(y + 0.5 * (k == 50), v)
        found.append((*observer.state()[::2], observer.counts))
    np.testing.assert_array_equal(found[0][0], found[1][0])
    np.testing.assert_array_equal(found[0][1], found[1][1])
    assert found[0][2] == found[1][2] == {"gated": 1}


def test_the_steps_of_a_compiled_model_are_its_own(trial):
    for model in (trial.oscillators(), trial.oscillators(0, 1, 0)):
        z, u = 0.01 * np.arange(6.0), np.array([0.1, 0.2, 0.3, 0.0])
        following, output = Stepper(model)(z, u)
        np.testing.assert_allclose(following, model.step(z, u), rtol=1e-12)
        np.testing.assert_allclose(output, model.decode(model.step(z, u)), rtol=1e-12)


def test_sizes_that_do_not_fit_the_model_are_refused_with_both_shapes(trial):
    with pytest.raises(ValueError, match=r"gain has shape \(6, 6\).*expected \(12, 6\)"):
        observer_of(trial.oscillators(), gain=np.eye(6))
