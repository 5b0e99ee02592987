"""What the settings of the controller do, one at a time, on the analytic trunk.

python docs/tutorials/tuning_the_mpc.py stores the numbers of the tutorial and draws its figures.
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

from ssmr_torch.closed_loop.simulation import simulate
from ssmr_torch.collection.collect import ControlledRun, collect
from ssmr_torch.collection.excitation import SmoothRandom, latin_hypercube_ramps
from ssmr_torch.control.kalman_observers import KalmanObserver
from ssmr_torch.control.mpc import ModelPredictiveController
from ssmr_torch.data.datamodule import TrajectoryDataModule
from ssmr_torch.documents.results import store_tables
from ssmr_torch.evaluation import figures
from ssmr_torch.evaluation.figures import METHODS, MM, MS, SPARE_COLOURS, WIDTH, panels
from ssmr_torch.evaluation.metrics import closed_loop_metrics
from ssmr_torch.fitting.training import least_squares, train
from ssmr_torch.models.ssmr import SSMR
from ssmr_torch.plants.emulated_rig import rig
from ssmr_torch.plants.slow_manifold import SlowManifold
from ssmr_torch.tasks.references import figure_eight

FIGURES = Path(__file__).resolve().parents[1] / "figures"
NOISE = 3.16e-5  # m, of each measured position


def learn():
    """A cubic SSMR of the trunk's two markers with one delay, from 24 decays and 36 s of random inputs."""
    runs = ControlledRun("train", SmoothRandom(knot_interval=0.4, share=0.5), 12.0, repeats=3)
    data = collect(SlowManifold(), decays=latin_hypercube_ramps(24, inputs=4, seed=0), validation_decays=0,
                   test_decays=0, decay_duration=3.0, controlled=[runs], noise_std=NOISE, progress=False)
    trainer = partial(lightning.Trainer, accelerator="cpu", devices=1, use_distributed_sampler=False,
                      enable_model_summary=False, enable_progress_bar=False)
    with tempfile.TemporaryDirectory() as directory:
        return train(data, directory=directory, trainer=trainer,
                     fits={"closed_form": partial(least_squares, ridge=0.0)},
                     model=partial(SSMR, state_dim=6, delays=1, parametrization_degree=3, dynamics_degree=3,
                                   substeps=2),
                     module=partial(TrajectoryDataModule, validation_share=0, transient=0.1)).model.reduced.numpy()


# --8<-- [start:track]
def track(model, plant=None, *, speed=4.0, laps=3, noise=NOISE, **settings):
    """The record of figure eights of 15 mm at `speed` rad/s, with these settings of the controller."""
    plant = SlowManifold() if plant is None else plant
    task = figure_eight(amplitude=0.015, angular_speed=speed, laps=laps, tracked=("tip_x", "tip_y"))
    controller = ModelPredictiveController(model, task, plant.input_bounds, timestep=plant.timestep,
                                           output_names=plant.output_names, **settings)
    return simulate(plant, controller, task, noise_std=noise)
# --8<-- [end:track]


def error(record):
    """RMSE, m."""
    return closed_loop_metrics(record)["rmse"]


def unrest(record):
    """Mean change of an input from one control step to the next, N."""
    return float(np.abs(np.diff(record.input[::2], axis=0)).mean())


# --8<-- [start:weights]
WEIGHTS = (3.0, 10.0, 30.0, 100.0, 300.0, 1e3, 3e3, 1e4, 3e4)  # of inputs in units of their range
OBSERVERS = {"chart": None, "kalman": partial(KalmanObserver, disturbance="none", extended=True),
             "output disturbance": partial(KalmanObserver, disturbance="output"),
             "input disturbance": partial(KalmanObserver, disturbance="input")}


def weigh(model, weights=WEIGHTS):
    """Records by input weight: without noise, with noise, and with noise and an observer."""
    return {"no noise": {w: track(model, noise=0.0, input_weight=w) for w in weights},
            "noise": {w: track(model, input_weight=w) for w in weights},
            "noise, observer": {w: track(model, input_weight=w, observer=OBSERVERS["input disturbance"])
                                for w in weights}}
# --8<-- [end:weights]


# --8<-- [start:horizons]
def look_ahead(model, horizons=(1, 2, 3, 5, 10, 20)):
    """Records by number of steps N that the controller looks ahead, 20 ms each."""
    return {horizon: track(model, horizon=horizon) for horizon in horizons}
# --8<-- [end:horizons]


# --8<-- [start:observers]
class Pulled:
    """The trunk, on whose first cable a weight pulls with `force` N that no model knows of."""

    def __init__(self, plant, force=0.15):
        self.plant, self.force = plant, np.array([force, 0.0, 0.0, 0.0])

    def __getattr__(self, name):
        return getattr(self.plant, name)

    def step(self, input):
        return self.plant.step(input + self.force)


def observe(model, observers=OBSERVERS):
    """Errors (m) by observer: as it was trained and pulled, at 4 rad/s and at 1 rad/s."""
    return {name: {f"{state}, {speed:g} rad/s": error(track(model, plant(), speed=speed, laps=laps, observer=observer))
                   for state, plant in (("free", SlowManifold), ("pulled", lambda: Pulled(SlowManifold())))
                   for speed, laps in ((4.0, 3), (1.0, 1))}
            for name, observer in observers.items()}
# --8<-- [end:observers]


# --8<-- [start:delay]
def late(model):
    """Errors (m) with measurements that come 20 ms late: not told of it, and told."""
    plant = rig(SlowManifold(), sensor_delay=0.02)
    return error(track(model, plant)), error(track(model, plant, measurement_delay=0.02))
# --8<-- [end:delay]


@figures.styled
def draw_settings(weighed, ahead, observed):
    """Error over the input weight, over the horizon with the solve time, and by observer."""
    figure, (weight, horizon, observer) = panels(WIDTH, 3.0, 1, 3, width_ratios=(1.2, 1, 1.2))
    looks = (("#999999", "s", ":"), (METHODS["EDMD"][0], "^", "-"), (METHODS["SSMR"][0], "o", "-"))
    for (name, records), (colour, marker, line) in zip(weighed.items(), looks):
        weight.loglog(list(records), [MM * error(r) for r in records.values()], line, marker=marker, markersize=4,
                      color=colour, label=name)
    weight.set(xlabel="input weight", ylabel="RMSE (mm)")
    steps = list(ahead)
    horizon.semilogx(steps, [MM * error(r) for r in ahead.values()], "^-", color=METHODS["EDMD"][0], markersize=4,
                   label="RMSE (mm)")
    horizon.semilogx(steps, [MS * np.nanmedian(r.solve_time) for r in ahead.values()], "D--", color=SPARE_COLOURS[0],
                   markersize=4, label="solve time (ms)")
    horizon.set(xlabel="horizon $N$ (steps of 20 ms)", ylim=(0, 1.2))
    horizon.set_xticks(steps, steps)
    horizon.minorticks_off()
    draw_observers(observer, observed)
    for axes in (weight, horizon):
        axes.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axes.legend(loc="upper center")
    weight.set_ylim(top=20)
    return figure


def draw_observers(axes, observed):
    rows = np.arange(len(observed))[::-1]
    looks = {"free, 4 rad/s": ("#56B4E9", "o", "none"), "pulled, 4 rad/s": ("#0072B2", "o", "#0072B2"),
             "free, 1 rad/s": ("#E69F00", "s", "none"), "pulled, 1 rad/s": ("#D55E00", "s", "#D55E00")}
    for case, (colour, marker, face) in looks.items():
        axes.plot([MM * by_case[case] for by_case in observed.values()], rows, marker, color=colour, mfc=face,
                  markersize=5, label=case)
    axes.set_yticks(rows, [name.replace(" ", "\n") for name in observed])
    axes.set(xlabel="RMSE (mm)", xscale="log", ylim=(-0.5, len(observed) + 0.9))
    axes.set_xticks([0.1, 0.2, 0.5, 1, 2], ["0.1", "0.2", "0.5", "1", "2"])
    axes.minorticks_off()
    axes.legend(loc="upper center", ncols=2, fontsize=6, handletextpad=0.1, columnspacing=0.8)


@figures.styled
def draw_weights(records):
    """What three input weights do with noise: the tip's path, and the force of one cable."""
    figure, (plane, force) = panels(WIDTH, 2.9, 1, 2, width_ratios=(1, 1.4))
    looks = (METHODS["EDMD"][0], METHODS["SSMR"][0], METHODS["TPWL"][0])
    shown = slice(200, 400)
    for (weight, record), colour in zip(records.items(), looks):
        path = MM * record.observation[shown, list(record.tracked)[0]], MM * record.observation[shown, 1]
        plane.plot(*path, color=colour, label=f"weight {weight:g}")
        force.step(record.time[shown], record.input[shown, 0], where="post", color=colour, linewidth=0.9)
    plane.plot(*MM * record.reference[shown].T, METHODS["reference"][1], color="black", linewidth=0.9,
               label="reference")
    plane.set(xlabel="tip x (mm)", ylabel="tip y (mm)", aspect="equal")
    force.set(xlabel="time (s)", ylabel="force of the first cable (N)")
    figure.legend(*plane.get_legend_handles_labels(), loc="outside upper center", ncols=4)
    return figure


def numbers(weighed, ahead, observed, delayed):
    """mm, N and ms."""
    return {"weight": {name: {w: (MM * error(r), unrest(r)) for w, r in records.items()}
                       for name, records in weighed.items()},
            "horizon": {n: (MM * error(r), MS * float(np.nanmedian(r.solve_time))) for n, r in ahead.items()},
            "observer": {name: {case: MM * value for case, value in cases.items()} for name, cases in observed.items()},
            "late": [MM * value for value in delayed]}


def main(directory=FIGURES, quick=False):
    """The errors by setting; quick: of a few settings."""
    logging.getLogger("lightning.pytorch.utilities.rank_zero").setLevel(logging.WARNING)
    warnings.filterwarnings("ignore", ".*LeafSpec|.*does not have many workers|.*Checkpoint directory")
    model = learn()
    weighed = weigh(model, (3.0, 300.0, 3e4) if quick else WEIGHTS)
    ahead = look_ahead(model, (1, 2, 5) if quick else (1, 2, 3, 5, 10, 20))
    observed, delayed = observe(model), late(model)
    figures.save(draw_settings(weighed, ahead, observed), Path(directory) / "tutorial_mpc_settings.svg")
    few = {weight: weighed["noise"][weight] for weight in (3.0, 300.0, 3e4)}
    figures.save(draw_weights(few), Path(directory) / "tutorial_mpc_weights.svg")
    return numbers(weighed, ahead, observed, delayed)


def tables(found):
    """What the page shows, by name of the store."""
    weights = [[w, found["weight"]["no noise"][w][0], *found["weight"]["noise"][w],
                found["weight"]["noise, observer"][w][0]] for w in found["weight"]["noise"]]
    first = found["horizon"][min(found["horizon"])][1]
    cases = ("free, 4 rad/s", "pulled, 4 rad/s", "free, 1 rad/s", "pulled, 1 rad/s")
    return {"tutorial_mpc_weights": (["input weight", "error without noise (mm)", "error with noise (mm)",
                                      "change of an input per step, with noise (N)",
                                      "error with noise and observer (mm)"], weights),
            "tutorial_mpc_horizons": (["N", "error (mm)", "time of a step, relative to the shortest horizon"],
                                      [[n, value, time / first] for n, (value, time) in found["horizon"].items()]),
            "tutorial_mpc_observers": (["error (mm)", *cases], [[name, *(by_case[case] for case in cases)]
                                                                for name, by_case in found["observer"].items()]),
            "tutorial_mpc_late": (["controller", "error (mm)"], [["not told of the delay", found["late"][0]],
                                                                  ["told of it", found["late"][1]]])}


if __name__ == "__main__":
    store_tables(FIGURES.parents[1], tables(main()), "python docs/tutorials/tuning_the_mpc.py")
