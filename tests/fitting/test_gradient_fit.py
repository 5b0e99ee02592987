"""Gradient fits: neural ODEs from their linear start, early stopping, growing rollouts."""

from functools import partial
from time import process_time
from types import SimpleNamespace

import lightning
import numpy as np
import pytest
import torch

from ssmr_torch.data.datamodule import TrajectoryDataModule
from ssmr_torch.data.windows import RolloutBatch
from ssmr_torch.fitting.gradient_fit import GradientFit
from ssmr_torch.fitting.lightning_fit import LeastSquaresFit
from ssmr_torch.fitting.neural_ode_start import NeuralODEStart
from ssmr_torch.fitting.ssmr_least_squares import SSMRLeastSquares
from ssmr_torch.fitting.training import neural_ode_start, train
from ssmr_torch.models.integrators import rk4_step
from ssmr_torch.models.neural_ode import NeuralODE
from ssmr_torch.models.ssmr import SSMR, SSSR
from ssmr_torch.trajectory import Trajectory, TrajectoryDataset

FROZEN = ("chart", "parametrization", "linear", "control")
pytestmark = [pytest.mark.filterwarnings("ignore:.*does not have many workers"),
              pytest.mark.filterwarnings("ignore:.*smaller than the logging interval")]


def run(fit, dataset, tmp_path):
    module = TrajectoryDataModule(dataset, transient=0.0, validation_share=0.2, validation_horizon=0.3,
                                  rollout_horizon=0.3, stride=3, starts=50).prepare(fit)
    trainer = lightning.Trainer(max_epochs=fit.epochs, accelerator="cpu", logger=False, enable_progress_bar=False,
                                enable_checkpointing=False, enable_model_summary=False, num_sanity_val_steps=0,
                                default_root_dir=tmp_path)
    trainer.fit(fit, module)
    return trainer.validate(fit, module, verbose=False)[0]["validation/rmse"], trainer


def test_the_start_of_a_neural_ode_is_sssr(known, solve_stages):
    network = NeuralODE(2, 2, 4, 1)
    linear = SSSR(2, 2, 4, 1)
    solve_stages(NeuralODEStart(network), known.dataset())
    solve_stages(SSMRLeastSquares(linear), known.dataset())
    window = 0.01 * torch.randn(6, 2, 4).double()
    network.state_scale.fill_(0.02)
    z, u = linear.encode(window), torch.randn(6, 2).double()
    torch.testing.assert_close(network.encode(window), z)
    torch.testing.assert_close(network.reduced.rate(z, u), linear.reduced.rate(z, u))
    torch.testing.assert_close(network.decode(z), linear.decode(z))


class Spring:
    """A hardening spring: ẋ = 10 w, ẇ = -6.4 x - 1e5 x³ - 0.8 w + 0.1 u; x and w, in m, are seen."""

    A, B = np.array([[0.0, 10.0], [-6.4, -0.8]]), np.array([0.0, 0.1])

    def drift(self, z):
        return z @ self.A.T + np.stack([0 * z[..., 0], -5e4 * z[..., 0] ** 3], axis=-1)

    def dataset(self):
        rng, runs = np.random.default_rng(2), []
        angle = rng.uniform(0, 2 * np.pi, 10)
        starts = 0.01 * np.stack([np.cos(angle), 0.8 * np.sin(angle)], axis=1)
        for number, start in enumerate((*starts, np.zeros(2), np.zeros(2))):
            decay = number < len(starts)
            levels = np.zeros(20) if decay else rng.uniform(-0.2, 0.2, 20)
            inputs, z = np.repeat(levels, 10)[:, None], [start]
            for u in inputs[:-1]:
                z.append(rk4_step(lambda x: self.drift(x) + self.B * u, z[-1], 0.01, 10))
            runs.append(Trajectory(0.01 * np.arange(200), np.stack(z), inputs, "decay" if decay else "controlled"))
        return TrajectoryDataset(runs, np.zeros(2), ("x", "v"), ("u",))

    @torch.no_grad()
    def error(self, model):
        """Relative error of the spring's force, w's rate where w = 0, over the range of the data."""
        y = np.stack([np.linspace(-0.008, 0.008, 41), np.zeros(41)], axis=1)
        z = model.encode(torch.from_numpy(y)[:, None, :])
        found = model.reduced.rate(z, z[:, :1] * 0) @ model.parametrization.T
        return np.linalg.norm(found.numpy()[:, 1] - self.drift(y)[:, 1]) / np.linalg.norm(self.drift(y)[:, 1])


@pytest.mark.slow
def test_it_recovers_the_force_of_a_spring_that_a_linear_model_cannot(tmp_path):
    torch.manual_seed(0)
    spring = Spring()
    model, dataset = NeuralODE(2, 1, 2, 0, width=16, depth=1), spring.dataset()
    before, _ = run(LeastSquaresFit(NeuralODEStart(model), 1e-8), dataset, tmp_path)
    assert spring.error(model) > 0.1
    after, _ = run(GradientFit(model, epochs=25, learning_rate=2e-2, horizon=0.05, frozen=()), dataset, tmp_path)
    assert spring.error(model) < 0.04 and after < 0.25 * before


def started(**options):
    """A small network near a linear oscillation, with a fit around it and a batch of rollouts."""
    torch.manual_seed(4)
    model = NeuralODE(2, 1, 2, 0, width=6, depth=2)
    with torch.no_grad():
        model.chart.copy_(torch.eye(2))
        model.parametrization.copy_(torch.eye(2))
        model.linear.copy_(torch.tensor([[-1.0, 9.0], [-9.0, -1.0]]))
        model.control.normal_()
        model.last.normal_()
        model.state_scale.copy_(torch.tensor([0.02, 0.03]))
    fit = GradientFit(model, frozen=(), **options)
    fit.log = lambda *_, **__: None
    return fit, RolloutBatch(0.01 * torch.randn(8, 1, 2).double(), torch.zeros(8, 0, 1).double(),
                             torch.rand(8, 20, 1).double(), 0.01 * torch.randn(8, 20, 2).double())


def test_the_gradient_of_the_rollout_loss_equals_central_differences():
    fit, batch = started()
    fit.training_step(batch, 0).backward()
    for name, parameter in fit.model.named_parameters():
        direction = torch.randn_like(parameter)
        values = []
        for sign in (1, -1):
            with torch.no_grad():
                parameter += 1e-6 * sign * direction
                values.append(float(fit.training_step(batch, 0)))
                parameter -= 1e-6 * sign * direction
        slope = float((parameter.grad * direction).sum())
        assert (values[0] - values[1]) / 2e-6 == pytest.approx(slope, rel=1e-6, abs=1e-7), name


def test_the_loss_is_one_at_its_start_and_all_steps_ahead_have_the_same_weight():
    fit, batch = started()
    assert float(fit.training_step(batch, 0).detach()) == pytest.approx(1.0, rel=1e-12)
    with torch.no_grad():
        predicted = fit.model.decode(fit.model.rollout(fit.model.encode(batch.window), batch.inputs).states[:, 1:])
    for k in (0, 7, 19):
        outputs = predicted.clone()
        outputs[:, k] = batch.outputs[:, k]
        alone = RolloutBatch(batch.window, batch.window_inputs, batch.inputs, outputs)
        assert float(fit.training_step(alone, 0).detach()) == pytest.approx(1 / 20, rel=1e-9)


@pytest.mark.slow
def test_a_fit_stops_without_an_improvement(known, tmp_path):
    model = NeuralODE(2, 2, 4, 0, width=4)
    run(LeastSquaresFit(NeuralODEStart(model), 1e-8), known.dataset(), tmp_path)
    fit = GradientFit(model, epochs=40, patience=3, frozen=FROZEN)
    fit.learning_rate = 1e-300  # below the range, for no settings make a step that changes nothing
    _, trainer = run(fit, known.dataset(), tmp_path)
    assert trainer.current_epoch == 4


@pytest.mark.parametrize("validation_share", [0.0, 0.2])
def test_a_fit_stops_when_its_time_is_over_and_keeps_its_best_epoch(known, tmp_path, validation_share):
    fits = {"start": partial(neural_ode_start, ridge=1e-8),
            "training": partial(GradientFit, epochs=1000, learning_rate=1e-3, minutes=0.01, frozen=())}
    result = train(known.dataset(), model=partial(NeuralODE, state_dim=2, delays=0, width=4), fits=fits,
                   module=partial(TrajectoryDataModule, validation_share=validation_share, starts=20, stride=3,
                                  rollout_horizon=0.1, validation_horizon=0.1),
                   trainer=partial(lightning.Trainer, accelerator="cpu", enable_progress_bar=False,
                                   enable_model_summary=False), directory=tmp_path)
    assert result.cost["fit_time"] < 10 and np.isfinite(result.scores["test/rmse"])


def test_rollouts_grow_and_the_learning_rate_falls_with_the_share_of_the_fit_that_is_done(monkeypatch):
    fit, batch = started(epochs=10, first_share=0.2)
    rate = fit.configure_optimizers()["lr_scheduler"]["scheduler"].lr_lambdas[0]
    lengths, rates = [], [rate(epoch) for epoch in range(11)]
    for epoch in range(10):
        monkeypatch.setattr(GradientFit, "current_epoch", epoch)
        lengths.append(fit._shortened(batch).inputs.shape[1])
    assert lengths[0] == 4 and lengths[5:] == [20] * 5 and lengths == sorted(lengths)
    assert rates == sorted(rates, reverse=True) and rates[5] == pytest.approx(0.5) and rates[10] == 0.0
    fit.minutes, fit._begun = 1.0, process_time() - 45.0  # three quarters of the time for no epoch at all
    monkeypatch.setattr(GradientFit, "current_epoch", 0)
    assert fit._shortened(batch).inputs.shape[1] == 20 and rate(0) == pytest.approx(0.146, abs=1e-3)


def test_a_model_that_was_not_fitted_is_refused(known, tmp_path):
    with pytest.raises(ValueError, match="was not fitted yet, .* run its closed-form fit before"):
        run(GradientFit(NeuralODE(2, 2, 4, 0), frozen=()), known.dataset(), tmp_path)


def test_a_fit_trains_what_an_earlier_one_froze():
    model = NeuralODE(2, 1, 2, 0)
    GradientFit(model, frozen=FROZEN)
    assert [name for name, p in model.named_parameters() if not p.requires_grad] == list(FROZEN)
    GradientFit(model, frozen=("chart",))
    assert [name for name, p in model.named_parameters() if not p.requires_grad] == ["chart"]


def test_the_state_of_a_fit_is_stored_in_its_checkpoint():
    (fit, batch), (again, _) = started(), started()
    fit.training_step(batch, 0)
    fit._best, fit._waited, fit._trainer = 0.25, 3, SimpleNamespace(should_stop=False, current_epoch=0)
    checkpoint = {}
    fit.on_save_checkpoint(checkpoint)
    again.on_load_checkpoint(checkpoint)
    assert (again._best, again._waited) == (0.25, 3)
    torch.testing.assert_close(again._start_power, fit._start_power, rtol=0, atol=0)


@pytest.mark.parametrize("options", [{"first_share": 0.0}, {"patience": 0}, {"minutes": -1.0}, {"weight_decay": -1.0}])
def test_impossible_settings_are_refused(options):
    with pytest.raises(ValueError, match=f"{next(iter(options))} is .*; expected"):
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
