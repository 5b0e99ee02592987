"""Gradient fits: neural ODEs from their linear start, early stopping, growing rollouts."""

from types import SimpleNamespace

import lightning
import numpy as np
import pytest
import torch

from ssmr_torch.data.datamodule import TrajectoryDataModule
from ssmr_torch.data.windows import RolloutBatch
from ssmr_torch.fitting.fit import LeastSquaresFit
from ssmr_torch.fitting.gradient_fit import GradientFit
from ssmr_torch.fitting.neural_ode_start import NeuralODEStart
from ssmr_torch.fitting.ssmr_least_squares import SSMRLeastSquares
from ssmr_torch.models.neural_ode import NeuralODE
from ssmr_torch.models.ssmr import SSMR

FROZEN = ("chart", "parametrization", "linear", "control")
pytestmark = [pytest.mark.filterwarnings("ignore:.*does not have many workers"),
              pytest.mark.filterwarnings("ignore:.*smaller than the logging interval")]


def run(fit, dataset, tmp_path):
    module = TrajectoryDataModule(dataset, validation_share=0.2, validation_horizon=0.3, rollout_horizon=0.3,
                                  stride=3).prepare(fit)
    trainer = lightning.Trainer(max_epochs=fit.epochs, accelerator="cpu", logger=False, enable_progress_bar=False,
                                enable_checkpointing=False, enable_model_summary=False, num_sanity_val_steps=0,
                                default_root_dir=tmp_path)
    trainer.fit(fit, module)
    return trainer.validate(fit, module, verbose=False)[0]["validation/rmse"], trainer


def test_the_start_of_a_neural_ode_is_sssr(known, solve_stages):
    network = NeuralODE(2, 2, 4, 1)
    linear = SSMR(2, 2, 4, 1)
    solve_stages(NeuralODEStart(network), known.dataset())
    solve_stages(SSMRLeastSquares(linear), known.dataset())
    window = 0.01 * torch.randn(6, 2, 4).double()
    network.state_scale.fill_(0.02)
    z, u = linear.encode(window), torch.randn(6, 2).double()
    torch.testing.assert_close(network.encode(window), z)
    torch.testing.assert_close(network.rate(z, u), linear.rate(z, u))
    torch.testing.assert_close(network.decode(z), linear.decode(z))


def test_a_fit_stops_when_nothing_better_comes(known, tmp_path):
    model = NeuralODE(2, 2, 4, 0, width=4)
    run(LeastSquaresFit(NeuralODEStart(model), 1e-8), known.dataset(), tmp_path)
    _, trainer = run(GradientFit(model, epochs=40, learning_rate=1e-300, patience=3, frozen=FROZEN), known.dataset(),
                     tmp_path)
    assert trainer.current_epoch == 4


def test_rollouts_grow_to_their_full_horizon_over_half_of_the_epochs():
    fit = GradientFit(SSMR(2, 1, 2), epochs=10, first_share=0.2)
    batch = RolloutBatch(torch.zeros(3, 2, 2), torch.zeros(3, 1, 1), torch.zeros(3, 50, 1), torch.zeros(3, 50, 2))
    lengths = []
    for epoch in range(10):
        fit.trainer = None
        fit.__dict__["_trainer"] = SimpleNamespace(current_epoch=epoch)
        lengths.append(fit._shortened(batch).inputs.shape[1])
    assert lengths[0] == 10 and lengths[5:] == [50] * 5 and lengths == sorted(lengths)


@pytest.mark.parametrize("options", [{"first_share": 0.0}, {"patience": 0}, {"minutes": -1.0}, {"weight_decay": -1.0}])
def test_impossible_settings_are_refused(options):
    with pytest.raises(ValueError, match="expected a share of at most 1 and positive numbers"):
        GradientFit(SSMR(2, 1, 2), **options)


def test_gradients_of_a_batch_with_a_diverging_rollout_are_finite(known):
    model = NeuralODE(2, 2, 4, 0)
    with torch.no_grad():
        model.chart.copy_(torch.from_numpy(known.V.T))
        model.parametrization.copy_(torch.from_numpy(known.V))
        model.linear.copy_(40.0 * torch.eye(2))
        model.state_scale.fill_(0.02)
    windows = 0.01 * torch.from_numpy(np.random.default_rng(0).normal(size=(4, 1, 4)))
    states = model.rollout(model.encode(windows), torch.zeros(4, 30, 2).double())
    model.decode(states.states).square().sum().backward()
    assert (states.diverged_at <= 30).all()
    assert all(p.grad is None or p.grad.isfinite().all() for p in model.parameters())
