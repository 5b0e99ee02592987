"""Trajectories → model.ckpt, report, figures; a multirun ends with a table, best first.

ssmr train data.path=FILE.h5 model=ssmr; several models with ssmr train -m data.path=FILE.h5 model=ssmr,sssr
"""

from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from hydra.utils import instantiate
from omegaconf import OmegaConf

from ssmr_torch.entry_point import entry_point, found_row, save_result
from ssmr_torch.extras import require


@entry_point("train", resumed="resume=true")
def main(config, directory):
    from ssmr_torch.fitting.training_run import run_training
    from ssmr_torch.trajectory import TrajectoryDataset

    if "wandb" in config.logger:
        require("wandb")
    choices = HydraConfig.get().runtime.choices
    runs = OmegaConf.select(config, "study.runs", throw_on_missing=True)
    run = run_training(
        instantiate(config.data).observing(config.outputs), OmegaConf.to_container(config, resolve=True),
        kind=choices.model, model=instantiate(config.model), module=instantiate(config.module),
        fits={name: instantiate(fit) for name, fit in config.fit.items()}, trainer=instantiate(config.trainer),
        loggers=[instantiate(logger) for logger in config.logger.values()], directory=directory,
        study=TrajectoryDataset.load(runs) if runs else None, searched=bool(choices.get("search")),
        several=HydraConfig.get().mode == RunMode.MULTIRUN)
    if run is None:
        return None
    print(run.training.summary())
    save_result(directory, run.metrics, name=config.name, cost=run.training.cost, runs=run.by_run,
                found=found_row(config))
    return run.score


if __name__ == "__main__":
    main()
