"""Trajectories → model: python experiments/train.py data.path=FILE.h5 model=ssmr; sweeps with -m model=ssmr,sssr"""

import lightning
from entry import entry_point, save_json, save_result
from hydra.utils import instantiate
from lightning.pytorch.utilities import rank_zero_only
from omegaconf import OmegaConf

from ssmr_torch.evaluation import figures
from ssmr_torch.evaluation.sections import training_figures
from ssmr_torch.fitting.training import train
from ssmr_torch.provenance import provenance


@entry_point("train")
def main(config, directory):
    lightning.seed_everything(config.seed, workers=True, verbose=False)
    dataset = instantiate(config.data).observing(config.outputs)
    loggers = [instantiate(logger) for logger in config.logger.values()]
    configuration = OmegaConf.to_container(config, resolve=True)
    origin = provenance(configuration) | {"name": config.name}
    try:
        for logger in loggers:
            logger.log_hyperparams(configuration)
        training = train(dataset, model=instantiate(config.model), module=instantiate(config.module),
                         fits={name: instantiate(fit) for name, fit in config.fit.items()},
                         trainer=instantiate(config.trainer), directory=directory, name=config.name,
                         loggers=loggers, resume=config.resume, origin=origin)
        if rank_zero_only.rank > 0:
            return None
    finally:
        for logger in loggers:
            logger.finalize("success")
            getattr(logger.experiment, "finish", lambda: None)()
    save_json(directory / "report.json", training.report | {"scores": training.scores, "provenance": origin})
    drawn = training_figures(training.report, dataset.provenance.get("eigenvalues")) if config.figures else {}
    for name, figure in drawn.items():
        figures.save(figure, directory / f"{name}.svg")
    print(training.summary())
    save_result(directory, {config.metric: training.scores.get(config.metric), **training.scores, **training.cost})
    return training.scores.get(config.metric)


if __name__ == "__main__":
    main()
