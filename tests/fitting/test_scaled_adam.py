"""Adam on scaled coefficients."""

import pytest
import torch

from ssmr_torch.fitting.scaled_adam import ScaledAdam, table_scales
from ssmr_torch.models.monomials import graded
from ssmr_torch.models.neural_ode import NeuralODE
from ssmr_torch.models.ssmr import SSMR


@pytest.fixture
def start():
    generator = torch.Generator().manual_seed(0)
    return torch.randn(3, 4, generator=generator, dtype=torch.float64)


@pytest.fixture
def scale():
    return torch.logspace(-3, 6, 12, dtype=torch.float64).reshape(3, 4)


def loss_of(theta, scale):
    return ((theta / scale - 1.5) ** 4).sum() + (theta / scale).prod(dim=1).sin().sum()


def test_it_is_adam_on_the_scaled_coefficients_with_the_gradient_clipped_there(start, scale):
    theta = torch.nn.Parameter(start * scale)
    phi = torch.nn.Parameter(start.clone())
    ours, plain = ScaledAdam([{"params": [theta], "scale": scale}], lr=0.05), torch.optim.Adam([phi], lr=0.05)
    for _ in range(30):
        for optimizer, value in ((ours, lambda: loss_of(theta, scale)), (plain, lambda: loss_of(phi, 1.0))):
            optimizer.zero_grad()
            value().backward()
        ours.clip(0.7)
        torch.nn.utils.clip_grad_norm_([phi], 0.7)
        ours.step()
        plain.step()
    torch.testing.assert_close(theta / scale, phi, rtol=1e-5, atol=1e-9)


def test_without_a_scale_it_is_adam(start):
    ours, plain = (torch.nn.Parameter(start.clone()) for _ in range(2))
    pair = ((ScaledAdam([{"params": [ours], "scale": None}], lr=0.1), ours), (torch.optim.Adam([plain], lr=0.1), plain))
    for _ in range(5):
        for optimizer, parameter in pair:
            def closure(optimizer=optimizer, parameter=parameter):
                optimizer.zero_grad()
                value = loss_of(parameter, 1.0)
                value.backward()
                return value
            optimizer.step(closure)
    torch.testing.assert_close(ours, plain, rtol=0, atol=0)


def test_clipping_leaves_small_gradients_as_they_are(start, scale):
    theta = torch.nn.Parameter(start * scale)
    optimizer = ScaledAdam([{"params": [theta], "scale": scale}], lr=0.05)
    loss_of(theta, scale).backward()
    before = theta.grad.clone()
    size = (before * scale).norm()
    optimizer.clip(2 * float(size))
    torch.testing.assert_close(theta.grad, before, rtol=0, atol=0)
    optimizer.clip(0.5 * float(size))
    torch.testing.assert_close((theta.grad * scale).norm(), 0.5 * size)


@pytest.fixture
def model():
    model = SSMR(2, 2, 3, 1, parametrization_degree=2, dynamics_degree=3, control_degree=1)
    generator = torch.Generator().manual_seed(1)
    with torch.no_grad():
        for table in model.parameters():
            table.copy_(torch.randn(table.shape, generator=generator, dtype=torch.float64))
        model.state_scale.copy_(torch.tensor([0.02, 0.05]))
    return model


@torch.no_grad()
def test_a_step_of_one_scale_changes_a_row_at_the_edge_of_the_data_by_its_own_size(model):
    edge = model.state_scale
    joint = model.structure.dynamics(torch.cat([edge, torch.ones(2, dtype=torch.float64)]))
    free = model.drift_table.shape[1]
    features = {"drift_table": joint[:free], "parametrization": model.structure.parametrization(edge),
                "control_table": joint[free:]}
    scales = table_scales(model)
    assert set(scales) == set(features)
    for name, monomials in features.items():
        size = (getattr(model, name).abs() * monomials).sum(1)
        for j in range(len(monomials)):
            torch.testing.assert_close(scales[name][:, j] * monomials[j], size, rtol=1e-12, atol=0)


@torch.no_grad()
def test_scales_follow_the_units_of_length(model):
    """In millimetres a coefficient of degree d in a row of the drift is 1000^(1 - d) times that in metres."""
    factors = torch.from_numpy(1000.0 ** (1 - graded(2, 1, 3).exponents.sum(1)))
    metres = table_scales(model)["drift_table"]
    model.drift_table *= factors
    model.state_scale *= 1000
    torch.testing.assert_close(table_scales(model)["drift_table"], metres * factors, rtol=1e-12, atol=0)


def test_a_model_without_a_training_range_has_no_scales():
    assert table_scales(SSMR(2, 1, 3, 1)) == {}


@torch.no_grad()
def test_steps_of_one_scale_in_a_whole_row_move_coordinates_and_outputs_by_their_largest_values():
    model = NeuralODE(2, 2, 3, 1)
    model.parametrization.copy_(torch.randn(3, 2, generator=torch.Generator().manual_seed(0)))
    model.state_scale.copy_(torch.tensor([0.02, 0.05]))
    scales, output = table_scales(model), model.parametrization.abs() @ model.state_scale
    torch.testing.assert_close(scales["chart"] @ output.repeat(2), model.state_scale)
    torch.testing.assert_close(scales["parametrization"] @ model.state_scale, output)
    torch.testing.assert_close(scales["linear"] * model.state_scale, model.state_scale[:, None].expand(2, 2))
    edge = torch.cat([torch.ones(2), model.state_scale.repeat_interleave(2)])
    torch.testing.assert_close(scales["control"] * edge, model.state_scale[:, None].expand(2, 6))
    assert set(scales) == {"chart", "parametrization", "linear", "control"}
