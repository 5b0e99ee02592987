"""An artifact's controller on a plant: the plant on its rig, the margins of the controller, one run, what it was worth.

    plant ─▶ plant_on_rig ─▶ run_artifact(artifact, task, plant, make) ─▶ (record, report)
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path

from ssmr_torch.closed_loop.record import ClosedLoopRecord
from ssmr_torch.closed_loop.simulation import simulate
from ssmr_torch.control.tightening import tightened
from ssmr_torch.deployment import artifact
from ssmr_torch.deployment.artifact import Artifact
from ssmr_torch.evaluation.loop_report import LoopReport
from ssmr_torch.trajectory import TrajectoryDataset


def plant_on_rig(plant, rig: Callable, output_names) -> object:
    """The plant on its rig, whose sensors see what the model was trained on where the plant offers more.

    rig: called with the plant; a partial of `ssmr_torch.plants.emulated_rig.rig`, as conf/rig makes it.
    output_names: those of the model.
    """
    free = getattr(rig, "keywords", {}).get("outputs") is None
    more = free and set(output_names) < set(plant.output_names)
    return rig(plant, **({"outputs": list(output_names)} if more else {}))


def tighten_by_recordings(controller, path: str | Path, output_names, quantile: float | None = None) -> str:
    """Tighten the constraints by the controller's prediction errors on recordings: the controlled runs marked test, or
    all controlled runs where none is.

    path: .h5 of trajectories.   quantile: of the errors; None takes the controller's margin_quantile.
    Returns a sentence with the margins of the stages, mm. Raises what `tightened` raises.
    """
    dataset = TrajectoryDataset.load(path).observing(output_names)
    runs = dataset.select(kind="controlled")
    tightened(controller, [run.read() for run in [run for run in runs if run.split == "test"] or runs], quantile)
    return "margins: " + ", ".join(f"{1e3 * margin:.3g}" for margin in controller.settings.margins) + " mm"


def run_artifact(loaded: Artifact, task, plant, make: Callable, source, *, residuals: str | None = None,
                 quantile: float | None = None, fixed_margins: bool = False, view: Callable | None = None,
                 directory: Path | None = None, provenance: dict | None = None,
                 **options) -> tuple[ClosedLoopRecord, LoopReport]:
    """Build the controller for the task, tighten it where `residuals` names recordings, and let it steer the plant.

    make(source, task, input_bounds, timestep=s, output_names=…) → controller; source: the artifact or its model, see
    `wire.runner.made_of`.   residuals, quantile: see `tighten_by_recordings`.   fixed_margins: the margins were given,
    or the controller has none.   view(task, plant, directory) → what shows the run while it lasts.   options: `seed`,
    `noise_std` and `progress` of `simulate`.
    Raises ValueError for a plant that is not the one of the training, for residuals where margins are fixed,
    and for a quantile without residuals.
    """
    if quantile is not None and residuals is None:
        raise ValueError(f"quantile is {quantile}, but there are no errors to take it of; give residuals=FILE.h5 as "
                         "well, or leave quantile out")
    artifact.check_source(loaded, plant)
    if residuals is not None and fixed_margins:
        raise ValueError(f"residuals={residuals} sets the margins of a predictive controller; use controller=scp, and "
                         "leave controller.margins null")
    controller = make(source, task, plant.input_bounds, timestep=plant.timestep, output_names=plant.output_names)
    if residuals is not None:
        print(tighten_by_recordings(controller, residuals, loaded.card["output_names"], quantile))
    origin = (provenance or {}) | {"model": loaded.card["name"], "artifact": loaded.card["sha256"],
                                   "input_bounds": plant.input_bounds.tolist()}
    with view(task, plant, directory) if view else nullcontext() as watch:
        record = simulate(plant, controller, task, watch=watch, provenance=origin, **options)
    return record, record.report(task.obstacles)


def in_a_sentence(model: str, metrics: dict[str, float]) -> str:
    """Errors, times and fallbacks of a run, metrics as of `closed_loop_metrics`."""
    inside = "" if "violation_ratio" not in metrics else (
        f"inside an obstacle {100 * metrics['violation_ratio']:.3g} % of the time, "
        f"by {1e3 * metrics['max_violation']:.3g} mm at most, ")
    return (f"{model}: RMSE {1e3 * metrics['rmse']:.3g} mm, max {1e3 * metrics['max_error']:.3g} mm, "
            f"ISE {1e6 * metrics['ise']:.4g} mm², solve {1e3 * metrics['solve_time_median']:.2g} ms "
            f"(99 %: {1e3 * metrics['solve_time_p99']:.2g} ms), {inside}{metrics['fallbacks']:.0f} fallbacks")
