"""Trajectories → model.ckpt, report, figures; a sweep ends with a table, best first.

ssmr train data.path=FILE.h5 model=ssmr; sweeps with ssmr train -m data.path=FILE.h5 model=ssmr,sssr
"""

from hydra.core.hydra_config import HydraConfig
from hydra.utils import instantiate
from omegaconf import OmegaConf

from ssmr_torch.entry_point import entry_point, save_json, save_result
from ssmr_torch.extras import require


def objective(config, scores):
    """The score that a sweep minimizes; None where there is no validation."""
    searched = HydraConfig.get().runtime.choices.get("sweep")
    if config.metric not in scores and (searched or any(name.startswith("validation/") for name in scores)):
        raise ValueError(f"metric is {config.metric!r}; the scores are {sorted(scores) or 'none, without validation'}")
    return scores.get(config.metric)


def further_runs(config, dataset):
    """The controlled runs of the file that a study is to be scored on, run by run; none without."""
    from ssmr_torch.trajectory import TrajectoryDataset

    path = OmegaConf.select(config, "study.runs", throw_on_missing=True)
    return TrajectoryDataset.load(path).observing(dataset.output_names).select(kind="controlled") if path else ()


def draw(report, eigenvalues, directory):
    from ssmr_torch.evaluation import figures
    from ssmr_torch.report.run_sections import training_figures

    for name, figure in training_figures(report, eigenvalues).items():
        figures.save(figure, directory / f"{name}.svg")


@entry_point("train")
def main(config, directory):
    import lightning
    from lightning.pytorch.utilities import rank_zero_only

    from ssmr_torch.evaluation.study import score_runs
    from ssmr_torch.fitting.training import train
    from ssmr_torch.provenance import provenance

    if config.metric.startswith("test/"):
        raise ValueError(f"metric is {config.metric!r}; models are chosen by validation, never by the test runs")
    if "wandb" in config.logger:
        require("wandb")
    lightning.seed_everything(config.seed, workers=True, verbose=False)
    dataset = instantiate(config.data).observing(config.outputs)
    further = further_runs(config, dataset)
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
    found = {"scores": training.scores, "cost": training.cost, "provenance": origin}
    save_json(directory / "report.json", training.report | found)
    if config.figures:
        draw(training.report, dataset.provenance.get("eigenvalues"), directory)
    print(training.summary())
    score = objective(config, training.scores)
    runs = score_runs(config.name, training.model, further, dataset.select("train", "controlled"),
                      starts=config.module.starts, seed=config.seed)
    save_result(directory, {config.metric: score} | training.scores, name=config.name, cost=training.cost, runs=runs)
    return score


if __name__ == "__main__":
    main()
