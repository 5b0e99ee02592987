"""Gradient fit: minimizes the multi-step rollout error with Adam."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from ssmr_torch.checked_arguments import checked
from ssmr_torch.data.windows import RolloutBatch
from ssmr_torch.fitting.lightning_fit import ModelFit
from ssmr_torch.fitting.scaled_adam import ScaledAdam, table_scales
from ssmr_torch.models.torch_model import TorchModel
from ssmr_torch.quantities import DURATION, TEXT
from ssmr_torch.ranges import Each, Number, OrNone, Whole


class GradientFit(ModelFit):
    """Refines a fitted model by the multi-step rollout loss

        mean over starts and steps k of ‖ŷ_k - y_k‖² / σ_k²,

    with σ_k the error k steps ahead of the model before this fit, on the first batch, so that short and long horizons
    have the same weight. Over the first half of the fit, the rollouts grow from `first_share` of their horizon to the
    full horizon. Over the whole fit, the learning rate falls to zero along a cosine. The fit ends after `epochs`
    epochs, after `minutes` CPU minutes of this process (all its threads), or after `patience` validations in a row
    without an improvement, whichever comes first. The best epoch is kept.

    learning_rate: relative to the size of each coefficient's contribution, see `table_scales`. horizon: length of the
    rollouts, s; None: that of the data module. frozen: names of parameters that keep their values (by default the chart
    and the parametrization). weight_decay: Adam's L2 penalty on all trained coefficients, in units of their scales.
    gradient_clip: largest norm of the gradient in these units.
    Raises ValueError for settings out of range, and at its start for a model that was not fitted before.
    """

    selects, kept = True, ("_start_power", "_best", "_waited")

    @checked(epochs=Whole(1, 1_000_000), learning_rate=Number(1e-12, 10.0), frozen=Each(TEXT, 0, 1000),
             gradient_clip=Number(1e-12, 1e12), weight_decay=Number(0.0, 1e6), first_share=Number(1e-3, 1.0),
             patience=OrNone(Whole(1, 1_000_000)), minutes=OrNone(Number(1e-6, 1e6, "min")), horizon=OrNone(DURATION))
    def __init__(self, model: TorchModel, *, epochs: int = 20, learning_rate: float = 3e-4,
                 frozen: Sequence[str] = ("chart", "parametrization"), gradient_clip: float = 1.0,
                 weight_decay: float = 0.0, first_share: float = 1.0, patience: int | None = None,
                 minutes: float | None = None, horizon: float | None = None):
        super().__init__(model)
        if epochs < 1 or not learning_rate > 0:
            raise ValueError(f"epochs is {epochs} and learning_rate is {learning_rate}; both must be positive")
        limits = [limit for limit in (patience, minutes) if limit is not None]
        if not 0 < first_share <= 1 or weight_decay < 0 or any(limit <= 0 for limit in limits):
            raise ValueError(f"first_share {first_share}, weight_decay {weight_decay}, patience {patience} and minutes "
                             f"{minutes}; expected positive numbers, first_share ≤ 1 and weight_decay ≥ 0")
        known = dict(model.named_parameters())
        unknown = [name for name in frozen if name not in known]
        if unknown:
            raise ValueError(f"frozen names {unknown}, but the model's parameters are {sorted(known)}")
        self.epochs, self.learning_rate, self.gradient_clip = int(epochs), float(learning_rate), gradient_clip
        self.weight_decay, self.first_share = float(weight_decay), float(first_share)
        self.patience, self.minutes = patience, minutes
        if horizon is not None:
            self.horizon = float(horizon)
        self._best, self._waited = float("inf"), 0
        self._start_power: Tensor | None = None
        for name, parameter in known.items():
            parameter.requires_grad_(name not in frozen)

    def configure_optimizers(self):
        trained = {name: p for name, p in self.model.named_parameters() if p.requires_grad}
        scales = table_scales(self.model)
        optimizer = ScaledAdam([{"params": [p], "scale": scales.get(name)} for name, p in trained.items()],
                               lr=self.learning_rate, weight_decay=self.weight_decay)
        schedule = torch.optim.lr_scheduler.LambdaLR(
            optimizer, lambda epoch: 0.5 * (1 + math.cos(math.pi * self._progress(epoch))))
        return {"optimizer": optimizer, "lr_scheduler": {"scheduler": schedule, "interval": "epoch"}}

    def begin(self) -> None:
        if self.model.state_scale.isinf().any():
            raise ValueError("this model was not fitted yet, so the range of its training states is not known; run its "
                             "closed-form fit before the gradient fit, as fit=rollout and fit=neural_ode do")

    def on_train_start(self) -> None:
        for scheduled in self.trainer.lr_scheduler_configs:
            # Lightning keeps an epoch before it moves the schedule on
            while scheduled.scheduler.last_epoch < self.current_epoch:
                scheduled.scheduler.step()

    def training_step(self, batch: RolloutBatch, index: int) -> Tensor:
        if self._start_power is None:
            with torch.no_grad():
                self._start_power = self._squares(batch)[0].mean(0).clamp_min(1e-300)
        squares, diverged = self._squares(self._shortened(batch))
        loss = (squares.mean(0) / self._start_power[:squares.shape[-1]].to(squares)).mean()
        self.log("train/loss", loss, prog_bar=True, batch_size=len(squares))
        self.log("train/diverged", diverged.double().mean(), batch_size=len(squares))
        return loss

    def _squares(self, batch: RolloutBatch) -> tuple[Tensor, Tensor]:
        """‖ŷ_k - y_k‖² (N, H), m², and whether each rollout diverged (N,)."""
        rollout = self.model.rollout(self.model.encode(batch.window, batch.window_inputs), batch.inputs)
        squares = (self.model.decode(rollout.states[..., 1:, :]) - batch.outputs).square().sum(-1)
        return squares, rollout.diverged_at <= batch.inputs.shape[-2]

    def _progress(self, epoch: int) -> float:
        """Share of the fit that is done: of its epochs or of its minutes, whichever is larger."""
        share = epoch / self.epochs
        if self.minutes is not None:
            share = max(share, self.spent / (60 * self.minutes))
        return min(share, 1.0)

    def _shortened(self, batch: RolloutBatch) -> RolloutBatch:
        share = min(1.0, self.first_share + (1 - self.first_share) * 2 * self._progress(self.current_epoch))
        steps = max(round(share * batch.inputs.shape[1]), 1)
        return RolloutBatch(batch.window, batch.window_inputs, batch.inputs[:, :steps], batch.outputs[:, :steps])

    def on_train_batch_end(self, outputs, batch: RolloutBatch, index: int) -> None:
        late = self.minutes is not None and self.spent > 60 * self.minutes
        self._stop_where(late)

    def on_validation_epoch_end(self) -> None:
        """Stop after `patience` epochs without an improvement."""
        found = self.trainer.callback_metrics.get("validation/rmse")
        if found is None or self.trainer.state.fn != "fit":
            return
        self._waited = 0 if float(found) < self._best else self._waited + 1
        self._best = min(self._best, float(found))
        self._stop_where(self.patience is not None and self._waited >= self.patience)

    def _stop_where(self, reached: bool) -> None:
        """Stop all processes together. Otherwise one would wait for another forever."""
        if self.trainer.strategy.reduce_boolean_decision(reached, all=False):
            self.trainer.should_stop = True

    def configure_gradient_clipping(self, optimizer, gradient_clip_val=None, gradient_clip_algorithm=None) -> None:
        """Clip the gradient with respect to the scaled coefficients, because their sizes are comparable."""
        optimizer = getattr(optimizer, "optimizer", optimizer)
        optimizer.clip(self.gradient_clip)
