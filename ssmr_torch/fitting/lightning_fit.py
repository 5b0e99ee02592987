"""Base classes of all fits as Lightning modules: the same scores for every model, and closed-form fits in stages."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from time import process_time

import lightning
import numpy as np
import torch
from torch import Tensor, distributed
from torch.utils.data import DistributedSampler

from ssmr_torch.checked_arguments import checked
from ssmr_torch.data.starts import ScoredRuns
from ssmr_torch.data.windows import Segment, delay_windows
from ssmr_torch.fitting.closed_form_fit import ExactSolve
from ssmr_torch.fitting.scores import diverged_under_stress, scores
from ssmr_torch.fitting.ssmr_least_squares import LeastSquaresModel
from ssmr_torch.fitting.streamed_least_squares import PENALTIES, ridge_candidates
from ssmr_torch.models.torch_model import TorchModel
from ssmr_torch.quantities import RIDGE
from ssmr_torch.ranges import OneOf, Whole


def description(model: TorchModel) -> dict:
    """Class path and constructor arguments as plain values, from which the model can be rebuilt."""
    kind = type(model)
    return {"class": f"{kind.__module__}.{kind.__qualname__}", "arguments": model.arguments}


def plain(value):
    """A value as a checkpoint holds it: NumPy values and tuples are converted, tensors stay."""
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    if isinstance(value, Mapping):
        return {key: plain(each) for key, each in value.items()}
    return [plain(each) for each in value] if isinstance(value, (tuple, list)) else value


class ModelFit(lightning.LightningModule):
    """Holds a model while it is fitted. The validation and test scores are computed the same way for every model.

    card: plain values that are stored in the checkpoint (names, units, rest, bounds of the data).
    validation/…, test/…: see `scores`.
    overdrive, overspeed: if one of them is not 1, the validation rollouts are repeated with inputs `overdrive` times
    larger, and with inputs played `overspeed` times faster. validation/overdriven is the larger share of rollouts that
    diverge. If any diverges, validation/relative is infinite. The data contain no such inputs, but it is known that a
    real robot stays finite under them.
    selects: whether the fit keeps its best epoch by `monitor`, a validation score, and is undone if no epoch is better
    than its start. Otherwise the last epoch is kept.
    kept: names of the attributes, plain values and tensors, with which a fit that is resumed goes on as if it had not
    been interrupted. Parameters, the optimizer and the random numbers are kept as well.
    """

    selects, monitor = False, "validation/rmse"
    overdrive, overspeed = 1.0, 1
    kept: tuple[str, ...] = ()

    def __init__(self, model: TorchModel):
        super().__init__()
        self.model = model
        self.card: dict = {}
        self._random: Tensor | None = None  # state of the generator after the last epoch that was kept
        self._spent, self._begun = 0.0, None

    def begin(self) -> None:
        """What a fit does first, and not again where it is resumed."""

    def on_fit_start(self) -> None:
        self.double()
        self._begun = process_time()
        if self._random is None:
            self.begin()
        else:
            torch.set_rng_state(self._random)

    @property
    def spent(self) -> float:
        """CPU time of this fit so far, s, with that before it was interrupted."""
        return self._spent + (0.0 if self._begun is None else process_time() - self._begun)

    def pause(self) -> None:
        """The fit has ended: what follows is not its time."""
        self._spent, self._begun = self.spent, None

    def on_save_checkpoint(self, checkpoint: dict) -> None:
        checkpoint["model"] = description(self.model)
        checkpoint["card"] = self.card
        checkpoint["fit"] = {
            "kept": plain({name: getattr(self, name) for name in self.kept}), "random": torch.get_rng_state(),
            "spent": self.spent, "finished": self.trainer.should_stop or self.current_epoch + 1 >= self.epochs}

    def on_load_checkpoint(self, checkpoint: dict) -> None:
        found = checkpoint["fit"]
        for name, value in found["kept"].items():
            setattr(self, name, value)
        self._random, self._spent = found["random"], found["spent"]

    def take(self, checkpoint: dict) -> None:
        """Be as after the fit that ended with this checkpoint."""
        self.double()
        self.on_load_checkpoint(checkpoint)
        self.load_state_dict(checkpoint["state_dict"])
        torch.set_rng_state(self._random)

    def validation_step(self, scored: ScoredRuns, index: int) -> None:
        values = scores(self.model, scored)
        if (self.overdrive, self.overspeed) != (1.0, 1):
            values["overdriven"] = max(diverged_under_stress(self.model, scored, self.overdrive, speed)
                                       for speed in {1, self.overspeed})
            values["relative"] = float("inf") if values["overdriven"] else values["relative"]
        self._log(values, "validation")

    def test_step(self, scored: ScoredRuns, index: int) -> None:
        self._log(scores(self.model, scored), "test")

    def _log(self, values: Mapping[str, float], split: str) -> None:
        # as tensors, because Lightning converts plain numbers to single precision
        self.log_dict({f"{split}/{name}": torch.tensor(value, dtype=torch.float64) for name, value in values.items()},
                      batch_size=1, prog_bar=split == "validation")


class LeastSquaresFit(ModelFit):
    """Fits a model in closed form: one epoch per stage, which is solved at its last batch.

    The solution is the step of the optimizer `ExactSolve`. Checkpoints, loggers and the validation after the epoch
    therefore all use the solved parameters. ridge, penalty: see `ExactSolve`. folds: number of parts for
    cross-validation; parts are trajectories, or contiguous pieces of long trajectories.
    `solutions` keeps the solutions for the report of the fit.
    """

    kept = ("solutions",)

    @checked(ridge=RIDGE, folds=Whole(2, 1000), penalty=OneOf(*sorted(PENALTIES)))
    def __init__(self, procedure: LeastSquaresModel, ridge: float | Sequence | dict = 0.0, folds: int = 5,
                 penalty: str = "ridge"):
        super().__init__(procedure.model)
        if folds < 2:
            raise ValueError(f"folds is {folds}; cross-validation needs at least 2")
        unknown = set(ridge) - {"default", *procedure.names} if isinstance(ridge, Mapping) else set()
        if unknown:
            raise ValueError(f"ridge names {sorted(unknown)}; this fit has the regressions {sorted(procedure.names)}")
        for each in ridge.values() if isinstance(ridge, Mapping) else [ridge]:
            _ = ridge_candidates(each)
        if penalty not in PENALTIES:
            raise ValueError(f"penalty is {penalty!r}; expected one of {sorted(PENALTIES)}")
        self.procedure, self.ridge, self.folds, self.penalty = procedure, ridge, int(folds), penalty
        self.automatic_optimization = False
        self.solutions: dict[str, dict] = {}

    @property
    def epochs(self) -> int:
        """Number of passes over the data."""
        return len(self.procedure.stages)

    def configure_optimizers(self) -> ExactSolve:
        return ExactSolve(self.model.parameters(), self.ridge, self.penalty)

    def on_train_start(self) -> None:
        if isinstance(getattr(self.trainer.train_dataloader, "sampler", None), DistributedSampler):
            raise ValueError("the trainer would give some segments to two processes, so that they count twice; set "
                             "trainer.use_distributed_sampler=false (the data module distributes the segments)")
        # DDP waits for a backward pass, which a closed-form fit does not have
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
