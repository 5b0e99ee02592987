"""Closed-form fits of baselines, on systems of the same kind that they must recover."""

import numpy as np
import pytest

from ssmr_torch.models.named_structures import koopman_structure
from ssmr_torch.models.polynomial import PolynomialModel
from ssmr_torch.selection.baseline import Baseline
from ssmr_torch.selection.baseline_choice import KINDS, choose_baseline
from ssmr_torch.selection.folds_and_starts import Samples
from ssmr_torch.selection.koopman_baselines import KoopmanForm
from ssmr_torch.selection.stability import decays_at_rest
from ssmr_torch.selection.trial import Trial

DT = 0.02
A = np.array([[0.95, 0.12], [-0.12, 0.95]])
B = np.array([[0.004, 0.001], [-0.001, 0.005]])
N = np.array([[[0.0, 0.05], [0.02, 0.0]], [[-0.03, 0.0], [0.0, 0.04]]])

# y⁺ of each kind: linear, bilinear in y and u, quadratic in y, and quadratic with y₁² closed under the dynamics
SYSTEMS = {
    "dmd": lambda y, u: A @ y + B @ u,
    "static_pregain": lambda y, u: A @ y + B @ u,
    "edmd_bilinear": lambda y, u: A @ y + B @ u + np.einsum("jab,b,j->a", N, y, u),
    "edmd_relift": lambda y, u: A @ y + B @ u + np.array([0.3 * y[0] * y[1], -0.5 * y[0] ** 2]),
    "edmd": lambda y, u: np.array([0.9 * y[0], 0.95 * y[1] + 5.0 * y[0] ** 2 + B[1] @ u])}


def run(step, steps, rng, start=None):
    """y (T, 2) m of a system under inputs that are held for ten samples; from `start` without any."""
    u = np.zeros((steps, 2)) if start is not None else np.repeat(rng.uniform(-1, 1, (steps // 10, 2)), 10, axis=0)
    y = [np.array([0.04, 0.0]) if start is None else start]
    for each in u[:-1]:
        y.append(step(y[-1], each))
    return np.array(y), u


def samples_of(step, *, decays=4, runs=4, steps=400):
    rng = np.random.default_rng(0)
    resting = [run(step, 100, rng, 0.04 * rng.normal(size=2)) for _ in range(decays)]
    return Samples(resting, [run(step, steps, rng) for _ in range(runs)], DT, coordinates={"identity": None},
                   targets=range(2))


@pytest.mark.parametrize("kind", SYSTEMS)
def test_a_koopman_form_finds_a_system_of_its_own_kind(kind):
    """Predictions over a second, under inputs that it has not seen, to 1e-6 of the outputs."""
    samples = samples_of(SYSTEMS[kind])
    model = KoopmanForm(samples, Baseline(kind, delays=1, input_delays=int(kind != "static_pregain"))).model(1e-12)
    y, u = run(SYSTEMS[kind], 400, np.random.default_rng(1))
    z, seen = model.encode(y[None, 9:11], u[None, 9:10])[0], []
    for each in u[10:60]:
        z = model.step(z, each)
        seen.append(model.decode(z))
    np.testing.assert_allclose(seen, y[11:61], atol=1e-6 * np.abs(y).max())


def test_known_entries_of_the_next_window_are_set_without_regression():
    samples = samples_of(SYSTEMS["dmd"])
    model = KoopmanForm(samples, Baseline("dmd", delays=2, input_delays=2)).model(1e-3)
    y, u = samples.controlled[0]
    here, ahead = (model.encode(y[k - 2:k + 1], u[k - 2:k]) for k in (50, 51))
    found = model.step(here, u[50])
    np.testing.assert_allclose(np.delete(found, [1, 2]), np.delete(ahead, [1, 2]), rtol=1e-12)
    assert np.abs(found[1:3] - ahead[1:3]).max() > 1e-9  # a ridge of 1e-3 shrinks what is regressed


@pytest.mark.parametrize("kind", ["ssmr", "sssr", "ssmr_control_augmented"])
def test_a_form_on_a_manifold_predicts_a_bilinear_system(kind):
    """Of the order of the difference quotient: within 3 % of persistence over a second."""
    trial = Trial(samples_of(SYSTEMS["edmd_bilinear"], steps=600))
    assert choose_baseline(trial, kind, seconds=3.0).outcome.e[-1] < 0.03


def test_the_rule_chooses_a_ridge_that_predicts_and_tells_its_form():
    trial = Trial(samples_of(SYSTEMS["dmd"]))
    choice = choose_baseline(trial, "dmd", seconds=5.0)
    assert choice.outcome.e.max() < 1e-4 and choice.refused == 0
    assert "a window of" in str(choice) and f"best of {choice.tried} forms" in str(choice)


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_is_found_without_decays(kind):
    model = choose_baseline(Trial(samples_of(SYSTEMS["dmd"], decays=0)), kind, seconds=0.5).model
    assert decays_at_rest(model) and model.timestep == DT


def test_a_kind_that_does_not_exist_is_refused_with_those_that_do():
    with pytest.raises(ValueError, match="no baseline 'dnd'; the baselines are dmd, edmd"):
        choose_baseline(Trial(samples_of(SYSTEMS["dmd"])), "dnd")


@pytest.mark.parametrize(("factor", "decays"), [(0.99, True), (1.01, False)])
def test_the_constant_observable_does_not_count_as_a_mode_that_does_not_decay(factor, decays):
    structure = koopman_structure(1, 1, 0, input_delays=0, degree=1, constant=True, bilinear=False, relift=False)
    model = PolynomialModel(
        structure=structure, chart=np.zeros((0, 2)), parametrization=np.eye(1), state_scale=np.ones(2),
        dynamics=np.array([[1.0, 0.0, 0.0], [0.0, factor, 0.1]]), input_dim=1, output_dim=1, delays=0, timestep=DT,
        window_timestep=DT)
    assert decays_at_rest(model) == decays


def test_a_form_with_more_regressors_than_any_data_determine_is_refused():
    with pytest.raises(ValueError, match="regressors for a window of 21 samples, 20 past inputs.*; at most 700"):
        KoopmanForm(samples_of(SYSTEMS["edmd"]), Baseline("edmd", delays=20, input_delays=20))
