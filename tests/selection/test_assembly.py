"""Models in SI units from centred and scaled tables, and the recovery of a known slow-fast system."""

import numpy as np
import pytest

from ssmr_torch.models.output_coordinates import ConstantCurvature
from ssmr_torch.selection.closed_form import ALL, ClosedForm
from ssmr_torch.selection.rollouts import rolled_out
from ssmr_torch.selection.specification import Specification

FORMS = [Specification(delays=2, memory=("shift", 2), features="cubic"),
         Specification(delays=1, memory=("pole", 0.6), features="configuration_affine"),
         Specification(chart="predictive", states=5, delays=6, memory=("shift", 3), features="full_quadratic"),
         Specification(chart="predictive", states=5, delays=6, memory=("pole", 0.5), features="quadratic", leading=1),
         Specification("constant_curvature", delays=1, memory=("shift", 1), features="bilinear")]


@pytest.fixture(scope="module")
def samples(systems):
    return systems.samples(coordinates={"identity": None, "constant_curvature": ConstantCurvature(((0.01, 0.1),))})


def at_rows(samples, closed, model):
    windows = samples.y[closed.rows[:, None] + np.arange(-model.delays, 1)]
    return windows, samples.u[closed.rows[:, None] + np.arange(-model.delays, 0)]


@pytest.mark.parametrize("form", FORMS, ids=str)
def test_a_model_in_si_units_steps_like_its_centred_regressors(samples, form):
    closed, rng = ClosedForm(samples, form), np.random.default_rng(1)
    chart, assembly, n = closed.charts[ALL], closed.assembly, len(closed.charts[ALL].V)
    z = closed.pasts[0] @ chart.V.T
    inputs = (samples.u[closed.rows] - samples.input_mean) / samples.input_scale
    X = assembly.regressors(np.concatenate([z, closed.memory, inputs], axis=1))
    theta = rng.normal(size=(chart.E.shape[1], X.shape[1]))
    psi = rng.normal(size=(2, len(assembly.curved))) if assembly.regressed else None
    model = assembly.model(chart, theta, psi, np.abs(z).max(0))
    state = model.encode(*at_rows(samples, closed, model))
    np.testing.assert_allclose(state[:, :n], z, atol=1e-10)
    expected = z @ chart.L.T + X @ theta.T @ chart.E.T
    np.testing.assert_allclose(model.step(state, samples.u[closed.rows])[:, :n], expected,
                               atol=1e-10 * np.abs(expected).max())
    xi = samples.latent(form.coordinates)[closed.rows]
    if psi is not None:
        xi = assembly.outputs(np.concatenate([z, closed.memory], axis=1)) @ psi.T
    np.testing.assert_allclose(model.output_form(state), samples.scale * xi, atol=1e-10 * samples.scale)


@pytest.mark.parametrize("memory", [("shift", 1), ("shift", 4), ("pole", 0.4)])
def test_the_memory_holds_the_past_inputs_or_their_filter(samples, memory):
    closed = ClosedForm(samples, Specification(memory=memory))
    model, n, steps = closed.model(0.0), 4, 6
    state = model.encode(*at_rows(samples, closed, model))
    rows = closed.rows[closed.rows + steps < samples.originals]
    state = state[:len(rows)]
    filtered = state[:, n:] * np.tile(samples.input_scale, (model.state_dim - n) // 2)
    for k in range(steps):
        if memory[0] == "shift":
            held = samples.u[(rows + k)[:, None] - 1 - np.arange(int(memory[1]))].reshape(len(rows), -1)
        else:
            held = filtered if k == 0 else 0.4 * held + 0.6 * samples.u[rows + k - 1]
        np.testing.assert_allclose(state[:, n:] * np.tile(samples.input_scale, held.shape[1] // 2), held, atol=1e-12)
        state = model.step(state, samples.u[rows + k])


def test_a_window_of_held_inputs_fills_an_actuators_memory_with_them():
    weights = Specification(memory=("pole", 0.8)).memory_weights(20)
    assert weights.sum() == pytest.approx(1.0, abs=1e-14)
    np.testing.assert_allclose(weights[0, -3:], 0.2 * 0.8 ** np.array([2, 1, 0]), rtol=1e-13)


def test_a_memory_longer_than_the_past_inputs_is_refused_with_both_numbers():
    with pytest.raises(ValueError, match="a memory of 9 past inputs; expected at most 4"):
        Specification(memory=("shift", 9)).memory_weights(4)


def worst(model, samples):
    starts = samples.held_out(1)
    return np.abs(rolled_out(model, starts) - starts.follows).max() / np.abs(samples.y).max()


def bilinear(systems):
    return lambda y, d, u, held: systems.linear(y, d, u, held) + 0.04 * u[1] * np.array([y[1], -d[0]])


@pytest.mark.parametrize(("features", "limit"), [("linear", 1e-7), ("bilinear", 1e-7), ("configuration_affine", 1e-6)])
def test_a_system_of_the_family_is_found_to_rounding(systems, features, limit):
    step = {"linear": systems.linear, "bilinear": bilinear(systems),
            "configuration_affine": systems.configuration_affine}[features]
    samples = systems.samples(step)
    found = {each: worst(ClosedForm(samples, Specification(features=each, memory=("shift", 1))).model(0.0), samples)
             for each in {"linear", features}}
    assert found[features] < limit and (features == "linear" or found["linear"] > 1e-3)


def test_a_fold_is_predicted_by_a_fit_to_the_other_folds(systems):
    samples = systems.samples(systems.configuration_affine)
    closed = ClosedForm(samples, Specification(features="configuration_affine", memory=("shift", 1)))
    starts = samples.held_out(2)
    assert np.abs(rolled_out(closed.model(0.0, fold=2), starts) - starts.follows).max() < 1e-6 * np.abs(samples.y).max()


def test_nonlinear_terms_are_constant_beyond_twice_the_range(systems):
    """A quadratic flow map, which grows without bound, from states and inputs a hundred times as large."""
    samples = systems.samples(systems.configuration_affine)
    model = ClosedForm(samples, Specification(features="full_quadratic")).model(1e-6)
    states = np.random.default_rng(0).normal(size=(50, model.state_dim)) * model.state_scale
    beyond = model.rate(100 * states, np.zeros((50, 2))) - 100 * states @ model.linear_part.T
    within = model.rate(2 * states, np.zeros((50, 2))) - 2 * states @ model.linear_part.T
    assert np.abs(beyond).max() < 10 * np.abs(within).max()
