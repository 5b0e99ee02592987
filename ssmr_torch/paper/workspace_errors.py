"""Open-loop errors over the workspace (paper, Fig. 4 and 5)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ssmr_torch.data.starts import draw_starts, samples_within
from ssmr_torch.evaluation.measured_rollouts import JoinedRuns
from ssmr_torch.evaluation.open_loop import HORIZONS, OpenLoopScore, compare_open_loop


@dataclass(frozen=True, eq=False)
class OpenLoopMap:
    """scores: of all models and both baselines; position (S, q): outputs at each start, m; errors: by model, (S,) m,
    RMSE over the first horizon from that start, infinite where the rollout diverged.
    """

    scores: Mapping[str, OpenLoopScore]
    position: np.ndarray
    errors: Mapping[str, np.ndarray]


def map_open_loop(models: Mapping[str, object], runs: Sequence, *, outputs: Sequence[int], starts: int = 500,
                  seed: int = 0, horizons: Sequence[float] = HORIZONS) -> OpenLoopMap:
    """`compare_open_loop` with where each rollout of the first horizon started; arguments and errors are its.

    outputs: columns that are scored and whose position is kept.
    """
    runs = [run.read() for run in runs]
    scores = compare_open_loop(models, runs, horizons=horizons, starts=starts, seed=seed, outputs=outputs)
    joined = JoinedRuns.of(runs)
    margin = next(iter(scores.values())).margin
    span = samples_within(horizons[0], joined.timestep)
    owner, sample = draw_starts(joined.lengths, margin, span, starts, seed)
    position = joined.observation[joined.offsets[owner] + sample][:, list(outputs)]
    return OpenLoopMap(scores, position, {name: scores[name].horizons[0].errors for name in models})
