"""How many reduced coordinates, delays and degrees: one sweep of each on a robot whose answer is known.

python docs/tutorials/dimension_delays_degree.py stores the numbers of the tutorial and draws its figures.
"""

from __future__ import annotations

import logging
import tempfile
import warnings
from functools import partial
from pathlib import Path

import lightning
import numpy as np
from matplotlib.ticker import StrMethodFormatter

from ssmr_torch.collection.collect import ControlledRun, collect
from ssmr_torch.collection.excitation import SmoothRandom, latin_hypercube_ramps
from ssmr_torch.data.datamodule import TrajectoryDataModule
from ssmr_torch.documents.results import store_tables
from ssmr_torch.evaluation import figures
from ssmr_torch.evaluation.figures import METHODS, MM, WIDTH, panels
from ssmr_torch.evaluation.measured_rollouts import predict_trajectory
from ssmr_torch.evaluation.open_loop import score_open_loop
from ssmr_torch.fitting.training import least_squares, train
from ssmr_torch.models.ssmr import SSMR
from ssmr_torch.plants.slow_manifold import SlowManifold

FIGURES = Path(__file__).resolve().parents[1] / "figures"
KINDS = {"decays": "decay-test", "usual inputs": "usual", "strong inputs": "strong"}
MARGIN = 13  # samples before each start: the same starts for all delays up to twelve


# --8<-- [start:record]
def recordings():
    """24 decays and 36 s of random inputs for training; decays, usual and strong inputs for the test."""
    train_runs = ControlledRun("train", SmoothRandom(knot_interval=0.4, share=0.5), 12.0, repeats=3)
    usual = ControlledRun("usual", SmoothRandom(knot_interval=0.4, share=0.5), 10.0, "test")
    strong = ControlledRun("strong", SmoothRandom(knot_interval=0.3, share=0.8), 10.0, "test")
    return collect(SlowManifold(), decays=latin_hypercube_ramps(24, inputs=4, seed=0), validation_decays=0,
                   test_decays=6, decay_duration=3.0, controlled=[train_runs, usual, strong], noise_std=3e-5,
                   progress=False)
# --8<-- [end:record]


# --8<-- [start:fit]
def fit(data, state_dim=6, delays=2, degree=3):
    """An SSMR of the data: the model, and what the fit reports."""
    trainer = partial(lightning.Trainer, accelerator="cpu", devices=1, use_distributed_sampler=False,
                      enable_model_summary=False, enable_progress_bar=False)
    with tempfile.TemporaryDirectory() as directory:
        training = train(data, directory=directory, trainer=trainer,
                         fits={"closed_form": partial(least_squares, ridge=0.0)},
                         model=partial(SSMR, state_dim=state_dim, delays=delays, parametrization_degree=degree,
                                       dynamics_degree=degree, substeps=2),
                         module=partial(TrajectoryDataModule, validation_share=0, transient=0.1, score_test=False))
    return training.model.reduced.numpy(), training.report["closed_form"]


def score(data, model):
    """Median error of the tip over 200 ms, m, and share of rollouts that diverge within 1 s, for each kind of run."""
    found = {}
    for kind, name in KINDS.items():
        runs = [run for run in data.select("test") if run.name.startswith(name)]
        parts = score_open_loop(model, runs, outputs=[0, 1, 2], starts=200, margin=MARGIN, horizons=(0.2, 1.0))
        found[kind] = parts["200 ms"].median, parts["1 s"].diverged
    return found
# --8<-- [end:fit]


# --8<-- [start:sweeps]
SWEEPS = {"state_dim": (2, 4, 6, 8, 10, 12), "delays": (1, 2, 3, 4, 6, 8, 12), "degree": (1, 2, 3, 4, 5)}
QUICK = {"state_dim": (4, 6), "delays": (1, 12), "degree": (5,)}


def sweep(data, choices):
    """Scores of the models that differ from n = 6, two delays and degree 3 in one choice each."""
    return {name: {value: score(data, fit(data, **{name: value})[0]) for value in values}
            for name, values in choices.items()}
# --8<-- [end:sweeps]


@figures.styled
def draw_sweeps(scores):
    """Above the error over 200 ms, below the share that diverges within 1 s, over each of the three choices."""
    titles = {"state_dim": "reduced coordinates $n$", "delays": "delays", "degree": "degree"}
    looks = {"decays": ("#999999", "s"), "usual inputs": (METHODS["SSMR"][0], "o"),
             "strong inputs": (METHODS["EDMD"][0], "^")}
    figure, grid = panels(WIDTH, 3.8, 2, 3, sharex="col", sharey="row", height_ratios=(1.6, 1))
    for (name, by_value), column in zip(scores.items(), grid.T):
        values = list(by_value)
        for kind, (colour, marker) in looks.items():
            error, diverged = np.array([by_value[value][kind] for value in values]).T
            error = np.where(np.isfinite(error), error, np.nan)
            options = {"color": colour, "marker": marker, "markersize": 4}
            column[0].semilogy(values, MM * error, label=kind, **options)
            column[1].plot(values, 100 * diverged, **options)
        column[1].set(xlabel=titles[name], xticks=values)
    grid[0, 0].set_ylabel("median error, 200 ms (mm)")
    grid[0, 0].yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    grid[1, 0].set(ylabel="diverged in 1 s (%)", ylim=(-5, 105))
    figure.legend(*grid[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


def draw_predictions(data, models, run="strong", duration=1.2):
    """The tip over time under strong inputs: measured, and as predicted by each model until that is 50 mm away."""
    test = next(r for r in data.select("test") if r.name.startswith(run)).read()
    part = test.part(300, 301 + MARGIN + round(duration / test.timestep))
    predicted = {}
    for name, model in models.items():
        time, outputs = predict_trajectory(model, part, margin=MARGIN)
        left = np.linalg.norm(outputs[:, :3], axis=1) > 0.05
        end = np.argmax(left) if left.any() else len(time)
        predicted[name] = time[:end], outputs[:end, :2]
    shown = slice(MARGIN, None)
    return figures.prediction(part.time[shown], part.observation[shown, :2], predicted, ("tip x", "tip y"))


def tables(found):
    """What the page shows, by name of the store."""
    made = {}
    for name, title in (("state_dim", "n"), ("delays", "delays"), ("degree", "degree")):
        rows = [[value, *(float(MM * error) for error, _ in by_kind.values()),
                 float(100 * by_kind["strong inputs"][1])] for value, by_kind in found["scores"][name].items()]
        columns = [title, *(f"{kind} (mm)" for kind in KINDS), "diverged, strong (%)"]
        made[f"tutorial_choice_of_{name}"] = (columns, rows)
    shown = [["fitted", rates(found["eigenvalues"])], ["of the robot", rates(found["true eigenvalues"])]]
    made["tutorial_choice_eigenvalues"] = (["eigenvalues", "1/s"], shown)
    return made


def rates(eigenvalues):
    """One of each pair of eigenvalues in words, slowest first."""
    pairs = sorted((value for value in eigenvalues if value.imag > 0), key=lambda value: value.imag)
    return ", ".join(f"{value.real:.2f} ± {value.imag:.2f}i".replace("-", "−") for value in pairs)


def main(directory=FIGURES, quick=False):
    """The scores of all models, by choice, value and kind of run; quick: of a few."""
    logging.getLogger("lightning.pytorch.utilities.rank_zero").setLevel(logging.WARNING)
    warnings.filterwarnings("ignore", ".*LeafSpec|.*does not have many workers|.*Checkpoint directory")
    data = recordings()
    scores = sweep(data, QUICK if quick else SWEEPS)
    right, report = fit(data, delays=1)
    eigenvalues = np.array([complex(*value) for value in report["eigenvalues"]])
    if not quick:
        values = np.array(report["singular_values"])
        figures.save(figures.singular_values(values, 6), Path(directory) / "tutorial_singular_values.svg")
        figures.save(draw_sweeps(scores), Path(directory) / "tutorial_choices.svg")
        wrong = {"n = 4": {"state_dim": 4}, "twelve delays": {"delays": 12}, "degree 5": {"degree": 5}}
        models = {"SSMR": fit(data)[0]} | {name: fit(data, **choice)[0] for name, choice in wrong.items()}
        figures.save(draw_predictions(data, models), Path(directory) / "tutorial_what_goes_wrong.svg")
    return {"scores": scores, "captured": report["captured_variance"], "eigenvalues": eigenvalues,
            "true eigenvalues": SlowManifold().eigenvalues[:6]}


if __name__ == "__main__":
    store_tables(FIGURES.parents[1], tables(main()), "python docs/tutorials/dimension_delays_degree.py")
