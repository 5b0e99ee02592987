"""Artifact in closed loop with a plant → record.h5, metrics, pictures.

ssmr control artifact=DIR task=figure_eight; sweeps with ssmr control -m artifact=A,B
"""

from hydra.utils import instantiate

from ssmr_torch.entry_point import entry_point, found_row, origin_of, save_json, save_result


@entry_point("control", at_a_robot=True)
def main(config, directory):
    from ssmr_torch.closed_loop.artifact_run import in_a_sentence, plant_on_rig, run_artifact
    from ssmr_torch.deployment import artifact
    from ssmr_torch.wire.runner import made_of

    loaded, task = artifact.load(config.artifact), instantiate(config.task)
    plant = plant_on_rig(instantiate(config.plant), instantiate(config.rig), loaded.card["output_names"])
    record, report = run_artifact(
        loaded, task, plant, instantiate(config.controller), made_of(loaded, config.controller._target_),
        residuals=config.residuals, quantile=config.quantile,
        fixed_margins=config.controller.get("margins", ()) is not None, view=instantiate(config.view),
        directory=directory, provenance=origin_of(config), seed=config.seed, noise_std=config.noise_std,
        progress=config.progress)
    record.save(directory / "record.h5")
    if config.picture:
        from ssmr_torch.closed_loop.deformation import draw_robot

        draw_robot(plant, record, directory, config.animate, task.obstacles)
    save_json(directory / "metrics.json", report.facts)
    print(in_a_sentence(loaded.card["name"], report.metrics), report, directory / "record.h5", sep="\n")
    save_result(directory, report.metrics, found=found_row(config))
    return report.metrics["ise"]


if __name__ == "__main__":
    main()
