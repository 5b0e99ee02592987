"""The score that all fits share: errors of rollouts, divergence, and inputs stronger than recorded."""

from functools import partial

import lightning
import numpy as np
import pytest
import torch

from ssmr_torch.data.windows import RolloutBatch
from ssmr_torch.fitting.fit import ModelFit, hurried, rollout_errors
from ssmr_torch.models.ssmr import SSMR

TRAINER = partial(lightning.Trainer, accelerator="cpu", devices=1, logger=False, enable_model_summary=False,
                  enable_progress_bar=False)

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning:lightning", "ignore:.*LeafSpec")


def constant_model(rate):
    """dz/dt = rate z seen as y = z."""
    model = SSMR(1, 1, 1, 0, control_degree=0, timestep=0.1, substeps=10)
    with torch.no_grad():
        model.chart[0, 0] = model.parametrization[0, 0] = 1.0
        model.drift_table[0, 0] = rate
        model.state_scale.fill_(1.0)
    return model


class Served(lightning.LightningDataModule):
    """One batch to validate on."""

    def __init__(self, batch):
        super().__init__()
        self.batch = batch

    def val_dataloader(self):
        return torch.utils.data.DataLoader([self.batch], batch_size=None)


def growing_under_inputs():
    """dz/dt = (u − 2) z, seen as it is."""
    model = SSMR(1, 1, 1, 0, control_degree=1, timestep=0.1, substeps=10)
    with torch.no_grad():
        model.chart[0, 0] = model.parametrization[0, 0] = 1.0
        model.drift_table[0, 0], model.control_table[0, 1] = -2.0, 1.0
        model.state_scale.fill_(1.0)
    return model


def still(count, horizon=10):
    """Measurements that stay at one."""
    ones = torch.ones(count, 1, 1, dtype=torch.float64)
    return RolloutBatch(ones, ones[:, :0], 0 * ones.repeat(1, horizon, 1), ones.repeat(1, horizon, 1))


def test_the_error_of_a_rollout_is_the_root_of_the_mean_square_over_the_horizon():
    expected = np.sqrt(np.mean((np.exp(-0.3 * 0.1 * np.arange(1, 11)) - 1) ** 2))
    np.testing.assert_allclose(rollout_errors(constant_model(-0.3), still(3))[:, -1].detach(), expected, rtol=1e-9)


def test_the_score_of_a_model_that_diverges_is_infinite_and_its_share_is_counted(tmp_path):
    class Still(lightning.LightningDataModule):
        def val_dataloader(self):
            return torch.utils.data.DataLoader([still(4)], batch_size=None)

    trainer = TRAINER(default_root_dir=tmp_path)
    for rate, rmse, diverged in ((5.0, np.inf, 1.0), (0.0, 0.0, 0.0)):
        (scores,) = trainer.validate(ModelFit(constant_model(rate)), Still(), verbose=False)
        assert scores["validation/rmse"] == scores["validation/rmse_median"] == rmse
        assert scores["validation/diverged"] == diverged
    # e^{0.5 k} passes the bound of 10 at k = 5
    assert rollout_errors(constant_model(5.0), still(1, horizon=4))[:, -1].isfinite().all()
    assert rollout_errors(constant_model(5.0), still(1, horizon=5))[:, -1].isinf().all()


def test_a_model_that_diverges_under_inputs_stronger_than_recorded_scores_infinite_where_that_is_asked(tmp_path):
    """dz/dt = (u − 2) z decays under the recorded u = 1.5 and grows beyond all bounds under twice that."""
    model = growing_under_inputs()
    batch = still(4, horizon=30)
    batch.inputs.fill_(1.5)
    batch.outputs.fill_(0.5)

    trainer, fit = TRAINER(default_root_dir=tmp_path), ModelFit(model)
    (plain,) = trainer.validate(fit, Served(batch), verbose=False)
    assert "validation/overdriven" not in plain and plain["validation/diverged"] == 0
    for factor, share, relative in ((1.3, 0.0, plain["validation/relative"]), (2.0, 1.0, np.inf)):
        fit.overdrive = factor
        (scores,) = trainer.validate(fit, Served(batch), verbose=False)
        assert scores["validation/overdriven"] == share and scores["validation/rmse"] == plain["validation/rmse"]
        assert scores["validation/relative"] == relative > 0


def test_inputs_played_faster_go_forwards_and_backwards_without_a_jump_and_fill_the_horizon():
    ramp = torch.arange(7.0).reshape(1, 7, 1)
    assert hurried(ramp, 1).flatten().tolist() == list(range(7))
    assert hurried(ramp, 2).flatten().tolist() == [0, 2, 4, 6, 6, 4, 2]
    assert hurried(ramp, 3).flatten().tolist() == [0, 3, 6, 6, 3, 0, 0]


def test_a_model_that_diverges_only_under_faster_inputs_scores_infinite_too(tmp_path):
    """dz/dt = (u − 2) z: 27 steps of decay under u = 0 come before 3 of growth under u = 25, but 9 before 2 where the
    inputs run three times as fast, and e^{0.1 (−2 · 9 + 23 · 2)} = 16 is beyond the bound of 10.
    """
    model = growing_under_inputs()
    batch = still(4, horizon=30)
    batch.inputs[:, -3:] = 25.0
    batch.outputs.fill_(0.5)
    trainer, fit = TRAINER(default_root_dir=tmp_path), ModelFit(model)
    for speed, share in ((1, 0.0), (3, 1.0)):
        fit.overdrive, fit.overspeed = 1.01, speed
        (scores,) = trainer.validate(fit, Served(batch), verbose=False)
        assert scores["validation/overdriven"] == share
        assert np.isinf(scores["validation/relative"]) == bool(share)
