"""Artifact in closed loop with a plant → record.h5, metrics, pictures.

ssmr control artifact=DIR task=figure_eight; sweeps with ssmr control -m artifact=A,B
"""

from contextlib import nullcontext

from hydra.utils import instantiate
from omegaconf import OmegaConf

from ssmr_torch.experiments.entry import entry_point, save_json, save_result


def tighten(config, loaded, controller) -> None:
    """Tighten by what the controller misses on the held-out runs of config.residuals, or all where none is marked test.
    """
    from ssmr_torch.control.tightening import tightened
    from ssmr_torch.trajectory import TrajectoryDataset

    if config.controller.get("margins", ()) is not None:
        raise ValueError("residuals=FILE.h5 sets the margins of a predictive controller; use controller=scp, and leave "
                         "controller.margins null")
    dataset = TrajectoryDataset.load(config.residuals).observing(loaded.card["output_names"])
    runs = dataset.select(kind="controlled")
    tightened(controller, [run.read() for run in [run for run in runs if run.split == "test"] or runs], config.quantile)
    print("margins: " + ", ".join(f"{1e3 * margin:.3g}" for margin in controller.settings.margins) + " mm")


def bench(config, loaded):
    """The plant on its rig, which sees what the model was trained on where the plant offers more."""
    plant, names = instantiate(config.plant), loaded.card["output_names"]
    more = config.rig.outputs is None and set(names) < set(plant.output_names)
    return instantiate(config.rig)(plant, **({"outputs": names} if more else {}))


@entry_point("control")
def main(config, directory):
    from ssmr_torch.closed_loop.simulation import simulate
    from ssmr_torch.deployment import artifact
    from ssmr_torch.provenance import provenance
    from ssmr_torch.wire.runner import made_of

    loaded, task = artifact.load(config.artifact), instantiate(config.task)
    plant = bench(config, loaded)
    artifact.check_source(loaded, plant)
    make, source = instantiate(config.controller), made_of(loaded, config.controller._target_)
    controller = make(source, task, plant.input_bounds, timestep=plant.timestep, output_names=plant.output_names)
    if config.residuals is not None:
        tighten(config, loaded, controller)
    origin = provenance(OmegaConf.to_container(config, resolve=True)) | {"model": loaded.card["name"],
                                                                         "artifact": loaded.card["sha256"]}
    with instantiate(config.view)(task, plant, directory) if config.view else nullcontext() as watch:
        record = simulate(plant, controller, task, seed=config.seed, noise_std=config.noise_std, watch=watch,
                          progress=config.progress, provenance=origin | {"input_bounds": plant.input_bounds.tolist()})
    record.save(directory / "record.h5")
    if config.picture:
        from ssmr_torch.closed_loop.deformation import draw_robot

        draw_robot(plant, record, directory, config.animate, task.obstacles)
    report = record.report(task.obstacles)
    metrics = report.metrics
    save_json(directory / "metrics.json", report.facts)
    inside = "" if not task.obstacles else (f"inside an obstacle {100 * metrics['violation_ratio']:.3g} % of the time, "
                                            f"by {1e3 * metrics['max_violation']:.3g} mm at most, ")
    print(f"{origin['model']}: RMSE {1e3 * metrics['rmse']:.3g} mm, max {1e3 * metrics['max_error']:.3g} mm, "
          f"ISE {1e6 * metrics['ise']:.4g} mm², solve {1e3 * metrics['solve_time_median']:.2g} ms "
          f"(99 %: {1e3 * metrics['solve_time_p99']:.2g} ms), {inside}{metrics['fallbacks']:.0f} fallbacks\n{report}\n"
          f"{directory / 'record.h5'}")
    save_result(directory, metrics)
    return metrics["ise"]


if __name__ == "__main__":
    main()
