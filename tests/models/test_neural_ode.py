"""Claims about the neural ODE only; claims about all models are in test_contract.py."""

import pytest
import torch

from ssmr_torch.models.neural_ode import NeuralODE


def network(**options):
    torch.manual_seed(3)
    model = NeuralODE(4, 2, 2, 1, **{"timestep": 0.01, "width": 16, "depth": 2} | options)
    with torch.no_grad():
        for table in (model.last, model.linear, model.control):
            table.copy_(0.5 * torch.randn(table.shape, dtype=torch.float64))
        model.linear += torch.block_diag(*(torch.tensor([[-2.0, w], [-w, -2.0]]) for w in (11.0, 16.0))).double()
        model.state_scale.fill_(0.1)
    return model


def test_the_field_is_affine_in_the_input():
    model = network()
    z, u, v = 0.1 * torch.randn(5, 4).double(), torch.randn(5, 2).double(), torch.randn(5, 2).double()
    rate = model.reduced.rate
    torch.testing.assert_close(rate(z, u + v) - rate(z, u), rate(z, v) - rate(z, 0 * v))


def test_with_its_last_layer_zero_it_is_its_linear_and_bilinear_part():
    model = network()
    with torch.no_grad():
        model.last.zero_()
    z, u = 0.1 * torch.randn(5, 4).double(), torch.randn(5, 2).double()
    table = model.control.unflatten(1, (5, 2))
    expected = z @ model.linear.T + u @ table[:, 0].T + torch.einsum("bq,nqm,bm->bn", z, table[:, 1:], u)
    torch.testing.assert_close(model.reduced.rate(z, u), expected)


def test_adaptive_steps_give_what_one_step_of_order_four_gives():
    torchdiffeq = pytest.importorskip("torchdiffeq")
    model = network()
    z, u = 0.1 * torch.randn(20, 4).double(), torch.rand(20, 2).double()
    with torch.no_grad():
        exact = torchdiffeq.odeint(lambda t, x: model.reduced.rate(x, u), z, torch.tensor([0.0, 0.01]).double(),
                                   rtol=1e-10, atol=1e-12)[-1]
        assert float((model.step(z, u) - exact).norm() / (exact - z).norm()) < 1e-4
        assert float((model.step(z, u) - exact).norm() / exact.norm()) < 1e-5


@pytest.mark.parametrize(("options", "message"), [
    ({"width": 0}, "width is 0; expected a whole"), ({"depth": 0}, "depth is 0"), ({"width": 2.5}, "a whole number"),
    ({"delays": 0}, "holds 2 values, fewer than the 4")])
def test_impossible_sizes_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        NeuralODE(4, 2, 2, **options)


def test_all_tensors_of_a_rollout_are_on_the_device_of_the_model():
    model = network(depth=2).to("meta")
    z, inputs = torch.empty(5, 4, dtype=torch.float64, device="meta"), torch.empty(5, 3, 2, device="meta").double()
    rollout, linear = model.rollout(z, inputs), model.linearize(z, inputs[:, 0])
    made = (*rollout, *linear, *model.linearize_output(z), model.encode(torch.empty(5, 2, 2, device="meta").double()))
    assert all(tensor.device.type == "meta" for tensor in made)


def test_a_step_can_be_exported():
    model = network()
    z, u = 0.1 * torch.randn(5, 4).double(), torch.randn(5, 2).double()

    class Step(torch.nn.Module):
        def __init__(self):
            super().__init__()
            self.model = model

        def forward(self, z, u):
            return self.model.step(z, u), self.model.linearize(z, u).A

    exported = torch.export.export(Step(), (z, u)).module()
    for found, expected in zip(exported(z, u), Step()(z, u)):
        torch.testing.assert_close(found, expected, rtol=1e-12, atol=1e-14)
