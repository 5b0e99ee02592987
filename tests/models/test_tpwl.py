"""Trajectory piecewise linear models: the weights of the points, and the filter in the chart."""

import dataclasses

import numpy as np
import pytest
import torch

from ssmr_torch.models.torch_model import FixedModel
from ssmr_torch.models.tpwl import TPWL


@pytest.fixture
def model():
    """Four points along q̃_1, each with its own stable maps; 2 modes, 2 inputs, 3 outputs."""
    found = TPWL(2, 3, 3, modes=2, points=4)
    generator = torch.Generator().manual_seed(3)
    with torch.no_grad():
        for table in (found.A, found.B, found.c, found.C, found.d, found.mean):
            table.copy_(0.2 * torch.randn(table.shape, generator=generator, dtype=torch.float64))
        found.A += 0.6 * torch.eye(4, dtype=torch.float64)
        found.points[:, 0] = torch.arange(4)
        for table, size in ((found.covariance, 2.0), (found.process, 0.3), (found.measurement, 0.5)):
            table.copy_(size * torch.eye(len(table), dtype=torch.float64))
        found.covariance[0, 2] = found.covariance[2, 0] = 0.7
        found.state_scale.fill_(1.0)
    return found


def windows(model, count=5):
    generator = torch.Generator().manual_seed(4)
    return (torch.randn(count, model.delays + 1, model.output_dim, generator=generator, dtype=torch.float64),
            torch.rand(count, model.delays, model.input_dim, generator=generator, dtype=torch.float64))


def textbook_filter(A, B, c, C, d, mean, covariance, process, measurement, window, inputs):
    """Kalman's filter of a linear system for one window, written down once more with explicit inverses."""
    z, P = mean, covariance
    for k, y in enumerate(window):
        if k:
            z, P = A @ z + B @ inputs[k - 1] + c, A @ P @ A.T + process
        K = P @ C.T @ np.linalg.inv(C @ P @ C.T + measurement)
        z, P = z + K @ (y - C @ z - d), (np.eye(len(z)) - K @ C) @ P
    return z


def test_the_nearest_point_does_not_depend_on_velocities(model):
    z = torch.tensor([[1.4, 0.3, 50.0, -70.0], [1.6, -0.2, 0.0, 0.0]], dtype=torch.float64)
    u = torch.rand(2, 2, dtype=torch.float64)
    for row, nearest in enumerate((1, 2)):
        expected = model.A[nearest] @ z[row] + model.B[nearest] @ u[row] + model.c[nearest]
        torch.testing.assert_close(model.reduced.advance(z, u)[row], expected)


def test_a_narrow_blend_is_the_nearest_point_and_a_wide_one_the_mean_of_all(model):
    z, u = torch.tensor([1.3, 0.2, 0.1, -0.4], dtype=torch.float64), torch.rand(2, dtype=torch.float64)
    model.width = 1e-2
    torch.testing.assert_close(model.reduced.advance(z, u), model.A[1] @ z + model.B[1] @ u + model.c[1])
    model.width = 1e6
    torch.testing.assert_close(model.reduced.advance(z, u), model.A.mean(0) @ z + model.B.mean(0) @ u + model.c.mean(0))


def test_between_two_points_both_act_alike(model):
    z, u = torch.tensor([1.5, 0.0, 0.1, -0.4], dtype=torch.float64), torch.rand(2, dtype=torch.float64)
    model.width = 0.2
    both = [model.A[i] @ z + model.B[i] @ u + model.c[i] for i in (1, 2)]
    torch.testing.assert_close(model.reduced.advance(z, u), (both[0] + both[1]) / 2, rtol=1e-9, atol=0)


@pytest.mark.parametrize("width", [0.05, 0.5, 50.0])
@pytest.mark.parametrize("shape", [(), (3,), (2, 3)])
def test_skipping_points_of_negligible_weight_does_not_change_the_blend(width, shape):
    generator = torch.Generator().manual_seed(7)
    found = TPWL(2, 3, 3, modes=2, points=70, width=width)
    with torch.no_grad():
        for table in (found.A, found.B, found.c, found.points):
            table.copy_(torch.randn(table.shape, generator=generator, dtype=torch.float64))
    z = torch.randn(*shape, 4, generator=generator, dtype=torch.float64)
    u = torch.randn(*shape, 2, generator=generator, dtype=torch.float64)
    for ours, whole in zip(found.reduced.numpy().advance_linearization(z.numpy(), u.numpy()),
                           found.reduced.advance_linearization(z, u)):
        np.testing.assert_allclose(ours, whole.detach(), rtol=1e-10, atol=1e-12 / width ** 2)
    np.testing.assert_allclose(found.reduced.numpy().advance(z.numpy(), u.numpy()),
                               found.reduced.advance(z, u).detach(), atol=1e-13)


def test_with_one_point_the_chart_is_the_kalman_filter_of_the_textbook(model):
    linear = FixedModel(dataclasses.replace(model.reduced.numpy(), points=np.zeros((1, 2)), **{
        name: getattr(model.reduced.numpy(), name)[:1] for name in ("A", "B", "c")}))
    window, inputs = windows(linear)
    encoded = linear.encode(window, inputs).detach().numpy()
    t = linear.reduced.numpy()
    for row, found in enumerate(encoded):
        expected = textbook_filter(t.A[0], t.B[0], t.c[0], t.C, t.d, t.mean, t.covariance, t.process, t.measurement,
                                   window[row].numpy(), inputs[row].numpy())
        np.testing.assert_allclose(found, expected, rtol=1e-11, atol=1e-12)


@pytest.mark.parametrize("width", [0.0, 0.7])
def test_the_filter_is_the_same_in_numpy_on_windows_far_from_its_prediction(model, width):
    model.width = width
    window, inputs = windows(model)
    np.testing.assert_allclose(model.reduced.numpy().encode(window.numpy(), inputs.numpy()),
                               model.encode(window, inputs).detach().numpy(), rtol=1e-11, atol=1e-12)


def test_a_window_at_twice_the_spacing_takes_two_steps_between_its_samples(model):
    coarse = FixedModel(dataclasses.replace(model.reduced.numpy(), window_timestep=0.02, delays=1))
    inputs = torch.rand(1, 1, 2, dtype=torch.float64)
    expected = coarse.at_timestep(0.02).rollout(coarse.mean[None], inputs).states
    torch.testing.assert_close(coarse.encode(coarse.decode(expected), inputs), expected[:, -1])


def test_accurate_measurements_are_reproduced_and_poor_ones_ignored(model):
    window, inputs = windows(model)
    model.measurement.mul_(1e-10)
    torch.testing.assert_close(model.decode(model.encode(window, inputs)), window[:, -1], rtol=1e-6, atol=1e-6)
    model.measurement.mul_(1e22)
    expected = model.rollout(model.mean.expand(5, -1), inputs).states[:, -1]
    torch.testing.assert_close(model.encode(window, inputs), expected, rtol=1e-8, atol=1e-8)


def test_more_points_and_modes_fit_into_the_same_model_and_its_file(model):
    model.resize(5, 7, 0.1)
    assert model.state_dim == 10 and model.A.shape == (7, 10, 10) and len(model.state_scale) == 10
    again = TPWL(**model.arguments)
    again.load_state_dict(model.state_dict())
    assert again.width == 0.1


@pytest.mark.parametrize(("change", "message"), [
    ({"modes": 0}, "0 modes, 1 points"), ({"points": 0}, "0 points"), ({"width": -1.0}, "width of -1.0 m"),
    ({"window_timestep": 0.015}, "1.5 times")])
def test_impossible_sizes_are_refused_with_the_numbers(change, message):
    with pytest.raises(ValueError, match=message):
        TPWL(4, 3, **change)
