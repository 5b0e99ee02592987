"""How far models predict, beside the two baselines, as a table."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from ssmr_torch import artifact
from ssmr_torch import data_sheet as sheet
from ssmr_torch.artifact import Artifact
from ssmr_torch.evaluation.comparison import mean_and_median
from ssmr_torch.evaluation.open_loop import HORIZONS, OpenLoopScore, compare_open_loop
from ssmr_torch.trained_model import TrainedModel
from ssmr_torch.trajectory import refuse_other_data


class ScoreTable(Mapping):
    """Scores by model and horizon: `table["SSMR"]["200 ms"].mean` is an error in m, and so are .median and .p95.

    Prints itself as a table of mean / median errors in mm.
    """

    def __init__(self, scores: Mapping[str, OpenLoopScore], runs: str):
        self._scores, self._runs = dict(scores), runs

    def __getitem__(self, model: str) -> OpenLoopScore:
        if model not in self._scores:
            raise KeyError(f"no model {model!r}; there are {list(self._scores)}")
        return self._scores[model]

    def __iter__(self) -> Iterator[str]:
        return iter(self._scores)

    def __len__(self) -> int:
        return len(self._scores)

    @property
    def rows(self) -> list[list[str]]:
        """Header, then one row per model: mean / median in mm at each horizon."""
        horizons = next(iter(self._scores.values())).horizons
        return [["model", *(part.label for part in horizons)],
                *([name, *(mean_and_median(part) for part in score.horizons)] for name, score in self._scores.items())]

    @property
    def caption(self) -> str:
        starts = ", ".join(f"{len(part.errors)} ({part.label})" for part in next(iter(self._scores.values())).horizons)
        return f"mean / median RMSE in mm over n = {starts} starts of {self._runs}; ∞: a rollout diverged"

    def __repr__(self) -> str:
        return f"{sheet.columns(self.rows)}\n{self.caption}"

    def _repr_html_(self) -> str:
        return sheet.html_columns(self.rows, self.caption)


def score(model, data, *, split: str = "test", kind: str = "controlled", horizons: Sequence[float] = HORIZONS,
          starts: int = 500, seed: int = 0, outputs: Sequence[str] | None = None) -> ScoreTable:
    """Roll a model out from measured starts of unseen runs, and persistence and constant velocity from the same ones.

        error of a start = √(1/H Σ_{k=1..H} ‖ŷ_k − y_k‖²), m

    model: what `fit` or `load` returns; several as a list, or by name in a mapping. data: a TrajectoryDataset. split,
    kind: of the runs that are scored; where none is of this kind, those of the split. horizons: s; "full" is added, one
    rollout per run. starts: seeded samples per horizon, all where there are fewer. outputs: names of those that count.
    Inputs are the recorded ones, see `evaluation.open_loop.score_open_loop` for the rest.
    Raises ValueError for data of other outputs or inputs than the model's, without such runs, or runs that are too
    short.

    >>> table = score(model, data, horizons=[0.2])                          # of an oscillator, which DMD knows exactly
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
        raise TypeError(f"{strange[0]!r} is no model; expected what fit or load returns, or several of them")
    names = {each.output_names for each in models.values() if isinstance(each, TrainedModel)}
    if len(names) > 1:
        raise ValueError(f"the models observe different outputs {sorted(names)}; score those of the same ones together")
    seen = data.observing(*names) if names else data
    for each in models.values():
        if isinstance(each, TrainedModel):
            artifact.check_source(Artifact(each.reduced, {**each.card, "units": {"input": each.input_unit}}), seen)
    runs = seen.select(split, kind) or tuple(run for run in seen.select(split) if run.kind != "static")
    if not runs:
        there = sorted({f"{run.kind}, {run.split}" for run in seen})
        raise ValueError(f"the data have no run of split={split!r} to score on, only {there}; give test=[…] runs, or "
                         "another split")
    scores = compare_open_loop({name: each.reduced for name, each in models.items()}, runs, horizons=list(horizons),
                               starts=starts, seed=seed, outputs=seen.columns(outputs))
    return ScoreTable(scores, f"{len(runs)} {split} {'run' if len(runs) == 1 else 'runs'}")


def _by_name(model) -> dict:
    if isinstance(model, Mapping):
        return dict(model)
    models: dict = {}
    for each in model if isinstance(model, (list, tuple)) else [model]:
        name = each.name if isinstance(each, TrainedModel) else type(each).__name__
        models[name if name not in models else f"{name} {len(models) + 1}"] = each
    return models
