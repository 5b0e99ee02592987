"""Scores of all fits: rollout errors, divergence, and inputs larger than recorded."""

from functools import partial

import lightning
import numpy as np
import pytest
import torch

from ssmr_torch.data.starts import ScoredRuns
from ssmr_torch.evaluation.open_loop import score_open_loop
from ssmr_torch.fitting.lightning_fit import ModelFit
from ssmr_torch.fitting.scores import hurried, scores
from ssmr_torch.models.control_augmented import ControlAugmentedSSMR
from ssmr_torch.models.koopman import Koopman
from ssmr_torch.models.predictors import persistence
from ssmr_torch.models.ssmr import SSMR
from ssmr_torch.trajectory import Trajectory

TRAINER = partial(lightning.Trainer, accelerator="cpu", devices=1, logger=False, enable_model_summary=False,
                  enable_progress_bar=False)

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning:lightning", "ignore:.*LeafSpec",
                                        "ignore:.*does not have many workers")


def constant_model(rate):
    """dz/dt = rate z seen as y = z."""
    model = SSMR(1, 1, 1, 0, control_degree=0, timestep=0.1, substeps=10)
    with torch.no_grad():
        model.chart[0, 0] = model.parametrization[0, 0] = 1.0
        model.drift_table[0, 0] = rate
        model.state_scale.fill_(1.0)
    return model


def growing_under_inputs(timestep=0.1):
    """dz/dt = (u − 2) z, seen as it is."""
    model = SSMR(1, 1, 1, 0, control_degree=1, timestep=timestep, substeps=10)
    with torch.no_grad():
        model.chart[0, 0] = model.parametrization[0, 0] = 1.0
        model.drift_table[0, 0], model.control_table[0, 1] = -2.0, 1.0
        model.state_scale.fill_(1.0)
    return model


def measured(levels, inputs=None, noise=0.0, timestep=0.1):
    """One run that is scored over all of it but its first sample, and from every start over less."""
    levels = np.asarray(levels, dtype=float)[:, None]
    inputs = np.zeros_like(levels) if inputs is None else np.asarray(inputs, dtype=float)[:, None]
    run, seen = (Trajectory(timestep * np.arange(len(levels)), values, inputs) for values in (levels, levels + noise))
    return ScoredRuns((run,), (seen,), timestep * (len(levels) - 2), 50, 0)


def still(horizon=10, level=1.0, **options):
    """Measurements that stay at one, or go from there to another level at the first step."""
    return measured([1.0, 1.0, *[level] * horizon], **options)


class Served(lightning.LightningDataModule):
    """What is validated and tested on."""

    def __init__(self, scored):
        super().__init__()
        self.scored = scored

    def val_dataloader(self):
        return torch.utils.data.DataLoader([self.scored], batch_size=None)

    test_dataloader = val_dataloader


def test_the_error_of_a_rollout_is_the_root_of_the_mean_square_over_the_horizon():
    expected = np.sqrt(np.mean((np.exp(-0.3 * 0.1 * np.arange(1, 11)) - 1) ** 2))
    assert scores(constant_model(-0.3), still())["rmse"] == pytest.approx(expected, rel=1e-9)


def test_the_score_of_a_model_that_diverges_is_infinite_and_its_share_is_counted(tmp_path):
    trainer = TRAINER(default_root_dir=tmp_path)
    for rate, rmse, diverged in ((5.0, np.inf, 1.0), (0.0, 0.0, 0.0)):
        (found,) = trainer.validate(ModelFit(constant_model(rate)), Served(still()), verbose=False)
        assert found["validation/rmse"] == found["validation/rmse_median"] == rmse
        assert found["validation/diverged"] == diverged
    # e^{0.5 k} passes the bound of 10 at k = 5
    assert np.isfinite(scores(constant_model(5.0), still(horizon=4))["rmse"])
    assert np.isinf(scores(constant_model(5.0), still(horizon=5))["rmse"])


def test_a_model_that_diverges_under_larger_inputs_scores_infinite_with_overdrive(tmp_path):
    """dz/dt = (u − 2) z decays under the recorded u = 1.5 and grows beyond all bounds under twice that."""
    scored = still(30, 0.5, inputs=np.full(32, 1.5))
    trainer, fit = TRAINER(default_root_dir=tmp_path), ModelFit(growing_under_inputs())
    (plain,) = trainer.validate(fit, Served(scored), verbose=False)
    assert "validation/overdriven" not in plain and plain["validation/diverged"] == 0
    assert np.isfinite(plain["validation/relative"])
    for factor, share, relative in ((1.3, 0.0, plain["validation/relative"]), (2.0, 1.0, np.inf)):
        fit.overdrive = factor
        (found,) = trainer.validate(fit, Served(scored), verbose=False)
        assert found["validation/overdriven"] == share and found["validation/rmse"] == plain["validation/rmse"]
        assert found["validation/relative"] == relative > 0
        assert "test/overdriven" not in trainer.test(fit, Served(scored), verbose=False)[0]


def test_inputs_played_faster_go_forwards_and_backwards_without_a_jump_and_fill_the_horizon():
    ramp = np.arange(7.0).reshape(1, 7, 1)
    assert hurried(ramp, 1).flatten().tolist() == list(range(7))
    assert hurried(ramp, 2).flatten().tolist() == [0, 2, 4, 6, 6, 4, 2]
    assert hurried(ramp, 3).flatten().tolist() == [0, 3, 6, 6, 3, 0, 0]


def test_a_model_that_diverges_only_under_faster_inputs_scores_infinite_too(tmp_path):
    """dz/dt = (u − 2) z: 27 steps of decay under u = 0 come before 3 of growth under u = 17, but 9 before 2 where the
    inputs run three times as fast, and e^{0.25 (−2 · 9 + 15 · 2)} = 20 is beyond the bound of 10.
    """
    inputs = np.zeros(32)
    inputs[-4:-1] = 17.0  # the last sample is held after the end
    scored = still(30, 0.5, inputs=inputs, timestep=0.25)
    trainer, fit = TRAINER(default_root_dir=tmp_path), ModelFit(growing_under_inputs(0.25))
    for speed, share in ((1, 0.0), (3, 1.0)):
        fit.overdrive, fit.overspeed = 1.01, speed
        (found,) = trainer.validate(fit, Served(scored), verbose=False)
        assert found["validation/overdriven"] == share
        assert np.isinf(found["validation/relative"]) == bool(share)


def filled(model):
    """The model with small random coefficients everywhere."""
    with torch.no_grad():
        for table in model.parameters():
            table.copy_(0.1 * torch.randn(table.shape, dtype=torch.float64))
        model.state_scale.fill_(1.0)
    return model


MODELS = {
    "SSMR": lambda: filled(SSMR(3, 2, 2, 2, dynamics_degree=2)),
    "DMD at twice the sampling time": lambda: filled(Koopman(2, 2, timestep=0.02)),
    "control-augmented": lambda: filled(ControlAugmentedSSMR(3, 2, 2, 2, dynamics_degree=2)),
}


@pytest.mark.parametrize("kind", MODELS)
def test_a_fit_is_scored_in_the_same_way_as_every_model(tmp_path, kind):
    rng, model = np.random.default_rng(1), MODELS[kind]()
    runs = tuple(Trajectory(0.01 * np.arange(length), np.cumsum(0.01 * rng.normal(size=(length, 2)), axis=0),
                            rng.normal(size=(length, 2))) for length in (400, 250, 90))
    served = Served(ScoredRuns(runs, runs, 1.0, 60, 5))
    (found,) = TRAINER(default_root_dir=tmp_path).test(ModelFit(model), served, verbose=False)
    expected = score_open_loop(model, runs, starts=60, seed=5)
    for name, label in (("rmse", "1 s"), ("rmse_200ms", "200 ms"), ("rmse_50ms", "50 ms")):
        assert found[f"test/{name}"] == pytest.approx(expected[label].mean, rel=1e-12)
    assert found["test/rmse_median"] == pytest.approx(expected["1 s"].median, rel=1e-12)
    assert found["test/diverged"] == expected["1 s"].diverged
    base = score_open_loop(persistence(model.timestep), runs, starts=60, seed=5, margin=expected.margin)
    ratios = [expected[label].mean / base[label].mean for label in ("50 ms", "200 ms", "1 s")]
    assert found["test/relative"] == pytest.approx(np.prod(ratios) ** (1 / 3), rel=1e-9)


def test_a_horizon_that_holds_no_step_of_the_model_has_no_score():
    found = scores(constant_model(-0.3), still())
    assert "rmse_50ms" not in found and found["rmse_200ms"] < found["rmse"]


def test_predictions_start_from_windows_with_noise_and_are_compared_with_what_was_measured():
    """A model that stays where it starts, off by the noise of its start."""
    noisy = measured(np.ones(12), noise=0.25)
    assert scores(constant_model(0.0), noisy)["rmse"] == pytest.approx(0.25, rel=1e-12)


def test_a_fit_is_scored_on_controlled_runs_and_separately_on_decays():
    """A model that stays is exact on the one controlled run and off by 1 on 74 decays, which would decide a mean."""
    def runs(kind, levels, count):
        return [Trajectory(0.1 * np.arange(len(levels)), levels[:, None], np.zeros((len(levels), 1)), kind)
                for _ in range(count)]

    rest, leap = np.ones(12), np.r_[1.0, 1.0, np.zeros(10)]
    together = (*runs("decay", leap, 74), *runs("controlled", rest, 1))
    found = scores(constant_model(0.0), ScoredRuns(together, together, 1.0, 50, 0))
    assert found["rmse"] == found["diverged"] == 0.0 == found["rmse_persistence"]
    assert found["rmse_decays"] == pytest.approx(1.0) and found["diverged_decays"] == 0.0
    alone = scores(constant_model(0.0), ScoredRuns(together[:-1], together[:-1], 1.0, 50, 0))
    assert alone["rmse"] == pytest.approx(1.0) == alone["rmse_persistence"] and "rmse_decays" not in alone
    short = (*runs("decay", leap, 2), *runs("controlled", rest[:5], 1))  # too short to be judged by
    assert scores(constant_model(0.0), ScoredRuns(short, short, 1.0, 50, 0))["rmse"] == pytest.approx(1.0)
