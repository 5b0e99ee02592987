"""Derivatives of rollouts with respect to coefficients."""

import pytest
import torch
from torch.func import functional_call, jacrev

from ssmr_torch.data.windows import RolloutBatch
from ssmr_torch.fitting.rollout_sensitivities import GROUPS, coefficients, rollout_sensitivities
from ssmr_torch.models.control_augmented import ControlAugmentedSSMR
from ssmr_torch.models.koopman import Koopman
from ssmr_torch.models.ssmr import SSMR

MODELS = {
    "continuous time": lambda: SSMR(3, 2, 2, 2, dynamics_degree=2, parametrization_degree=2, control_degree=1,
                                    timestep=0.02, window_timestep=0.01, substeps=2),
    "constant input matrix": lambda: SSMR(3, 2, 2, 1, dynamics_degree=3, control_degree=0, chart_degree=2),
    "control-augmented": lambda: ControlAugmentedSSMR(3, 2, 2, 2, parametrization_degree=2, timestep=0.02,
                                                      base_timestep=0.01, window_timestep=0.01),
    "control-augmented, saturated": lambda: ControlAugmentedSSMR(3, 2, 2, 1, dynamics_degree=3, saturated=True),
}


def random(build):
    model = build()
    with torch.no_grad():
        for table in model.parameters():
            table.copy_(0.3 * torch.randn_like(table))
        model.state_scale.fill_(0.5)
    return model


def batch_for(model, starts=4, horizon=5):
    return RolloutBatch(torch.randn(starts, model.delays + 1, 2).double(),
                        torch.randn(starts, model.delays, 2).double(), torch.randn(starts, horizon, 2).double(),
                        torch.randn(starts, horizon, 2).double())


class Predicted(torch.nn.Module):
    """The model's outputs along a rollout, as a function that can be differentiated by its parameters."""

    def __init__(self, model):
        super().__init__()
        self.model = model

    def forward(self, batch):
        z, outputs = self.model.encode(batch.window, batch.window_inputs), []
        for k in range(batch.inputs.shape[1]):
            z = self.model.step(z, batch.inputs[:, k])
            outputs.append(self.model.decode(z))
        return torch.stack(outputs)


@pytest.mark.parametrize("build", MODELS.values(), ids=MODELS)
@pytest.mark.parametrize("groups", [GROUPS, ("dynamics",), ("chart", "parametrization")], ids=str)
def test_sensitivities_equal_automatic_differentiation(build, groups):
    model = random(build)
    batch = batch_for(model)
    predicted = Predicted(model)
    parameters = {name: value.detach() for name, value in predicted.named_parameters()}
    derivative = jacrev(lambda p: functional_call(predicted, p, (batch,)))(parameters)
    tables = {"dynamics": ("drift_table", "control_table", "dynamics_table"), "chart": ("chart",),
              "parametrization": ("parametrization",)}
    for step, outputs, jacobian in rollout_sensitivities(model, batch, (1, 3, 5), groups):
        expected = []
        for name in (f"model.{table}" for group in GROUPS if group in groups for table in tables[group]):
            if name in derivative:
                part = derivative[name][step - 1]
                part = part[..., -2:, :] if name == "model.parametrization" else part
                expected.append(part.flatten(2))
        torch.testing.assert_close(jacobian, torch.cat(expected, dim=2), rtol=1e-10, atol=1e-11)
        torch.testing.assert_close(outputs, predicted(batch)[step - 1].detach(), rtol=1e-12, atol=1e-13)
        assert jacobian.shape[2] == sum(table.numel() for table in coefficients(model, groups))


def test_the_coefficients_are_views_of_the_models_tables():
    model = random(MODELS["continuous time"])
    for table in coefficients(model):
        table.fill_(2.0)
    assert (model.drift_table == 2).all() and (model.control_table == 2).all() and (model.chart == 2).all()
    assert (model.parametrization[-2:] == 2).all() and (model.parametrization[:-2] != 2).all()


def test_models_and_groups_without_tables_are_refused():
    with pytest.raises(ValueError, match="Koopman has no coefficient tables.*fit=rollout"):
        coefficients(Koopman(1, 1))
    with pytest.raises(ValueError, match="trained is .'manifold'.; expected one or more of"):
        coefficients(random(MODELS["continuous time"]), ("manifold",))
