"""Closed-form fits: the optimizer that solves, and what it finds of a model that is known."""

import numpy as np
import pytest
import torch

from ssmr_torch.data.derivatives import central_difference, savitzky_golay
from ssmr_torch.data.windows import SegmentDataset
from ssmr_torch.fitting.exact import ExactSolve
from ssmr_torch.fitting.fit import LeastSquaresFit
from ssmr_torch.fitting.ssmr_least_squares import SSMRLeastSquares
from ssmr_torch.models.ssmr import SSMR


def sssm(**changes):
    return SSMR(**{"state_dim": 2, "input_dim": 2, "output_dim": 4, "delays": 0, "parametrization_degree": 2,
                   "dynamics_degree": 3, "control_degree": 1} | changes)


def fitted(runs, rows=1024, model=None, **options):
    """The model after all stages, without Lightning."""
    model = model or sssm(timestep=runs[0].timestep)
    procedure = SSMRLeastSquares(model, **options)
    data = SegmentDataset(runs, before=procedure.before, after=procedure.after, rows=rows)
    for stage in procedure.stages:
        solver = ExactSolve(model.parameters())
        for segment in data:
            for name, found in procedure.regressions(segment, stage).items():
                solver.accumulate(name, found.features, found.targets)
        solver.step()
        procedure.assign(stage, solver.solutions)
    return model


def every_second(runs):
    from dataclasses import replace
    return [replace(r, time=r.time[::2], observation=r.observation[::2], input=r.input[::2]) for r in runs]


if __name__ == "__main__":
    pass


def test_dev(known):
    fine = known.decays(0.005) + known.held_runs(0.005)
    for cal in ("joint", "frozen"):
        runs = fine
        for h in (0.005, 0.01, 0.02):
            print(cal, h, known.errors(fitted(runs, calibration=cal)))
            runs = every_second(runs)
    ex = known.decays(0.01) + known.excited_runs(0.01)
    for rows in (1, 2, 3, 50):
        for cal in ("joint", "frozen"):
            try:
                print(rows, cal, known.errors(fitted(ex, rows=rows, calibration=cal)))
            except Exception as e:
                print(rows, cal, repr(e))
    for al in ("held", "sample"):
        for h in (0.01, 0.005, 0.0025):
            print(al, h, known.errors(fitted(known.decays(h) + known.excited_runs(h), input_alignment=al)))
