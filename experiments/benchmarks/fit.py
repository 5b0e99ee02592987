"""Fit time and evaluation time: `python experiments/benchmarks/fit.py` (one thread).

40 decays and 8,700 transitions of the slow-manifold trunk; SSMR of degree 3 with nine ridges cross-validated. The fit
is timed through Lightning as in training, without validation; the evaluation is 500 starts of 1 s.
"""

from __future__ import annotations

import logging
import os
import platform
import warnings
from functools import partial
from statistics import median
from time import perf_counter

import lightning
import torch

from ssmr_torch import configuration
from ssmr_torch.data.datamodule import TrajectoryDataModule
from ssmr_torch.evaluation.open_loop import score_open_loop
from ssmr_torch.fitting.training import least_squares
from ssmr_torch.models.ssmr import SSMR

REPEATS = 5


def timed_fit(dataset) -> tuple[float, SSMR]:
    model = SSMR(6, dataset.input_dim, dataset.output_dim, timestep=dataset.timestep)
    fit = least_squares(model)
    module = TrajectoryDataModule(dataset, validation_share=0.0).prepare(fit)
    trainer = lightning.Trainer(accelerator="cpu", devices=1, max_epochs=fit.epochs, logger=False,
                                enable_checkpointing=False, enable_progress_bar=False, enable_model_summary=False,
                                limit_val_batches=0, use_distributed_sampler=False)
    start = perf_counter()
    trainer.fit(fit, module)
    return perf_counter() - start, model


def main() -> None:
    logging.getLogger("lightning.pytorch").setLevel(logging.ERROR)
    warnings.filterwarnings("ignore")
    torch.set_num_threads(1)
    config = configuration.composed("collect", ["excitation.progress=false"])
    dataset = configuration.built(config.excitation)(configuration.built(config.plant))
    transitions = sum(t.length for t in dataset.select(kind="controlled"))
    fits = [timed_fit(dataset) for _ in range(REPEATS)]
    score = partial(score_open_loop, fits[-1][1].reduced.numpy(), dataset.select("test", "controlled"), horizons=(1.0,),
                    starts=500)
    evaluations = []
    for _ in range(REPEATS):
        start = perf_counter()
        score()
        evaluations.append(perf_counter() - start)
    print(f"{platform.machine()}, {os.cpu_count()} cores, 1 thread; 40 decays, {transitions} controlled samples")
    print(f"fit: median {median(t for t, _ in fits):.2f} s of {REPEATS} (first {fits[0][0]:.2f} s)")
    print(f"evaluation of the artifact's model, 500 starts of 1 s and the full runs: "
          f"median {median(evaluations):.2f} s of {REPEATS}")


if __name__ == "__main__":
    main()
