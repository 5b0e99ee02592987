"""Closed-form fits stream their data: peak memory grows by only a fraction of the size of the data."""

import subprocess
import sys

import numpy as np
import pytest

from ssmr_torch.trajectory import Trajectory, TrajectoryDataset

FIT = """
import resource, sys, warnings
import lightning, torch
from ssmr_torch.data.datamodule import TrajectoryDataModule
from ssmr_torch.fitting.training import koopman_least_squares, least_squares
from ssmr_torch.models.koopman import EDMD
from ssmr_torch.models.ssmr import SSMR
from ssmr_torch.trajectory import TrajectoryDataset

warnings.filterwarnings("ignore")
torch.set_num_threads(1)
dataset = TrajectoryDataset.load(sys.argv[1])
build, model = {"SSMR": (least_squares, SSMR(4, 2, 12, dynamics_degree=2, parametrization_degree=1)),
                "EDMD": (koopman_least_squares, EDMD(2, 12, degree=1))}[sys.argv[2]]
fit = build(model, ridge={"default": 1e-6})
module = TrajectoryDataModule(dataset, validation_share=0.0).prepare(fit)
trainer = lightning.Trainer(accelerator="cpu", devices=1, max_epochs=fit.epochs, logger=False, limit_val_batches=0,
                            enable_checkpointing=False, enable_progress_bar=False, enable_model_summary=False)
trainer.fit(fit, module)
# On Linux getrusage begins with the memory of the process that started this one.
if sys.platform == "linux":
    print(next(line.split()[1] for line in open("/proc/self/status") if line.startswith("VmHWM")))
else:
    print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""
SAMPLES, BYTES = 2000, 2000 * (12 + 2 + 1) * 8


def run(rng, kind):
    time = 0.01 * np.arange(SAMPLES)
    shapes, phases = rng.normal(size=(4, 12)), rng.uniform(0, 6, 4)
    decay = np.exp(-0.3 * np.outer(time, np.ones(4))) if kind == "decay" else 1.0
    modes = decay * np.cos(np.outer(time, [3.0, 5.0, 8.0, 13.0]) + phases)
    inputs = rng.normal(size=(SAMPLES, 2)) * (kind == "controlled")
    return Trajectory(time, 1e-3 * modes @ shapes + 1e-6 * rng.normal(size=(SAMPLES, 12)), inputs, kind)


def peak(path, model):
    """Largest memory of a process that fits this model to the data, bytes."""
    done = subprocess.run([sys.executable, "-c", FIT, path, model], capture_output=True, text=True, check=True)
    unit = 1 if sys.platform == "darwin" else 1024
    return unit * int(done.stdout.split()[-1])


@pytest.mark.slow
@pytest.mark.parametrize("model", ["SSMR", "EDMD"])
def test_the_memory_of_a_closed_form_fit_grows_by_less_than_half_the_size_of_the_data(tmp_path, model):
    rng, peaks = np.random.default_rng(0), {}
    for copies in (1, 100):
        runs = [run(rng, kind) for _ in range(copies) for kind in ("decay", "controlled")]
        path = tmp_path / f"{copies}.h5"
        TrajectoryDataset(runs, np.zeros(12), [f"y{k}" for k in range(12)], ["a", "b"]).save(path)
        peaks[copies] = peak(path, model)
    assert peaks[100] - peaks[1] < 0.5 * 2 * 100 * BYTES, peaks
