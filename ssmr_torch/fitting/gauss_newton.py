"""Refinement of polynomial models by Gauss-Newton steps on the multi-step rollout error, under a stability guard."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from ssmr_torch.checked_arguments import checked
from ssmr_torch.data.windows import RolloutBatch
from ssmr_torch.fitting.lightning_fit import ModelFit
from ssmr_torch.fitting.rollout_sensitivities import coefficients, rollout_sensitivities
from ssmr_torch.fitting.stability import StabilityGuard
from ssmr_torch.models.batch_rollout import batch_of
from ssmr_torch.models.torch_model import TorchModel
from ssmr_torch.quantities import DURATION, GUARD, TEXT
from ssmr_torch.ranges import Each, Number, Whole

LARGEST = 6000           # coefficients; the normal matrix of so many takes 0.3 GB
SMALLEST_DAMPING, LARGEST_DAMPING = 1e-6, 1e4
ROWS = 1 << 22           # numbers in a block of J
COLUMNS = 256            # columns in a block of H
FARTHEST = 100.0         # in units of σ_k: samples with a larger error do not count
LOST = 0.1               # share of diverging training rollouts above which the model is repaired before the refinement


class LevenbergMarquardt(torch.optim.Optimizer):
    """θ ← θ + d,  (H + λ diag H) d = g,  H = Σ JᵀJ,  g = Σ Jᵀr [Marquardt 1963].

    tables: views of the coefficients that are changed; their entries, one table after the other, are the columns of J.
    products: precision of the products JᵀJ. Single precision is twice as fast; g stays in double precision, so the
    minimum does not move. project: called after each trial step, before its cost is computed; it moves the tables back
    into the allowed set.
    λ is divided by 5 after a step that lowers the cost. Otherwise it is multiplied by 6 until a step lowers the cost;
    beyond `LARGEST_DAMPING` the tables stay unchanged.
    `cost` and `gain`, the relative decrease of the cost (0 if nothing was changed), belong to the last step.
    """

    def __init__(self, parameters: Iterable[Tensor], tables: Sequence[Tensor], damping: float,
                 project: Callable[[], object] = lambda: None, products: torch.dtype = torch.float64):
        super().__init__(parameters, {})
        self.tables, self.damping = list(tables), float(damping)
        self.project, self.products = project, products
        self.cost, self.gain = float("inf"), 0.0
        size = sum(table.numel() for table in tables)
        self._normal = tables[0].new_zeros(size, size)
        self._gradient = tables[0].new_zeros(size)

    def accumulate(self, jacobian: Tensor, residuals: Tensor) -> None:
        """Add rows: J (N, P) of the predictions, r (N,) = measured - predicted, both weighted."""
        self._gradient.addmv_(jacobian.T, residuals)
        rows = jacobian.to(self.products)
        # H is symmetric, and its factorization reads only the diagonal and what is above it
        for first in range(0, rows.shape[1], COLUMNS):
            block = slice(first, first + COLUMNS)
            self._normal[block, first:] += rows[:, block].T @ rows[:, first:]

    @torch.no_grad()
    def step(self, closure: Callable[[], float]) -> float:
        """Take the step with the least damping that lowers the cost. closure: returns the cost of the present tables.
        """
        start = torch.cat([table.flatten() for table in self.tables])
        before = self.cost = closure()
        scale = self._normal.diagonal().clamp_min(1e-12 * self._normal.diagonal().max().clamp_min(1e-300)).sqrt()
        normal, gradient = self._normal / scale / scale[:, None], self._gradient / scale
        diagonal = normal.diagonal().clone()
        while self.damping <= LARGEST_DAMPING:
            normal.diagonal().copy_(diagonal + self.damping)
            factor, failed = torch.linalg.cholesky_ex(normal, upper=True)
            if not failed:
                self._put(start + torch.cholesky_solve(gradient[:, None], factor, upper=True)[:, 0] / scale)
                self.project()
                self.cost = closure()
                if self.cost < before:
                    self.damping = max(self.damping / 5, SMALLEST_DAMPING)
                    break
            self.damping *= 6
        else:
            self._put(start)
            self.cost, self.damping = before, LARGEST_DAMPING
        self.gain = 1 - self.cost / before if before > 0 else 0.0
        self._normal.zero_()
        self._gradient.zero_()
        return self.cost

    def state_dict(self) -> dict:
        return super().state_dict() | {"damping": self.damping, "cost": self.cost, "gain": self.gain}

    def load_state_dict(self, state: dict) -> None:
        super().load_state_dict(state)
        self.damping, self.cost, self.gain = state["damping"], state["cost"], state["gain"]

    def _put(self, values: Tensor) -> None:
        for table, part in zip(self.tables, torch.split(values, [table.numel() for table in self.tables])):
            table.copy_(part.view_as(table))


class GaussNewtonFit(ModelFit):
    """Minimizes the mean over starts and samples k of min(‖ŷ_k - y_k‖² / σ_k², C²), by one damped step per epoch.

    σ_k is the error k steps ahead of the model before this fit, so that short and long horizons have the same weight.
    Errors larger than C = `FARTHEST` times σ_k have no gradient. Each epoch draws `starts` rollouts of `horizon` s from
    the training runs; residuals are taken at `samples` logarithmically spaced steps of each rollout.
    trained: some of "dynamics", "chart" (a learned oblique projection [Buurmeijer et al., Taming high-dimensional
    dynamics, 2025]) and "parametrization" (the rows of the newest sample).

    Stability is a penalty in the cost and not a hard limit, because a hard limit would end the fit at once if the first
    model is already at the limit. The same rollouts are repeated with their inputs multiplied by `overdrive`. They are
    penalized by how far they leave (1 + reach) / 2 times the range of the training outputs. The penalty grows by a
    factor of 4 after each epoch whose model fails its `StabilityGuard`. After every step, eigenvalues beyond the margin
    (1/s) are moved back onto it. The fit keeps the epoch with the fewest diverging training rollouts, and among these
    the one with the least validation error (validation/guarded is the sum of both). If more than the share `LOST` of
    the first model's rollouts diverge, the guard repairs the model before the fit. The fit ends after `epochs` steps,
    or when two steps in a row lower the cost by less than `tolerance`.
    Raises ValueError for models without coefficient tables or with more than 6,000 trained coefficients.
    """

    selects, monitor = True, "validation/guarded"
    kept = ("repairs", "_weights", "_room", "_last_gain", "_stress")

    @checked(epochs=Whole(0, 100_000), starts=Whole(1, 1_000_000), horizon=DURATION, samples=Whole(1, 10_000),
             trained=Each(TEXT, 1, 3), damping=Number(1e-12, 1e12), tolerance=Number(0.0, 1.0), **GUARD)
    def __init__(self, model: TorchModel, *, epochs: int = 15, starts: int = 400, horizon: float = 1.0,
                 samples: int = 10, trained: Sequence[str] = ("dynamics",), damping: float = 1e-2,
                 tolerance: float = 0.01, margin: float = 0.05, reach: float = 3.0, overdrive: float = 1.25):
        super().__init__(model)
        if epochs < 0 or starts < 1 or samples < 1 or not (horizon > 0 and damping > 0 and tolerance >= 0):
            raise ValueError(f"epochs {epochs}, starts {starts}, samples {samples}, horizon {horizon} s, damping "
                             f"{damping} and tolerance {tolerance}; all must be positive; only epochs may be 0, to "
                             "skip the fit")
        size = sum(table.numel() for table in coefficients(model, trained))
        if size > LARGEST:
            raise ValueError(f"{size} coefficients are to be trained, but a Gauss-Newton step can train at most "
                             f"{LARGEST}; lower the degrees or state_dim, or use fit=rollout")
        self.automatic_optimization = False
        self.epochs, self.starts, self.horizon, self.samples = int(epochs), int(starts), float(horizon), int(samples)
        self.trained, self.damping, self.tolerance = tuple(trained), float(damping), float(tolerance)
        self.settings = {"margin": float(margin), "reach": float(reach), "overdrive": float(overdrive)}
        self.repairs: dict[str, float] = {}
        self._batches: list[RolloutBatch] = []
        self._last_gain, self._stress = 1.0, 1.0
        self._weights: Tensor | None = None
        self._room: Tensor | None = None

    def configure_optimizers(self) -> LevenbergMarquardt:
        return LevenbergMarquardt(self.model.parameters(), coefficients(self.model, self.trained), self.damping,
                                  project=lambda: self.guard.stabilize(self.model), products=torch.float32)

    @cached_property
    def guard(self) -> StabilityGuard:
        """The stability guard for the training runs of the trainer's data module."""
        module = self.trainer.datamodule
        return StabilityGuard(module.training, transient=module.transient, **self.settings)

    def begin(self) -> None:
        if self.trainer.world_size > 1:
            raise ValueError(f"{self.trainer.world_size} processes; a Gauss-Newton fit runs in one, use trainer=cpu or "
                             "trainer=gpu")
        moved = self.guard.stabilize(self.model)
        self.repairs = {"eigenvalues moved": float(moved)} if moved else {}
        if self.guard.diverging(self.model) > LOST:
            self.repairs |= self.guard.enforce(self.model)

    @torch.no_grad()
    def training_step(self, batch: RolloutBatch, index: int) -> None:
        """Accumulate the sensitivities of these rollouts; take the step after the last batch of the epoch."""
        optimizer = self.optimizers()
        if self._weights is None:
            self._weights = self._first_weights(batch)
            self._room = 0.5 * (1 + self.settings["reach"]) * batch.outputs.abs().amax((0, 1))
        self._accumulate(optimizer.optimizer, batch, stressed=False)
        strong = self._overdriven(batch)
        leaving = (self._errors(strong, stressed=True) > 0).any(1)
        if leaving.any():
            self._accumulate(optimizer.optimizer, _chosen(strong, leaving), stressed=True)
        self._batches.append(batch)
        if self.trainer.is_last_batch:
            optimizer.step(closure=self._cost)
            self._finish(optimizer.optimizer)

    @torch.no_grad()
    def on_validation_epoch_end(self) -> None:
        left = self.guard.diverging(self.model)
        self._stress *= 4.0 if left and not self.trainer.validating else 1.0
        if "validation/rmse" in self.trainer.callback_metrics:
            self.log("validation/guarded", self.trainer.callback_metrics["validation/rmse"] + left)

    def _accumulate(self, optimizer: LevenbergMarquardt, batch: RolloutBatch, stressed: bool) -> None:
        size = sum(table.numel() for table in coefficients(self.model, self.trained))
        starts = max(ROWS // (size * self.model.output_dim * len(self._steps(batch))), 1)
        for block in torch.arange(len(batch.inputs), device=batch.inputs.device).split(starts):
            optimizer.accumulate(*self._rows(_chosen(batch, block), stressed))

    def _rows(self, batch: RolloutBatch, stressed: bool) -> tuple[Tensor, Tensor]:
        """Weighted J and r of these rollouts, without the rows of samples whose error is too large."""
        jacobians, residuals, steps = [], [], self._steps(batch)
        for found, weight in zip(rollout_sensitivities(self.model, batch, steps, self.trained), self._weights):
            residual = weight * (self._target(batch, found.outputs, found.step - 1, stressed) - found.outputs)
            near = torch.linalg.vector_norm(residual, dim=-1) < FARTHEST
            near &= torch.isfinite(found.jacobian.sum((-1, -2)))
            jacobians.append((weight * found.jacobian[near]).flatten(0, 1))
            residuals.append(residual[near].flatten())
        jacobian, residual = torch.cat(jacobians), torch.cat(residuals)
        if not stressed:
            return jacobian, residual
        left = residual != 0  # inside the permitted range the residual is 0
        return self._stress ** 0.5 * jacobian[left], self._stress ** 0.5 * residual[left]

    def _target(self, batch: RolloutBatch, outputs: Tensor, samples, stressed: bool) -> Tensor:
        return outputs.clamp(-self._room, self._room) if stressed else batch.outputs[:, samples]

    def _finish(self, optimizer: LevenbergMarquardt) -> None:
        self._batches.clear()
        self.log_dict({"train/cost": optimizer.cost, "train/damping": optimizer.damping}, prog_bar=True, batch_size=1)
        self.trainer.should_stop = max(optimizer.gain, self._last_gain) < self.tolerance
        self._last_gain = optimizer.gain

    def _steps(self, batch: RolloutBatch) -> list[int]:
        """Logarithmically spaced steps from the first to the last of the rollout."""
        return sorted({int(round(step)) for step in np.geomspace(1, batch.inputs.shape[1], self.samples)})

    def _overdriven(self, batch: RolloutBatch) -> RolloutBatch:
        return replace(batch, inputs=self.settings["overdrive"] * batch.inputs)

    def _errors(self, batch: RolloutBatch, stressed: bool = False) -> Tensor:
        """Squared distances (N, steps), m², from the measurements; of stressed rollouts, from the permitted range."""
        reduced, there = batch_of(self.model), self._steps(batch)
        window, held, inputs = (part.numpy(force=True) for part in (batch.window, batch.window_inputs, batch.inputs))
        states = reduced.rollout(reduced.model.encode(window, held), inputs).states
        outputs = torch.from_numpy(reduced.model.decode(states[:, there])).to(batch.outputs.device)
        there = torch.as_tensor(there, device=outputs.device)
        return (outputs - self._target(batch, outputs, there - 1, stressed)).square().sum(-1)

    def _first_weights(self, batch: RolloutBatch) -> Tensor:
        """1 / σ_k. σ_k is at most the size of the outputs, for rollouts that diverge, and has a lower bound, so that an
        exact prediction does not get an infinite weight.
        """
        size = batch.outputs.square().sum(-1).mean()
        errors = self._errors(batch).nan_to_num(torch.inf).clamp_max(size).mean(0)
        return 1 / torch.maximum(errors, 1e-8 * size).sqrt()

    @torch.no_grad()
    def _cost(self) -> float:
        """Mean over the epoch's starts and samples."""
        def capped(errors: Tensor) -> float:
            return float((errors * self._weights.square()).nan_to_num(torch.inf).clamp_max(FARTHEST ** 2).mean())
        return sum(capped(self._errors(batch)) + self._stress * capped(self._errors(self._overdriven(batch), True))
                   for batch in self._batches) / len(self._batches)


def _chosen(batch: RolloutBatch, which: Tensor) -> RolloutBatch:
    return RolloutBatch(*(getattr(batch, name)[which] for name in batch.__dataclass_fields__))
