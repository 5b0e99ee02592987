"""What a model in training is judged by: the open-loop score of evaluation, under the names that loggers show."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ssmr_torch.data.starts import ScoredRuns, samples_within
from ssmr_torch.evaluation.measured_rollouts import Forecaster, JoinedRuns
from ssmr_torch.evaluation.open_loop import score_horizons
from ssmr_torch.evaluation.predictors import BASELINES, as_predictor

SHORTER = {"rmse_50ms": 0.05, "rmse_200ms": 0.2}  # s


def scores(model, scored: ScoredRuns) -> dict[str, float]:
    """rmse: mean error over the horizon, m, that of `score_open_loop` with these runs, starts and seed, infinite when a
    start diverges; rmse_median, and diverged, the share that does; rmse_50ms, rmse_200ms: over these shorter horizons,
    where they hold a sample; relative: geometric mean over the horizons of the error divided by that of
    persistence, ŷ_k = y_0, in which short and long ones count alike; rmse_persistence, rmse_constant_velocity: of the
    baselines from the same starts.

    All of them are of the controlled runs where any of these holds the horizon, for decays are many and easy, and a
    mean over both would be theirs. Those of decays beside them are rmse_decays and diverged_decays.
    """
    judged, beside = _apart(model, scored)
    forecaster = Forecaster(as_predictor(model), JoinedRuns.of(judged.runs, judged.seen))
    timestep, found = forecaster.runs.timestep, {}
    horizons = {"rmse": scored.horizon} | {name: seconds for name, seconds in SHORTER.items()
                                           if seconds < scored.horizon and samples_within(seconds, timestep)}
    baselines = {name: build(timestep) for name, build in BASELINES.items()}
    for name, each in {"": forecaster.predictor, **baselines}.items():
        found[name] = score_horizons(Forecaster(each, forecaster.runs), tuple(horizons.values()),
                                     starts=scored.starts, seed=scored.seed, margin=forecaster.margin)
    values = {name: score.mean for name, score in zip(horizons, found[""])}
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = np.divide(list(values.values()), [score.mean for score in found["persistence"]])
        values["relative"] = float(np.exp(np.log(ratios).mean()))
    values |= {"rmse_median": found[""][0].median, "diverged": found[""][0].diverged}
    values |= {f"rmse_{name.replace(' ', '_')}": found[name][0].mean for name in BASELINES}
    return values | _of_decays(model, beside)


def _of_decays(model, scored: ScoredRuns | None) -> dict[str, float]:
    if scored is None:
        return {}
    forecaster = Forecaster(as_predictor(model), JoinedRuns.of(scored.runs, scored.seen))
    found = score_horizons(forecaster, (scored.horizon,), starts=scored.starts, seed=scored.seed)[0]
    return {"rmse_decays": found.mean, "diverged_decays": found.diverged}


def _apart(model, scored: ScoredRuns) -> tuple[ScoredRuns, ScoredRuns | None]:
    """The controlled runs, and the decays, as far as any of them holds the horizon and a window; the decays first, and
    nothing beside them, where they are all.
    """
    needed = Forecaster(as_predictor(model), JoinedRuns.of(scored.runs, scored.seen)).margin
    parts = []
    for decays in (False, True):
        chosen = [number for number, run in enumerate(scored.runs) if (run.kind == "decay") == decays]
        if any(scored.runs[number].length > needed + samples_within(scored.horizon, scored.runs[number].timestep)
               for number in chosen):
            parts.append(replace(scored, runs=tuple(scored.runs[number] for number in chosen),
                                 seen=tuple(scored.seen[number] for number in chosen)))
    return (*parts, None)[:2] if parts else (scored, None)


def diverged_under_stress(model, scored: ScoredRuns, factor: float, speed: int) -> float:
    """Share of the rollouts that diverge under inputs `factor` times as strong, played `speed` times as fast; of the
    runs that `scores` judges by.
    """
    predictor, (judged, _) = as_predictor(model), _apart(model, scored)

    def stressed(window, window_inputs, inputs):
        return predictor.predict(window, window_inputs, factor * hurried(inputs, speed))

    forecaster = Forecaster(replace(predictor, predict=stressed), JoinedRuns.of(judged.runs, judged.seen))
    return score_horizons(forecaster, (scored.horizon,), starts=scored.starts, seed=scored.seed)[0].diverged


def hurried(inputs: np.ndarray, factor: int) -> np.ndarray:
    """Inputs (N, H, m) played `factor` times as fast, forwards, backwards, … until H steps are full."""
    fast = inputs[:, ::factor]
    pieces = [fast[:, ::-1] if piece % 2 else fast for piece in range(factor)]
    return np.concatenate(pieces, axis=1)[:, :inputs.shape[1]]
