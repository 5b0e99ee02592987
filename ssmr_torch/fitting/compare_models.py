"""`compare`: chooses the best form of every kind of model on the training runs, and scores them on the test runs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from time import process_time

import numpy as np
from tqdm import tqdm

from ssmr_torch.evaluation.model_comparison import Comparison
from ssmr_torch.evaluation.run_groups import compare_groups
from ssmr_torch.fitting.fit import fit, refuse_unknown_kind
from ssmr_torch.fitting.training import data_card
from ssmr_torch.provenance import provenance
from ssmr_torch.selection.baseline_choice import KINDS, BaselineChoice, choose_baseline
from ssmr_torch.selection.coordinates import offered
from ssmr_torch.selection.folds_and_starts import Samples
from ssmr_torch.selection.trial import Trial
from ssmr_torch.trained_model import TrainedModel
from ssmr_torch.trajectory import TrajectoryDataset, refuse_other_data

MODELS = ("auto", *KINDS)
HORIZONS = (0.05, 0.1, 0.2, 1.0)
LINE = "fitting {desc} {n_fmt}/{total_fmt} [{elapsed}]"


def compare(data: TrajectoryDataset, models: Iterable | Mapping | None = None, *, scored: Sequence[str] | None = None,
            noise: float = 0.0, horizons: Sequence[float] = HORIZONS, starts: int = 500, seed: int = 0,
            progress: bool | None = None) -> Comparison:
    """Fit the best form of every kind of model to the training runs, and score all on the test runs, group by group.

    models: names or models; default: "auto", the model whose form is chosen from the data, and all baselines. "auto" is
    `fit(data, "auto")`. A baseline ("dmd", "edmd", "edmd_relift", "edmd_bilinear", "static_pregain", "sssr", "ssmr",
    "ssmr_control_augmented") gets the same help: its output coordinates, delays, size, ridge, and whether decays are
    used, are chosen by the same rule on the same folds, see `choose_baseline`. Any other kind ("neural_ode", "tpwl") is
    fitted by `fit`. A `TrainedModel` is used as it is; a mapping gives it a name.
    scored: names of the outputs that matter, from which all errors are computed; None: all. noise: m, standard
    deviation of the measurement noise in closed loop. All models are chosen for it: baselines by rollouts from noisy
    windows. They are scored a second time with this noise on the windows at the starts. horizons: s. starts: number of
    random starts per horizon, over all test runs of a kind.
    progress: whether a line shows which model is being fitted; None: yes.

    Returns a `Comparison`, which prints as a table. A kind is left out if the data cannot determine it, or if all its
    forms diverge; the reason is in `refused`. Raises ValueError, before any work, for an unknown name, for outputs that
    the data do not have, and for data without controlled training runs or without test runs.
    """
    refuse_other_data(data)
    asked = _by_name(MODELS if models is None else models)
    training = [run for run in data.select("train") if run.kind != "static"]
    tests = [run for run in data.select("test") if run.kind != "static"]
    if not tests or not any(run.kind == "controlled" for run in training):
        raise ValueError(f"{len(tests)} test runs and {sum(run.kind == 'controlled' for run in training)} controlled "
                         "training runs; a comparison needs at least one of each (split: test and split: train)")
    outputs = data.columns(scored)
    card = data_card(data, tuple(training))
    fitted, chosen, refused, cpu = {}, {}, {}, {}  # by name
    trial = _trial(training, data.timestep, outputs, noise) if any(each in KINDS for each in asked.values()) else None
    with tqdm(asked.items(), disable=progress is False, leave=False, delay=2.0, bar_format=LINE) as line:
        for name, kind in line:
            line.set_description_str(name)
            began = process_time()
            try:
                fitted[name], chosen[name] = _fitted(kind, name, data, trial, card, scored, noise, seed)
            except ValueError as error:
                refused[name] = str(error)
            known = (kind.card.get("cost") or {}).get("fit_time") if isinstance(kind, TrainedModel) else None
            cpu[name] = known if isinstance(kind, TrainedModel) else process_time() - began
    if not fitted:
        raise ValueError("no model could be fitted; " + "; ".join(f"{name}: {why}" for name, why in refused.items()))
    found = compare_groups({name: each.reduced for name, each in fitted.items()}, tests, horizons=list(horizons),
                           starts=starts, seed=seed, outputs=outputs, noise=noise or None)
    reach = max(float(np.linalg.norm(run.read().observation[:, outputs], axis=1).max()) for run in tests)
    return Comparison(fitted, found, reach, {name: words for name, words in chosen.items() if words}, refused,
                      {name: seconds for name, seconds in cpu.items() if seconds})


def _by_name(models: Iterable | Mapping) -> dict[str, object]:
    """The requested models by the name that tables show. Raises ValueError for a kind that does not exist."""
    models = [models] if isinstance(models, (str, TrainedModel)) else models
    if isinstance(models, Mapping):
        asked = dict(models)
    else:
        asked = {each.upper() if isinstance(each, str) else getattr(each, "name", repr(each)): each for each in models}
    for each in asked.values():
        if not isinstance(each, (str, TrainedModel)):
            raise TypeError(f"{each!r} is not a model; expected a name of conf/model, or the result of fit or load")
        if isinstance(each, str):
            refuse_unknown_kind(each)
    return asked


def _trial(training: Sequence, timestep: float, outputs: Sequence[int], noise: float) -> Trial:
    """The folds on which baselines are tried: the folds of "auto", with the noise added to the windows of rollouts."""
    runs = [run.read() for run in training]
    decays, controlled = ([(run.observation, run.input) for run in runs if (run.kind == "decay") == decay]
                          for decay in (True, False))
    coordinates = offered(np.concatenate([run.observation for run in runs]))
    trial = Trial(Samples(decays, controlled, timestep, coordinates=coordinates, targets=outputs))
    if noise:
        rng = np.random.default_rng(0)
        *trial.held_out, trial.fast = (replace(each, window=each.window + rng.normal(0.0, noise, each.window.shape))
                                       for each in (*trial.held_out, trial.fast))
    return trial


def _fitted(kind, name: str, data: TrajectoryDataset, trial: Trial | None, card: dict, scored, noise: float,
            seed: int) -> tuple[TrainedModel, str]:
    """The fitted model, and a text on what was chosen."""
    if isinstance(kind, TrainedModel):
        return kind, ""
    if kind in KINDS and trial is not None:
        choice = choose_baseline(trial, kind)
        return _trained(choice, name, data, trial, card), str(choice)
    settings = {"fit.selection.noise": noise, "fit.selection.scored": scored,
                "fit.selection.progress": False} if kind == "auto" else {}
    model = fit(data, kind, seed=seed, name=name, progress=False, **settings)
    said = [line for report in model.report.values() for line in report["found"] or report["warnings"]]
    return model, said[0] if said else ""


def _trained(choice: BaselineChoice, name: str, data: TrajectoryDataset, trial: Trial, card: dict) -> TrainedModel:
    samples = trial.samples
    cost = {"state_dim": float(choice.model.state_dim), "fit_time": choice.cpu, "decays": float(len(samples.decays)),
            "controlled_samples": float(sum(len(y) for y, _ in samples.controlled))}
    origin = provenance() | {"training": provenance({"chosen": str(choice)}), "data": data.provenance}
    return TrainedModel(choice.model, card | {"name": name, "cost": cost, "scores": {}, "provenance": origin})
