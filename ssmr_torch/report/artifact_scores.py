"""Open-loop scores of artifacts on the runs of a dataset: the table, the files, the figures."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from ssmr_torch.deployment import artifact
from ssmr_torch.evaluation import figures
from ssmr_torch.evaluation.comparison_tables import comparison_table, format_groups, stored
from ssmr_torch.evaluation.run_groups import GroupedScores, compare_groups
from ssmr_torch.report.run_sections import prediction_figures
from ssmr_torch.result_files import save_json, save_text
from ssmr_torch.trajectory import TrajectoryDataset

DECISIVE = -2  # the horizon, of those that were asked for and the full rollout, whose mean error is the metric


@dataclass(frozen=True)
class ArtifactScores:
    """models: by name.   outputs: columns of the scored outputs.   origin: hash of each artifact, the data's origin."""

    models: Mapping[str, object]
    costs: Mapping[str, Mapping]
    found: GroupedScores
    runs: Sequence
    output_names: Sequence[str]
    outputs: Sequence[int]
    origin: Mapping

    @property
    def table(self) -> str:
        """All scores as text."""
        return format_groups(self.found)

    @property
    def metrics(self) -> dict[str, float]:
        """Mean error, m, of each model over each horizon."""
        return {f"{name}, {part.label}": part.mean for name in self.models
                for part in self.found.scores[name].horizons}

    @property
    def metric(self) -> float:
        """Mean error of the first model over the longest horizon that was asked for, m."""
        return self.found.scores[next(iter(self.models))].horizons[DECISIVE].mean

    def save(self, directory: Path, provenance: Mapping) -> Path:
        """scores.txt, comparison.md, scores.json, and the figures; returns the path of scores.json."""
        save_text(directory / "scores.txt", self.table + "\n")
        save_text(directory / "comparison.md", comparison_table(self.found.scores, self.costs) + "\n")
        drawn = prediction_figures(self.models, self.found.scores, self.runs, self.output_names, self.outputs)
        for name, figure in drawn.items():
            figures.save(figure, directory / f"{name}.svg")
        return save_json(directory / "scores.json", stored(self.found) | {"provenance": {**provenance, **self.origin}})


def score_artifacts(paths: Sequence[str], read: Callable[[], TrajectoryDataset], *, split: str | None,
                    kind: str | None, outputs: Sequence[str] | None, **options) -> ArtifactScores:
    """Score artifacts on the same starts of the runs with this split and kind (None: all).

    read: called for the dataset when the artifacts are loaded.   outputs: names of those that are scored; None: all.
    options: of `compare_groups`.   Raises ValueError where the artifacts observe different outputs, were trained on
    another robot's, or no run has the split and kind.
    """
    loaded = [artifact.load(path) for path in paths]
    models = artifact.by_name(loaded)
    dataset = read().observing(artifact.common_outputs(loaded))
    for each in loaded:
        artifact.check_source(each, dataset)
    runs = dataset.select(split, kind)
    if not runs:
        raise ValueError(f"no trajectory has split={split} and kind={kind}; there are "
                         f"{sorted({(run.split, run.kind) for run in dataset})}")
    columns = dataset.columns(outputs)
    return ArtifactScores(
        models, {name: each.card.get("cost", {}) for name, each in zip(models, loaded)},
        compare_groups(models, runs, outputs=columns, **options), runs, dataset.output_names, columns,
        {"artifacts": {name: each.card["sha256"] for name, each in zip(models, loaded)}, "data": dataset.provenance})
