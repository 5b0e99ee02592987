"""CPU time of fits and of evaluation, each beside the time that was aimed at.

Without recordings it records them first, as `ssmr collect plant=trunk_coarse excitation=trunk` does: 40 decays of 5 s
and 60 s of controlled motion, three markers, eight cables. The closed form of the SSMR is that of the slow-manifold
trunk as well, 40 decays and 8,700 controlled samples. Fits go through Lightning as in training. One row a figure: the
first call, the median of the others, and that relative to the time that was aimed at.
"""

from __future__ import annotations

import logging
import warnings
from collections.abc import Callable, Iterator
from functools import partial
from statistics import median
from time import process_time

import lightning
import torch

from ssmr_torch import configuration
from ssmr_torch.checked_arguments import checked
from ssmr_torch.data.datamodule import TrajectoryDataModule
from ssmr_torch.evaluation.open_loop import compare_open_loop
from ssmr_torch.fitting.gauss_newton import GaussNewtonFit
from ssmr_torch.fitting.stability import StabilityGuard
from ssmr_torch.fitting.training import koopman_least_squares, least_squares
from ssmr_torch.models.koopman import EDMD
from ssmr_torch.models.ssmr import SSMR
from ssmr_torch.quantities import PATH
from ssmr_torch.ranges import OrNone
from ssmr_torch.trajectory import TrajectoryDataset

TUNED = {"state_dim": 10, "dynamics_degree": 2, "parametrization_degree": 1, "control_degree": 1}
RIDGE = 6.5e-5


class EpochTimes(lightning.Callback):
    """CPU seconds of each epoch, its validation included."""

    def __init__(self):
        self.started: list[float] = []

    def on_train_epoch_start(self, *_) -> None:
        self.started.append(process_time())

    def on_fit_end(self, *_) -> None:
        self.started.append(process_time())

    @property
    def durations(self) -> list[float]:
        return [after - before for before, after in zip(self.started, self.started[1:])]


def fitted(dataset: TrajectoryDataset, build: Callable, model, *, validated: bool = False) -> list[float]:
    """Fit a model in place; CPU seconds of each epoch."""
    fit, times = build(model), EpochTimes()
    module = TrajectoryDataModule(dataset, validation_share=0.0).prepare(fit)
    trainer = lightning.Trainer(accelerator="cpu", devices=1, max_epochs=fit.epochs, logger=False, callbacks=[times],
                                enable_checkpointing=False, enable_progress_bar=False, enable_model_summary=False,
                                num_sanity_val_steps=0, use_distributed_sampler=False,
                                limit_val_batches=1.0 if validated else 0)
    trainer.fit(fit, module)
    return times.durations


def sized(kind: type, dataset: TrajectoryDataset, **options):
    return kind(input_dim=dataset.input_dim, output_dim=dataset.output_dim, timestep=dataset.timestep, **options)


def closed_form(dataset: TrajectoryDataset, kind: type, build: Callable, **options) -> float:
    return sum(fitted(dataset, build, sized(kind, dataset, **options)))


def cpu(action: Callable) -> float:
    begun = process_time()
    action()
    return process_time() - begun


def recorded(*overrides: str) -> TrajectoryDataset:
    config = configuration.composed("collect", ["excitation.progress=false", *overrides])
    return configuration.built(config.excitation)(configuration.built(config.plant))


def figures(trunk: TrajectoryDataset, manifold: TrajectoryDataset):
    """Name, goal in s, and the CPU seconds of each repeat, first one first."""
    yield "SSMR closed form, n = 6, degree 3, nine ridges", 0.35, [
        closed_form(manifold, SSMR, least_squares, state_dim=6) for _ in range(5)]
    for n in (6, 10):
        yield f"  the same on the trunk, n = {n}, degree 2", 0.35, [
            closed_form(trunk, SSMR, least_squares, **(TUNED | {"state_dim": n})) for _ in range(3)]
    yield "EDMD closed form, two delays, degree 2, nine ridges", 8.0, [
        closed_form(trunk, EDMD, koopman_least_squares, delays=2, degree=2) for _ in range(2)]
    model = sized(SSMR, trunk, **TUNED)
    fitted(trunk, partial(least_squares, ridge={"default": RIDGE}), model)
    guard = StabilityGuard(trunk.select("train"))
    yield "stability guard, once", 0.35, [cpu(lambda: guard.diverging(model)) for _ in range(4)]
    yield "Gauss-Newton, an epoch", 5.0, fitted(trunk, partial(GaussNewtonFit, epochs=4, tolerance=0.0), model,
                                                validated=True)
    tested = trunk.select("test", "controlled")
    yield "evaluation, 500 starts, 50 ms to full runs", 0.5, [
        cpu(lambda: compare_open_loop({"SSMR": model}, tested)) for _ in range(4)]


@checked(data=OrNone(PATH))
def rows(*, data: str | None = None) -> Iterator[dict]:
    """One row per figure, CPU s on one thread.   data: .h5 of the trunk's trajectories; None records them."""
    logging.getLogger("lightning.pytorch").setLevel(logging.ERROR)
    warnings.filterwarnings("ignore")
    torch.set_num_threads(1)
    trunk = recorded("plant=trunk_coarse", "excitation=trunk") if data is None else TrajectoryDataset.load(data)
    for name, goal, times in figures(trunk, recorded()):
        usual = median(times[1:] or times)
        yield {"figure": name, "first, s": times[0], "median, s": usual, "goal, s": goal, "of the goal": usual / goal}
