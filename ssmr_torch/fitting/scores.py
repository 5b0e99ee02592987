"""What a model in training is judged by: the open-loop score of evaluation, under the names that loggers show."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ssmr_torch.data.starts import ScoredRuns, samples_within
from ssmr_torch.evaluation.open_loop import score_horizons
from ssmr_torch.evaluation.predictors import as_predictor, persistence
from ssmr_torch.evaluation.rollouts import Forecaster, Recording

SHORTER = {"rmse_50ms": 0.05, "rmse_200ms": 0.2}  # s


def scores(model, scored: ScoredRuns) -> dict[str, float]:
    """rmse: mean error over the horizon, m, that of `score_open_loop` with these runs, starts and seed, infinite when a
    start diverges; rmse_median, and diverged, the share that does; rmse_50ms, rmse_200ms: over these shorter horizons,
    where they hold a step of the model; relative: geometric mean over the horizons of the error divided by that of
    persistence, ŷ_k = y_0, in which short and long ones count alike.
    """
    predictor, recording = as_predictor(model), Recording.of(scored.runs, scored.seen)
    horizons = {"rmse": scored.horizon} | {
        name: seconds for name, seconds in SHORTER.items()
        if seconds < scored.horizon and samples_within(seconds, predictor.timestep)}
    margin = Forecaster(predictor, recording).margin
    found, still = (
        score_horizons(Forecaster(each, recording), tuple(horizons.values()), starts=scored.starts, seed=scored.seed,
                       margin=margin) for each in (predictor, persistence(predictor.timestep)))
    values = {name: score.mean for name, score in zip(horizons, found)}
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = np.divide(list(values.values()), [score.mean for score in still])
        values["relative"] = float(np.exp(np.log(ratios).mean()))
    return values | {"rmse_median": found[0].median, "diverged": found[0].diverged}


def diverged_under_stress(model, scored: ScoredRuns, factor: float, speed: int) -> float:
    """Share of the rollouts that diverge under inputs `factor` times as strong, played `speed` times as fast."""
    predictor = as_predictor(model)

    def stressed(window, window_inputs, inputs):
        return predictor.predict(window, window_inputs, factor * hurried(inputs, speed))

    forecaster = Forecaster(replace(predictor, predict=stressed), Recording.of(scored.runs, scored.seen))
    return score_horizons(forecaster, (scored.horizon,), starts=scored.starts, seed=scored.seed)[0].diverged


def hurried(inputs: np.ndarray, factor: int) -> np.ndarray:
    """Inputs (N, H, m) played `factor` times as fast, forwards, backwards, … until H steps are full."""
    fast = inputs[:, ::factor]
    pieces = [fast[:, ::-1] if piece % 2 else fast for piece in range(factor)]
    return np.concatenate(pieces, axis=1)[:, :inputs.shape[1]]
