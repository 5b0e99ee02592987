"""Charts of slow coordinates: the known part of their step, and the recovery of a linear system's states."""

import numpy as np
import pytest

from ssmr_torch.selection.charts import delay_chart, past_of, tangent_chart
from ssmr_torch.selection.closed_form import ALL, ClosedForm
from ssmr_torch.selection.folds_and_starts import Samples
from ssmr_torch.selection.rollouts import rolled_out
from ssmr_torch.selection.specification import Specification


def error(model, samples):
    """Largest error of rollouts over a second, of the largest output."""
    starts = samples.held_out(0)
    return np.abs(rolled_out(model, starts) - starts.follows).max() / np.abs(samples.y).max()


@pytest.mark.parametrize("delays", [0, 1, 4])
def test_a_delay_chart_knows_its_step_except_the_increment_of_the_newest_sample(delays):
    rng, p, m = np.random.default_rng(0), 3, 2
    directions = np.linalg.qr(rng.normal(size=(p, p)))[0]
    chart, y, u = delay_chart(delays, directions, m), rng.normal(size=(delays + 2, p)), rng.normal(size=delays * m)
    here, ahead = (chart.V @ np.concatenate([[1.0], y[k:k + delays + 1].ravel(), u]) for k in (0, 1))
    np.testing.assert_allclose(ahead, chart.L @ here + chart.E @ directions @ (y[-1] - y[-2]), atol=1e-14)
    np.testing.assert_allclose(chart.exact @ here, y[-2], atol=1e-14)
    np.testing.assert_allclose(chart.exact @ ahead, y[-1], atol=1e-14)
    if delays:
        velocity = here[chart.leading:chart.leading + chart.follows]
        np.testing.assert_allclose(velocity, directions @ (y[-2] - y[-3]), atol=1e-14)


def hidden_states(seed, steps, decay=False):
    """Two outputs of four states, two of which neither output shows by itself; inputs held six samples."""
    A = np.zeros((4, 4))
    for first, (size, angle) in zip((0, 2), ((0.97, 0.15), (0.9, 0.45))):
        c, s = size * np.cos(angle), size * np.sin(angle)
        A[first:first + 2, first:first + 2] = [[c, -s], [s, c]]
    B, C = np.array([[0.3, 0.1], [0.1, -0.2], [0.2, 0.3], [-0.1, 0.2]]), np.array([[1, 0, 0.5, 0.1], [0, 0.3, 1, -0.4]])
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-1, 2, (steps // 6 + 1, 2)), 6, axis=0)[:steps] * (not decay)
    x, y = rng.normal(size=4) * decay, []
    for now in u:
        y.append(0.01 * C @ x)
        x = A @ x + B @ now
    return np.array(y), u


@pytest.fixture(scope="module")
def of_four_states():
    return Samples([hidden_states(k, 200, True) for k in (5, 6)], [hidden_states(k, 500) for k in (0, 1)], 0.02,
                   coordinates={"identity": None}, targets=range(2))


def test_a_predictive_chart_of_as_many_states_as_a_linear_system_has_predicts_it_exactly(of_four_states):
    models = {states: ClosedForm(of_four_states, Specification(chart="predictive", states=states, delays=6, future=5,
                                                               memory=("shift", 1))).model(0.0)
              for states in (2, 3, 4)}
    errors = {states: error(model, of_four_states) for states, model in models.items()}
    assert errors[4] < 1e-5 and min(errors[2], errors[3]) > 1e-2
    found = np.sort(np.abs(np.linalg.eigvals(models[4].linear_part)))[-4:]
    np.testing.assert_allclose(found, [0.9, 0.9, 0.97, 0.97], rtol=1e-5)


def test_the_first_coordinates_of_a_predictive_chart_span_the_outputs_at_variance_one(of_four_states):
    closed = ClosedForm(of_four_states, Specification(chart="predictive", states=4, delays=6, future=5))
    chart, past = closed.charts[ALL], closed.pasts[0]
    z = past @ chart.V.T
    np.testing.assert_allclose(z.T @ z / len(z), np.eye(4), atol=0.02)  # of other rows
    assert chart.leading == 2 and chart.follows == 2
    y = of_four_states.latent("identity")[closed.rows]
    left = y - np.column_stack([np.ones(len(z)), z]) @ np.linalg.lstsq(np.column_stack([np.ones(len(z)), z]), y,
                                                                       rcond=None)[0]
    assert np.abs(left).max() < 1e-4 * np.abs(y).max()


def test_the_tangent_space_of_decays_of_two_modes_holds_their_windows(of_four_states):
    t, delays, shape = 0.02 * np.arange(300), 8, 0.01 * np.array([[1.0, 0.3], [-0.4, 0.8]])
    decays = [((shape @ (np.exp(-1.5 * t) * np.stack([np.cos(9 * t + phase), np.sin(9 * t + phase)]))).T,
               np.zeros((300, 2))) for phase in (0.0, 1.0, 2.5)]
    samples = Samples(decays, of_four_states.controlled, 0.02, coordinates={"identity": None}, targets=range(2))
    rows = samples.rows(1, True)
    past = past_of(samples, "identity", delays, rows)
    of_decays, width = past[samples.is_decay[rows]], 1 + 2 * (delays + 1)
    chart = tangent_chart(of_decays.T @ of_decays / len(of_decays), past.T @ past / len(past), slice(1, width),
                          slice(width - 2, width), 2)
    windows = of_decays[:, 1:width]
    z = windows @ chart.V[:, 1:width].T
    again = z @ np.linalg.lstsq(z, windows, rcond=None)[0]
    assert chart.V.shape == (2, past.shape[1]) and np.abs(chart.V[:, width:]).max() == 0
    assert np.abs(again - windows).max() < 1e-9 * np.abs(windows).max()


def test_a_tangent_space_without_decays_and_more_states_than_values_are_refused(systems, of_four_states):
    samples = systems.samples(decays=0)
    with pytest.raises(ValueError, match="the chart tangent_space needs decays"):
        ClosedForm(samples, Specification(chart="tangent_space", states=4, delays=8, decays=False)).model(0.0)
    with pytest.raises(ValueError, match="9 states, but a window has only 8 values"):
        ClosedForm(samples, Specification(chart="predictive", states=9, delays=3)).model(0.0)
    with pytest.raises(ValueError, match="8 states, but the chart has only 6 values to predict"):
        ClosedForm(samples, Specification(chart="predictive", states=8, delays=9, future=2)).model(0.0)
