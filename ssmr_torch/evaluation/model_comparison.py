"""`Comparison`: the result of `compare`, with tables by group of runs, the chosen form of each model, and a figure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from html import escape
from math import isfinite

import numpy as np

from ssmr_torch import data_sheet as sheet
from ssmr_torch.evaluation.comparison_tables import BEST, LEGEND, marks, starts_of, stored, table_rows
from ssmr_torch.evaluation.horizon_scores import HorizonScore, OpenLoopScore
from ssmr_torch.evaluation.run_groups import GroupedScores
from ssmr_torch.trained_model import TrainedModel


@dataclass(frozen=True, eq=False)
class Comparison:
    """Scores of several models, persistence and constant velocity from the same starts; `ssmr_torch.compare` makes one.

    models: the models by name. chosen: a text on the chosen form of each; refused: kinds that could not be fitted, and
    why. found: the scores by group of runs, m. reach: the largest ‖y‖ of the test runs over the scored outputs, m. cpu:
    CPU time of each choice and fit, s.

    It prints as one table per group: mean error in mm by horizon, share of diverged rollouts, error over the longest
    horizon in % of the reach, CPU time; then the chosen forms.
    """

    models: Mapping[str, TrainedModel]
    found: GroupedScores
    reach: float
    chosen: Mapping[str, str] = field(default_factory=dict)
    refused: Mapping[str, str] = field(default_factory=dict)
    cpu: Mapping[str, float] = field(default_factory=dict)

    @cached_property
    def groups(self) -> dict[str, dict[str, OpenLoopScore]]:
        """Scores by group and model, over the requested horizons."""
        return {group: {name: _without_full(score) for name, score in scores.items()}
                for group, scores in self.found.groups.items()}

    def standing(self, name: str) -> dict[str, dict[str, str]]:
        """By group and horizon: "*" if the model is best, "=" if it is tied with the best, otherwise ""."""
        return {group: marks(scores)[name] for group, scores in self.groups.items()}

    def share_of_reach(self, name: str, group: str) -> float:
        """Mean error over the longest horizon divided by the reach, no unit; infinite if a rollout diverged."""
        return self.groups[group][name].horizons[-1].mean / self.reach

    def diverged(self, name: str) -> float:
        """Largest share of diverged rollouts in any group and horizon."""
        return max(_diverged(scores[name]) for scores in self.groups.values())

    def rows(self, group: str) -> list[list[str]]:
        """Header, and a row per model: mean in mm and mark by horizon, share of diverged rollouts, % of reach, CPU
        time.
        """
        scores = self.groups[group]
        parts = next(iter(scores.values())).horizons
        header = ["model", *(part.label for part in parts), "diverged", f"of reach, {parts[-1].label}", "fit (CPU)"]
        every = [each for score in scores.values() for each in (score, score.noisy) if each is not None]
        found = [header]
        for row, score in zip(table_rows(scores, _mean), every):
            seconds = self.cpu.get(row[0])
            found.append([*row, f"{100 * _diverged(score):.3g} %", _percent(score.horizons[-1].mean / self.reach),
                          "–" if seconds is None else f"{seconds:.0f} s"])
        return found

    def caption(self, group: str) -> str:
        count = self.found.sizes[group]
        first = next(iter(self.groups[group].values()))
        return f"{group}, {count} {'run' if count == 1 else 'runs'}; n = {starts_of(first)} starts"

    @property
    def legend(self) -> str:
        return (f"Mean RMSE in mm; reach {1e3 * self.reach:.3g} mm, the largest displacement of the test runs; ∞: a "
                f"rollout diverged; {LEGEND}; one training per model.")

    @property
    def words(self) -> list[str]:
        """One line per model: its chosen form, or why it was refused."""
        return [*(f"{name}: {each}" for name, each in self.chosen.items()),
                *(f"{name} was refused: {why}" for name, why in self.refused.items())]

    def __repr__(self) -> str:
        parts = [f"{self.caption(group)}\n{sheet.columns(self.rows(group))}" for group in self.groups]
        return "\n\n".join([*parts, self.legend, "\n".join(self.words)])

    def _repr_html_(self) -> str:
        tables = "".join(sheet.html_columns(self.rows(group), self.caption(group)) for group in self.groups)
        return f"{tables}<p>{escape(self.legend)}</p>" + "".join(f"<p>{escape(line)}</p>" for line in self.words)

    @property
    def markdown(self) -> str:
        """The same text as Markdown."""
        parts = []
        for group in self.groups:
            head, *body = self.rows(group)
            lines = [f"| {' | '.join(row)} |" for row in (head, ["---"] * len(head), *body)]
            parts.append("\n".join([f"## {self.caption(group)}", "", *lines]))
        chosen = "\n".join(f"- {line}" for line in self.words)
        return "\n\n".join(["# Models at their best", self.legend, *parts, "## What was chosen", chosen]) + "\n"

    def as_dict(self) -> dict:
        """Plain JSON values in m and s; infinite errors become None."""
        return stored(self.found) | {"reach": self.reach, "chosen": dict(self.chosen), "refused": dict(self.refused),
                                     "cpu": dict(self.cpu), "standing": {name: self.standing(name)
                                                                         for name in self.models}}

    def figure(self):
        """Figure of the mean error over the horizon, both logarithmic, one line per model, for all runs of
        `found.scores`.
        """
        from ssmr_torch.evaluation import figures

        scores = {name: _without_full(score) for name, score in self.found.scores.items()}
        horizons = np.array([part.duration for part in next(iter(scores.values())).horizons])
        return figures.error_over_horizon(horizons, {name: np.array([part.mean for part in score.horizons])
                                                     for name, score in scores.items()})

    def best_other(self, group: str, label: str, name: str) -> str:
        """The model with the lowest mean error except `name`, persistence and constant velocity."""
        others = [each for each in self.models if each != name]
        return min(others, key=lambda each: self.groups[group][each][label].mean)

    def behind(self, name: str) -> dict[str, list[str]]:
        """By group, the horizons at which the model is neither best nor tied. Groups with too few starts to decide are
        left out.
        """
        late = {}
        for group, scores in self.groups.items():
            found = marks(scores)
            told = {label for each in found.values() for label, mark in each.items() if mark == BEST}
            late[group] = [label for label, mark in found[name].items() if label in told and not mark]
        return late


def _without_full(score: OpenLoopScore) -> OpenLoopScore:
    """The score without full rollouts, because these are few and have different lengths."""
    kept = tuple(part for part in score.horizons if part.label != "full")
    return replace(score, horizons=kept, noisy=None if score.noisy is None else _without_full(score.noisy))


def _mean(part: HorizonScore) -> str:
    return f"{1e3 * part.mean:.3g}" if isfinite(part.mean) else "∞"


def _diverged(score: OpenLoopScore) -> float:
    return max(part.diverged for part in score.horizons)


def _percent(share: float) -> str:
    return f"{sheet.number(100 * share, 2)} %" if isfinite(share) else "∞"
