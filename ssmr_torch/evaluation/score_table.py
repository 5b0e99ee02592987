"""`score`: open-loop prediction errors of models and of two baselines, as a table."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from ssmr_torch import data_sheet as sheet
from ssmr_torch.deployment import artifact
from ssmr_torch.deployment.artifact import Artifact
from ssmr_torch.evaluation.bootstrap import Interval
from ssmr_torch.evaluation.comparison_tables import (
    CELLS,
    LEGEND,
    SHARES,
    difference,
    mean_and_median,
    starts_of,
    table_rows,
)
from ssmr_torch.evaluation.horizon_scores import OpenLoopScore
from ssmr_torch.evaluation.open_loop import HORIZONS
from ssmr_torch.evaluation.run_groups import GroupedScores, compare_groups
from ssmr_torch.trained_model import TrainedModel
from ssmr_torch.trajectory import TrajectoryDataset, refuse_other_data


class ScoreTable(Mapping):
    """Scores by model and horizon. `table["SSMR"]["200 ms"].mean` is an error in m, and so are .median and .p95; .nmte
    is the normalized mean trajectory error. `table["SSMR"].noisy["200 ms"]` is the same score with measurement noise.

    groups: a table for each group of runs, by name, if there are several groups (decays, smooth inputs, inputs of an
    MPC, …). The table itself is over all controlled runs, or over the decays if there are no others.

    It prints as a table of mean / median errors in mm, group by group.
    """

    def __init__(self, scores: Mapping[str, OpenLoopScore], runs: str, groups: Mapping[str, ScoreTable] | None = None):
        self._scores, self._runs, self.groups = dict(scores), runs, dict(groups or {})

    def __getitem__(self, model: str) -> OpenLoopScore:
        if model not in self._scores:
            raise KeyError(f"there is no model {model!r}; the models are {list(self._scores)}")
        return self._scores[model]

    def __iter__(self) -> Iterator[str]:
        return iter(self._scores)

    def __len__(self) -> int:
        return len(self._scores)

    @property
    def rows(self) -> list[list[str]]:
        """Header, then one row per model: mean / median in mm and NMTE at each horizon, marked where best or tied."""
        horizons = next(iter(self._scores.values())).horizons
        return [["model", *(part.label for part in horizons)], *table_rows(self._scores, mean_and_median)]

    @property
    def caption(self) -> str:
        return f"{self._counts}, {SHARES}; ∞: a rollout diverged; {LEGEND}"

    @property
    def _counts(self) -> str:
        first = next(iter(self._scores.values()))
        return f"{CELLS} over n = {starts_of(first)} starts of {self._runs}, one training per model"

    def difference(self, model: str, other: str, horizon: str) -> Interval:
        """Mean error of one model minus that of another over a horizon ("200 ms"), m, with its 95 % interval from a
        paired bootstrap over blocks of starts. If the interval contains zero, the two are tied.
        """
        return difference(self, model, other, horizon)

    @property
    def _shown(self) -> dict[str, ScoreTable]:
        """The groups; none of them if there are too many to read."""
        return self.groups if 1 < len(self.groups) <= sheet.MOST + 1 else {}

    def __repr__(self) -> str:
        if not self._shown:
            return f"{sheet.columns(self.rows)}\n{self.caption}"
        parts = [f"{name}\n{sheet.columns(each.rows)}\n{each._counts}" for name, each in self._shown.items()]
        return "\n\n".join([*parts, f"{SHARES}; ∞: a rollout diverged; {LEGEND}"])

    def _repr_html_(self) -> str:
        return "".join(sheet.html_columns(each.rows, f"{name}: {each.caption}")
                       for name, each in self._shown.items()) or sheet.html_columns(self.rows, self.caption)


def score(model: object, data: TrajectoryDataset, *, split: str = "test", kind: str | None = "controlled",
          horizons: Sequence[float] = HORIZONS, starts: int = 500, seed: int = 0, outputs: Sequence[str] | None = None,
          noise: float | None = None) -> ScoreTable:
    """Score a model, and persistence and constant velocity, by rollouts from the same measured starts of unseen runs.

        error of a start = √(1/H Σ_{k=1..H} ‖ŷ_k − y_k‖²), m, at every sample k of the recording

    model: the result of `fit` or `load`; several models as a list, or by name in a mapping. data: a TrajectoryDataset.
    split, kind: the runs that are scored. kind None: decays and controlled runs, scored separately. Without runs of
    this kind, all runs of the split are scored. Runs whose names differ only in a number form a group, which is also
    scored separately. horizons: s (use 0.1 as well if the model is for control); "full" is added, one rollout per run.
    starts: number of random starts per horizon; all, if there are fewer. outputs: names of the outputs that count.
    noise: m, standard deviation of measurement noise; a second score then has this noise on the windows at the starts.
    The inputs are those recorded. See `evaluation.open_loop.score_open_loop` for the rest.

    Raises ValueError if the outputs or inputs of the data differ from the model's, if there are no such runs, or if the
    runs are too short.

    >>> table = score(model, data, horizons=[0.2])              # an oscillator, which DMD can predict exactly
    >>> list(table)
    ['DMD', 'persistence', 'constant velocity']
    >>> for name, errors in table.items():
    ...     print(name, round(1e3 * errors["200 ms"].median), "mm")
    DMD 0 mm
    persistence 64 mm
    constant velocity 58 mm
    """
    refuse_other_data(data)
    models = _by_name(model)
    strange = [each for each in models.values() if not hasattr(each, "reduced")]
    if strange:
        raise TypeError(f"{strange[0]!r} is not a model; expected the result of fit or load, or several of them")
    names = {each.output_names for each in models.values() if isinstance(each, TrainedModel)}
    if len(names) > 1:
        raise ValueError(f"the models have different outputs {sorted(names)}; score only models with equal outputs "
                         "together")
    seen = data.observing(*names) if names else data
    for each in models.values():
        if isinstance(each, TrainedModel):
            artifact.check_source(Artifact(each.reduced, {**each.card, "units": {"input": each.input_unit}}), seen)
    runs = seen.select(split, kind) or seen.select(split)
    runs = runs if kind == "static" else tuple(run for run in runs if run.kind != "static")
    if not runs:
        there = sorted({f"{run.kind}, {run.split}" for run in seen})
        raise ValueError(f"the data have no run of split={split!r} to score; they have {there}. Add test=[…] runs, or "
                         "choose another split")
    found = compare_groups({name: each.reduced for name, each in models.items()}, runs, horizons=list(horizons),
                           starts=starts, seed=seed, outputs=seen.columns(outputs), noise=noise)
    return _table(found, split)


def _table(found: GroupedScores, split: str) -> ScoreTable:
    def counted(number: int) -> str:
        return f"{number} {split} {'run' if number == 1 else 'runs'}"

    groups = {name: ScoreTable(scores, counted(found.sizes[name])) for name, scores in found.groups.items()}
    return ScoreTable(found.scores, counted(found.size), groups)


def _by_name(model) -> dict:
    if isinstance(model, Mapping):
        return dict(model)
    models: dict = {}
    for each in model if isinstance(model, (list, tuple)) else [model]:
        name = each.name if isinstance(each, TrainedModel) else type(each).__name__
        models[name if name not in models else f"{name} {len(models) + 1}"] = each
    return models
