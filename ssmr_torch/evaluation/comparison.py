"""One table of many models: how far they predict, how sure, and what they cost."""

from __future__ import annotations

import math
from collections.abc import Mapping

from ssmr_torch.evaluation.open_loop import HorizonScore, OpenLoopScore


def comparison_table(scores: Mapping[str, OpenLoopScore], costs: Mapping[str, Mapping[str, float]]) -> str:
    """Markdown: mean / median error in mm per horizon, share of diverged rollouts over all horizons, state dimension,
    parameters and fit time. A mean is ∞ where a rollout diverged. costs: of `training.cost_of`, empty where unknown.
    """
    labels = [part.label for part in next(iter(scores.values())).horizons]
    header = ["model", *labels, "diverged", "n", "parameters", "fit"]
    lines = [" | ".join(header), " | ".join(["---"] * len(header))]
    for name, score in scores.items():
        cost = costs.get(name, {})
        worst = max(part.diverged for part in score.horizons)
        lines.append(" | ".join([name, *(mean_and_median(part) for part in score.horizons), f"{100 * worst:.3g} %",
                                 *(_number(cost.get(key)) for key in ("state_dim", "parameters")),
                                 f"{cost['fit_time']:.3g} s" if cost.get("fit_time") else "–"]))
    return "\n".join(f"| {line} |" for line in lines)


def mean_and_median(part: HorizonScore) -> str:
    """"mean / median" of one horizon in mm, three digits."""
    return f"{_millimetres(part.mean)} / {_millimetres(part.median)}"


def _millimetres(value: float) -> str:
    return f"{1e3 * value:.3g}" if math.isfinite(value) else "∞"


def _number(value: float | None) -> str:
    return "–" if not value else f"{value:.0f}"
