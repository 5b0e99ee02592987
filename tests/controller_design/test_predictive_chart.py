"""Claims about predictive charts and models: exact outputs, units, sizes, and what is refused."""

import numpy as np
import pytest
from oscillators import MIXED, PULL, SIGNED, Oscillators, recordings

from ssmr_torch.controller_design.model_choice import all_tried, choose_predictive, horizon_error, spectral_radii
from ssmr_torch.controller_design.predictive_chart import Form, held_error
from ssmr_torch.controller_design.recordings import recordings_of

NOISY = {"of_sensor": 3e-5, "of_inputs": 0.01, "cubic": 100.0}


@pytest.fixture(scope="module", params=["signed", "pull", "mixed", "small unit"])
def recorded(request):
    bounds = {"pull": PULL, "mixed": MIXED}.get(request.param, SIGNED)
    robot = Oscillators(bounds, **NOISY, scale=0.02 if request.param == "small unit" else 1.0)
    return recordings_of(recordings(robot, runs=3, seconds=8.0, test=0), (0, 1), robot.input_bounds)


def measured(recorded, model, rng, count=20):
    """Windows (count, d + 1, p), past inputs (count, d, m) and inputs (count, m) of a held-out run."""
    piece, d = recorded.held[0], model.delays
    k = rng.integers(d, len(piece.input), count)
    back = k[:, None] + np.arange(-d, 1)
    return piece.observation[back], piece.input[back[:, :-1]], piece.input[k]


@pytest.mark.parametrize("keep", [(0, 1), (4, 0, 2)], ids=str)
@pytest.mark.parametrize("past_inputs", [True, False], ids=["past inputs", "outputs alone"])
def test_kept_outputs_are_decoded_as_they_were_measured(recorded, fitted, rng, keep, past_inputs):
    _, model = fitted(recorded, Form(keep, 3, 9, 3, past_inputs=past_inputs))
    windows, past, _ = measured(recorded, model, rng)
    again = model.decode(model.encode(windows, past))
    np.testing.assert_allclose(again[:, list(keep)], windows[:, -1, list(keep)], rtol=0, atol=1e-10)


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_a_step_of_the_model_in_si_is_the_regression_in_scaled_arrays(recorded, fitted, rng, degree):
    form = Form((0, 1), 3, 9, degree, ridge=1e-6)
    regression, model = fitted(recorded, form)
    windows, past, inputs = measured(recorded, model, rng)
    z = 0.5 * model.encode(windows, past)       # within the range, beyond which nonlinear terms saturate
    scaled = (inputs - recorded.bounds.mean(0)) / (0.5 * recorded.input_range)
    monomials = regression.monomials
    phi = monomials.chosen_rows(monomials.rows(np.ascontiguousarray(np.hstack([z, scaled]).T))).T
    np.testing.assert_allclose(model.step(z, inputs), z + phi @ regression.dynamics(degree, form.ridge), rtol=0,
                               atol=1e-9 * np.abs(z).max())


def test_the_prediction_error_in_si_equals_that_of_the_regression(fitted):
    robot = Oscillators(**NOISY)
    recorded = recordings_of(recordings(robot, runs=3, seconds=8.0, test=0), (0, 1), robot.input_bounds)
    form = Form((0, 1), 3, 9, 2)
    regression, model = fitted(recorded, form)
    said = held_error(regression.errors(regression.dynamics(2, form.ridge), 20), (0, 1))
    assert horizon_error(model, recorded) == pytest.approx(said, rel=1e-6)


def test_no_model_that_is_tried_has_more_states_than_its_window_has_values():
    robot = Oscillators(**NOISY)
    data = recordings(robot, runs=3, seconds=8.0, test=0).observing(["x", "y"])
    tried = [form for form, _ in all_tried(recordings_of(data, (0, 1), robot.input_bounds))]
    values = [form.window * 2 + (form.window - 1) * 2 * form.past_inputs for form in tried]
    assert all(form.states <= most for form, most in zip(tried, values))
    assert not any(form.window == 3 and not form.past_inputs for form in tried)  # six values, and eight states at least
    assert any(form.window == 3 and form.states == 8 for form in tried)


def test_models_that_grow_along_the_data_are_refused():
    robot = Oscillators(damping=-0.1, of_sensor=3e-5)
    recorded = recordings_of(recordings(robot, runs=4, seconds=4.0, test=0), (0, 1), robot.input_bounds)
    forms = [(Form((0, 1), 2, 8, degree), 0.01) for degree in (1, 2)]
    with pytest.raises(ValueError, match=r"all 2 models grow outside their data \(spectral radius above "
                                         r"1.01"):
        choose_predictive(recorded, forms)


def test_a_model_that_does_not_grow_is_chosen_before_one_that_grows(recorded, fitted, monkeypatch):
    from ssmr_torch.controller_design import model_choice

    wild, tame, other = Form((0, 1), 3, 9, 2), Form((0, 1), 3, 8, 1), Form((0, 1), 2, 10, 1)
    monkeypatch.setattr(model_choice, "spectral_radii", lambda model, acted:
                        np.array([1.1]) if model.state_dim == wild.states else spectral_radii(model, acted))
    chosen = choose_predictive(recorded, [(wild, 0.001), (tame, 0.002), (other, 0.003)])
    assert chosen.model.state_dim == tame.states and chosen.error == 0.002
    assert chosen.twin.state_dim == other.states and chosen.twin_error == 0.003
