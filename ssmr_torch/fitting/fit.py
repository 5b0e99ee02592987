"""Training through Lightning: one score for every model, closed-form fits as stages, gradient fits on rollouts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import lightning
import torch
from torch import Tensor, distributed
from torch.utils.data import DistributedSampler

from ssmr_torch.data.windows import RolloutBatch, Segment, delay_windows
from ssmr_torch.fitting.exact import ExactSolve
from ssmr_torch.fitting.ssmr_least_squares import LeastSquaresModel
from ssmr_torch.fitting.statistics import PENALTIES
from ssmr_torch.models.base import ReducedModel

SHORTER = {"50ms": 0.05, "200ms": 0.2}


def rollout_errors(model: ReducedModel, batch: RolloutBatch) -> Tensor:
    """Root mean square errors over the first 1, …, H steps, √(mean_{k≤h} ‖ŷ_k - y_k‖²), of each start, (N, H) m.

    Infinite from the step on at which a rollout diverged.
    """
    rollout = model.rollout(model.encode(batch.window, batch.window_inputs), batch.inputs)
    errors = running_rmse(model.decode(rollout.states[..., 1:, :]) - batch.outputs)
    step = torch.arange(1, errors.shape[-1] + 1, device=errors.device)
    return torch.where(step >= rollout.diverged_at[..., None], torch.inf, errors)


def hurried(inputs: Tensor, factor: int) -> Tensor:
    """Inputs (N, H, m) played `factor` times as fast, forwards, backwards, … until H steps are full."""
    fast = inputs[:, ::factor]
    return torch.cat([fast.flip(1) if piece % 2 else fast for piece in range(factor)], dim=1)[:, :inputs.shape[1]]


def running_rmse(difference: Tensor) -> Tensor:
    """√(mean_{k≤h} ‖e_k‖²) for h = 1 … H, (..., H, p) → (..., H)."""
    squares = difference.square().sum(-1)
    count = torch.arange(1, squares.shape[-1] + 1, device=squares.device)
    return (squares.cumsum(-1) / count).sqrt()


def description(model: ReducedModel) -> dict:
    """Class path and constructor arguments, plain values that rebuild the model."""
    kind = type(model)
    return {"class": f"{kind.__module__}.{kind.__qualname__}", "arguments": model.arguments}


class ModelFit(lightning.LightningModule):
    """Holds a model while it is fitted; the validation and test scores are the same for every model.

    card: plain values that travel with the checkpoint (names, units, rest, bounds of the data).
    validation/rmse, test/rmse: mean over seeded starts of the open-loop error over the horizon, m (infinite when a
    start diverges, which …/diverged counts); …/rmse_median: their median; …/rmse_50ms and …/rmse_200ms: the mean over
    the first part of the same rollouts; …/relative: geometric mean over these horizons of the error divided by that of
    persistence, ŷ_k = y_0, in which short and long horizons count alike.
    overdrive, overspeed: where one is not 1, the validation rollouts are repeated with inputs `overdrive` times as
    strong, and with these played `overspeed` times as fast; the larger share that diverges is validation/overdriven,
    and validation/relative is infinite where any does. What was measured says nothing of what lies beyond it, but
    that a robot stays finite there is known.
    selects: whether the fit keeps its best epoch by its `monitor`, a score of the validation, and is undone where none
    is better than its start; otherwise its last epoch is kept.
    """

    selects, monitor = False, "validation/rmse"
    overdrive, overspeed = 1.0, 1

    def __init__(self, model: ReducedModel):
        super().__init__()
        self.model = model
        self.card: dict = {}

    def on_fit_start(self) -> None:
        self.double()

    def on_save_checkpoint(self, checkpoint: dict) -> None:
        checkpoint["model"] = description(self.model)
        checkpoint["card"] = self.card

    def validation_step(self, batch: RolloutBatch, index: int) -> None:
        self._score(batch, "validation")

    def test_step(self, batch: RolloutBatch, index: int) -> None:
        self._score(batch, "test")

    def _score(self, batch: RolloutBatch, split: str) -> None:
        running = rollout_errors(self.model, batch)
        still = running_rmse(batch.window[..., -1:, :] - batch.outputs)
        errors, horizon = running[..., -1], running.shape[-1]
        values = {"rmse": errors.mean(), "rmse_median": errors.median(), "diverged": errors.isinf().double().mean()}
        ratios = [errors.mean() / still[..., -1].mean()]
        for label, seconds in SHORTER.items():
            steps = max(round(seconds / self.model.timestep), 1)
            if steps < horizon:
                values[f"rmse_{label}"] = running[..., steps - 1].mean()
                ratios.append(values[f"rmse_{label}"] / still[..., steps - 1].mean())
        values["relative"] = torch.stack(ratios).log().mean().exp()
        if split == "validation" and (self.overdrive, self.overspeed) != (1.0, 1):
            values["overdriven"] = max(self._diverged(batch, speed) for speed in {1, self.overspeed})
            values["relative"] = torch.where(values["overdriven"] > 0, torch.inf, values["relative"])
        self.log_dict({f"{split}/{name}": value for name, value in values.items()}, batch_size=len(errors),
                      prog_bar=split == "validation")

    def _diverged(self, batch: RolloutBatch, speed: int) -> Tensor:
        stressed = replace(batch, inputs=self.overdrive * hurried(batch.inputs, speed))
        return rollout_errors(self.model, stressed)[..., -1].isinf().double().mean()


class LeastSquaresFit(ModelFit):
    """Fits a model in closed form: one epoch per stage, each solved at its last batch.

    The solve is the step of the optimizer `ExactSolve`, so that checkpoints, loggers and the validation after the
    epoch all see the solved parameters. ridge, penalty: see `ExactSolve`. folds: cross-validation parts, by trajectory
    and, within long ones, by contiguous stretches.
    `solutions` keeps what the fit found, for its report.
    """

    def __init__(self, procedure: LeastSquaresModel, ridge: float | Sequence | dict = 0.0, folds: int = 5,
                 penalty: str = "ridge"):
        super().__init__(procedure.model)
        if folds < 2:
            raise ValueError(f"folds is {folds}; cross-validation needs at least 2")
        unknown = set(ridge) - {"default", *procedure.names} if isinstance(ridge, Mapping) else set()
        if unknown:
            raise ValueError(f"ridge names {sorted(unknown)}; the regressions are {sorted(procedure.names)}")
        if penalty not in PENALTIES:
            raise ValueError(f"penalty is {penalty!r}; expected one of {sorted(PENALTIES)}")
        self.procedure, self.ridge, self.folds, self.penalty = procedure, ridge, int(folds), penalty
        self.automatic_optimization = False
        self.solutions: dict[str, dict] = {}

    @property
    def epochs(self) -> int:
        """Passes over the data that the fit takes."""
        return len(self.procedure.stages)

    def configure_optimizers(self) -> ExactSolve:
        return ExactSolve(self.model.parameters(), self.ridge, self.penalty)

    def on_train_start(self) -> None:
        if isinstance(getattr(self.trainer.train_dataloader, "sampler", None), DistributedSampler):
            raise ValueError("the trainer would repeat segments to even out the processes, and count them twice; "
                             "set trainer.use_distributed_sampler=false (the data module shares them out)")
        # DDP waits for a backward pass that a closed-form fit never makes
        self.trainer.strategy.model.require_backward_grad_sync = False

    @property
    def stage(self) -> str:
        return self.procedure.stages[min(self.current_epoch, self.epochs - 1)]

    @torch.no_grad()
    def training_step(self, segment: Segment, index: int) -> None:
        solver = self.optimizers()
        fold = (segment.trajectory + segment.index) % self.folds
        for name, rows in self.procedure.regressions(segment, self.stage).items():
            solver.optimizer.accumulate(name, rows.features, rows.targets, fold)
        if self.stage == self.procedure.stages[-1]:
            self._observe_scale(segment)
        if self.trainer.is_last_batch:
            solver.step()
            found = solver.optimizer.solutions
            self.procedure.assign(self.stage, found)
            self._record(found)

    def _observe_scale(self, segment: Segment) -> None:
        if segment.kind == "static":
            return
        windows, inputs = self._windows(segment)
        largest = self.model.encode(windows, inputs).abs().amax(0)
        scale = self.model.state_scale
        scale.copy_(torch.where(scale.isinf(), largest, torch.maximum(scale, largest)))
        if self.trainer.is_last_batch and distributed.is_available() and distributed.is_initialized():
            distributed.all_reduce(scale, op=distributed.ReduceOp.MAX)

    def _windows(self, segment: Segment) -> tuple[Tensor, Tensor]:
        if hasattr(self.procedure, "windows"):
            return self.procedure.windows(segment)
        windows = delay_windows(segment.observation, self.model.delays)
        if self.model.delays:
            return windows, delay_windows(segment.input[:-1], self.model.delays - 1)
        return windows, windows.new_zeros(len(windows), 0, self.model.input_dim)

    def _record(self, solutions: dict) -> None:
        for name, solution in solutions.items():
            if len(solution.coefficients) == 0:
                continue
            self.solutions[name] = {
                "rows": solution.rows, "features": solution.coefficients.shape[1], "rank": solution.rank,
                "condition": solution.condition, "ridge": solution.ridge, "relative_residual": solution.residual,
                "cross_validation": {f"{ridge:g}": error for ridge, error in solution.validation.items()}}
            self.log(f"fit/{name}_residual", solution.residual)

    def on_save_checkpoint(self, checkpoint: dict) -> None:
        super().on_save_checkpoint(checkpoint)
        checkpoint["solutions"] = self.solutions

    def on_load_checkpoint(self, checkpoint: dict) -> None:
        self.solutions = checkpoint["solutions"]
