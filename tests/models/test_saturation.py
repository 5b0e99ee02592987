"""Saturation of nonlinear terms outside the training range."""

import numpy as np
import pytest
import torch

from ssmr_torch.models.control_augmented import ControlAugmentedSSMR
from ssmr_torch.models.saturation import saturated

EDGE = np.array([0.5, 2.0, np.inf])


def model(saturates):
    """A damped oscillator with a quadratic term that drives it off where it moves far."""
    made = ControlAugmentedSSMR(2, 1, 2, 0, dynamics_degree=2, saturated=saturates, timestep=0.01)
    with torch.no_grad():
        made.chart.copy_(torch.eye(2, dtype=torch.float64))
        made.parametrization.copy_(torch.eye(2, dtype=torch.float64))
        made.dynamics_table[:, :3] = torch.tensor([[0.0, 5.0, 0.0], [-5.0, -1.0, 3.0]], dtype=torch.float64)
        made.dynamics_table[1, 3] = 20.0
        made.state_scale.fill_(0.5)
    return made


def test_nothing_changes_within_the_edge_and_the_limit_is_1_5_times_the_edge():
    inside = np.array([[0.5, -2.0, 1e9], [-0.3, 0.0, -7.0]])
    within, slopes = saturated(inside, EDGE, np.tanh)
    np.testing.assert_array_equal(within, inside)
    np.testing.assert_array_equal(slopes, 1.0)
    within, slopes = saturated(np.array([50.0, -1e6, 3.0]), EDGE, np.tanh)
    np.testing.assert_allclose(within, [0.75, -3.0, 3.0], rtol=1e-12)
    np.testing.assert_allclose(slopes, [0.0, 0.0, 1.0], atol=1e-12)


def test_the_slope_is_the_derivative_and_bends_continuously_at_the_edge():
    z, h = np.linspace(-1.5, 1.5, 301)[:, None] + 1e-3, 1e-6
    edge = EDGE[:1]
    difference = (saturated(z + h, edge, np.tanh)[0] - saturated(z - h, edge, np.tanh)[0]) / (2 * h)
    np.testing.assert_allclose(difference, saturated(z, edge, np.tanh)[1], atol=1e-8)
    assert abs(saturated(edge + 1e-4, edge, np.tanh)[1] - 1.0) < 1e-6  # the second derivative starts from 0


def test_numpy_arrays_and_tensors_are_both_accepted():
    z = np.random.default_rng(0).standard_normal((20, 3))
    for ours, theirs in zip(saturated(z, EDGE, np.tanh),
                            saturated(torch.from_numpy(z), torch.from_numpy(EDGE), torch.tanh)):
        np.testing.assert_allclose(theirs.numpy(), ours, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("saturates", [True, False])
def test_a_polynomial_diverges_under_large_inputs_and_a_saturated_one_stays_bounded(saturates):
    inputs = torch.full((1, 2000, 1), 2.0, dtype=torch.float64)
    rollout = model(saturates).rollout(torch.zeros(1, 2, dtype=torch.float64), inputs)
    assert bool(rollout.diverged_at <= 2000) is not saturates


def test_a_saturated_model_is_the_polynomial_within_the_training_range():
    z, u = 0.5 * (2 * torch.rand(50, 2).double() - 1), torch.rand(50, 1).double()
    one, other = model(True), model(False)
    torch.testing.assert_close(one.step(z, u), other.step(z, u), rtol=1e-15, atol=0.0)
    for ours, theirs in zip(one.linearize(z, u), other.linearize(z, u)):
        torch.testing.assert_close(ours, theirs, rtol=1e-14, atol=1e-16)
