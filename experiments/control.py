"""Artifact in closed loop with a plant: python experiments/control.py artifact=DIR; sweeps with -m artifact=A,B"""

from entry import entry_point, save_json, save_result
from hydra.utils import instantiate
from omegaconf import OmegaConf

from ssmr_torch import artifact
from ssmr_torch.closed_loop import simulate
from ssmr_torch.evaluation.metrics import closed_loop_metrics
from ssmr_torch.provenance import provenance


@entry_point("control")
def main(config, directory):
    loaded, plant, task = artifact.load(config.artifact), instantiate(config.plant), instantiate(config.task)
    artifact.check_plant(loaded, plant)
    controller = instantiate(config.controller)(loaded.model, task, plant.input_bounds, timestep=plant.timestep,
                                                output_names=plant.output_names)
    origin = provenance(OmegaConf.to_container(config, resolve=True)) | {"model": loaded.card["name"],
                                                                         "artifact": loaded.card["sha256"]}
    record = simulate(plant, controller, task, seed=config.seed, noise_std=config.noise_std,
                      progress=config.progress, provenance=origin | {"input_bounds": plant.input_bounds.tolist()})
    record.save(directory / "record.h5")
    metrics = closed_loop_metrics(record)
    save_json(directory / "metrics.json", metrics)
    print("\n".join(f"{name}: {value:.6g}" for name, value in metrics.items()))
    print(directory / "record.h5")
    save_result(directory, metrics)
    return metrics["ise"]


if __name__ == "__main__":
    main()
