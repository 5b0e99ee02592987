"""One run of `ssmr train`: the training with its loggers, its report and its figures, in the directory of the run."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import lightning
from lightning.pytorch.utilities import rank_zero_only

from ssmr_torch.evaluation.study import score_runs
from ssmr_torch.fitting.resumption import was_begun
from ssmr_torch.fitting.training import Training, train
from ssmr_torch.provenance import provenance
from ssmr_torch.result_files import save_json
from ssmr_torch.trajectory import TrajectoryDataset


@dataclass(frozen=True)
class TrainingRun:
    """A training with the score that multiruns compare, and the scores by test run that a study asks for."""

    training: Training
    metric: str
    score: float | None
    by_run: list[dict]

    @property
    def metrics(self) -> dict:
        """The compared score first, then all scores of validation and test, m."""
        return {self.metric: self.score} | self.training.scores


def run_training(dataset: TrajectoryDataset, configuration: Mapping, *, kind: str, model: Callable, module: Callable,
                 fits: Mapping[str, Callable], trainer: Callable, loggers: Sequence, directory: Path,
                 study: TrajectoryDataset | None = None, searched: bool = False,
                 several: bool = False) -> TrainingRun | None:
    """Train, and write report.json, figures and what `train` writes; None in all processes but the first one.

    configuration: plain values of conf/train.yaml: name, metric, seed, resume, figures, module.starts, and all else for
    the provenance.   kind: of the model, an option of conf/model.   model, module, fits, trainer: see `train`.
    study: whose controlled runs are scored one by one.   searched: whether a search compares the scores.
    several: whether it is one of several jobs, of which resume=true starts those that had not begun.
    Raises ValueError for a metric that is none of the scores of validation, before the training where it is a test's.
    """
    name, metric, seed = (configuration[key] for key in ("name", "metric", "seed"))
    if metric.startswith("test/"):
        raise ValueError(f"metric is {metric!r}; models are chosen by validation, never by the test runs")
    lightning.seed_everything(seed, workers=True, verbose=False)
    further = () if study is None else study.observing(dataset.output_names).select(kind="controlled")
    origin = provenance(configuration) | {"name": name, "kind": kind}
    resume = configuration["resume"] and (not several or was_begun(directory / "checkpoints"))
    with ExitStack() as ending:
        training = train(dataset, model=model, module=module, fits=fits, trainer=trainer, directory=directory,
                         name=name, loggers=loggers, resume=resume, origin=origin,
                         starting=lambda: _log(loggers, configuration, ending))
        if rank_zero_only.rank > 0:
            return None
    found = {"scores": training.scores, "cost": training.cost, "provenance": origin}
    save_json(directory / "report.json", training.report | found)
    if configuration["figures"]:
        draw(training.report, dataset.provenance.get("eigenvalues"), directory)
    by_run = score_runs(name, training.model, further, dataset.select("train", "controlled"),
                        starts=configuration["module"]["starts"], seed=seed)
    return TrainingRun(training, metric, compared(metric, training.scores, searched), by_run)


def _log(loggers: Sequence, configuration: Mapping, ending: ExitStack) -> None:
    """Begin to log. A logger deletes the metrics of an earlier run in its folder, which a refused one must not do."""
    for logger in loggers:
        ending.callback(_finish, logger)
        logger.log_hyperparams(configuration)


def _finish(logger) -> None:
    logger.finalize("success")
    getattr(logger.experiment, "finish", lambda: None)()


def compared(metric: str, scores: Mapping[str, float], searched: bool) -> float | None:
    """The score that a multirun compares; None where there is no validation, which a search cannot do without."""
    if metric not in scores and (searched or any(name.startswith("validation/") for name in scores)):
        raise ValueError(f"metric is {metric!r}; the scores are {sorted(scores) or 'none, without validation'}")
    return scores.get(metric)


def draw(report: Mapping, eigenvalues, directory: Path) -> None:
    """Singular values and eigenvalues as figures in the directory; without the extra plots they are not imported."""
    from ssmr_torch.evaluation import figures
    from ssmr_torch.report.run_sections import training_figures

    for name, figure in training_figures(report, eigenvalues).items():
        figures.save(figure, directory / f"{name}.svg")
