"""Gradient fits: the multi-step rollout loss, by Adam."""

from __future__ import annotations

from collections.abc import Sequence
from time import perf_counter

import torch
from torch import Tensor

from ssmr_torch.data.windows import RolloutBatch
from ssmr_torch.fitting.fit import ModelFit
from ssmr_torch.fitting.scaled_adam import ScaledAdam, table_scales
from ssmr_torch.models.base import ReducedModel


class GradientFit(ModelFit):
    """Refines a model by the multi-step rollout loss, mean_k ‖ŷ_k - y_k‖² / ‖y‖²_rms, from where it stands.

    The rollouts grow from `first_share` of their horizon to all of it over the first half of the epochs. The fit ends
    when `patience` validations in a row bring nothing better, or after `minutes`; the best epoch is kept.

    learning_rate: relative to the size of each coefficient's contribution, see `ScaledAdam`. frozen: names of
    parameters that keep their values (the chart and the parametrization's geometry by default).
    """

    selects = True

    def __init__(self, model: ReducedModel, *, epochs: int = 20, learning_rate: float = 3e-4,
                 frozen: Sequence[str] = ("chart", "parametrization"), gradient_clip: float = 1.0,
                 weight_decay: float = 0.0, first_share: float = 1.0, patience: int | None = None,
                 minutes: float | None = None, horizon: float | None = None):
        super().__init__(model)
        if epochs < 1 or not learning_rate > 0:
            raise ValueError(f"epochs {epochs} and learning_rate {learning_rate}; both must be positive")
        limits = [limit for limit in (patience, minutes) if limit is not None]
        if not 0 < first_share <= 1 or weight_decay < 0 or any(limit <= 0 for limit in limits):
            raise ValueError(f"first_share {first_share}, weight_decay {weight_decay}, patience {patience} and minutes "
                             f"{minutes}; expected a share of at most 1 and positive numbers")
        known = dict(model.named_parameters())
        unknown = [name for name in frozen if name not in known]
        if unknown:
            raise ValueError(f"frozen names {unknown}, but the model's parameters are {sorted(known)}")
        self.epochs, self.learning_rate, self.gradient_clip = int(epochs), float(learning_rate), gradient_clip
        self.weight_decay, self.first_share = float(weight_decay), float(first_share)
        self.patience, self.minutes, self._begun = patience, minutes, 0.0
        if horizon is not None:
            self.horizon = float(horizon)
        self._best, self._waited = float("inf"), 0
        for name in frozen:
            known[name].requires_grad_(False)
        self.register_buffer("output_power", torch.zeros((), dtype=torch.float64))

    def configure_optimizers(self):
        trained = {name: p for name, p in self.model.named_parameters() if p.requires_grad}
        scales = table_scales(self.model)
        optimizer = ScaledAdam([{"params": [p], "scale": scales.get(name)} for name, p in trained.items()],
                               lr=self.learning_rate, weight_decay=self.weight_decay)
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, self.epochs)
        return {"optimizer": optimizer, "lr_scheduler": {"scheduler": schedule, "interval": "epoch"}}

    def training_step(self, batch: RolloutBatch, index: int) -> Tensor:
        if self.output_power == 0:
            self.output_power.copy_(batch.outputs.square().sum(-1).mean())
        batch = self._shortened(batch)
        rollout = self.model.rollout(self.model.encode(batch.window, batch.window_inputs), batch.inputs)
        error = (self.model.decode(rollout.states[..., 1:, :]) - batch.outputs).square().sum(-1).mean(-1)
        loss = error.mean() / self.output_power
        self.log("train/loss", loss, prog_bar=True, batch_size=len(error))
        self.log("train/diverged", (rollout.diverged_at <= batch.inputs.shape[-2]).double().mean(),
                 batch_size=len(error))
        return loss

    def on_train_start(self) -> None:
        self._begun = perf_counter()

    def _shortened(self, batch: RolloutBatch) -> RolloutBatch:
        share = min(1.0, self.first_share + (1 - self.first_share) * 2 * self.current_epoch / self.epochs)
        steps = max(round(share * batch.inputs.shape[1]), 1)
        return RolloutBatch(batch.window, batch.window_inputs, batch.inputs[:, :steps], batch.outputs[:, :steps])

    def on_validation_epoch_end(self) -> None:
        """Stop when nothing better came for `patience` epochs, or the time is up."""
        found = self.trainer.callback_metrics.get("validation/rmse")
        if found is None or self.trainer.state.fn != "fit":
            return
        self._waited = 0 if float(found) < self._best else self._waited + 1
        self._best = min(self._best, float(found))
        late = self.minutes is not None and perf_counter() - self._begun > 60 * self.minutes
        self.trainer.should_stop = late or (self.patience is not None and self._waited >= self.patience)

    def configure_gradient_clipping(self, optimizer, gradient_clip_val=None, gradient_clip_algorithm=None) -> None:
        """Clip the gradient of the scaled coefficients, whose sizes are comparable."""
        optimizer = getattr(optimizer, "optimizer", optimizer)
        optimizer.clip(self.gradient_clip)
