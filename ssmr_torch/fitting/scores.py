"""Validation and test scores during training: open-loop prediction errors, under the names that loggers show."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ssmr_torch.data.starts import ScoredRuns, samples_within
from ssmr_torch.evaluation.measured_rollouts import Forecaster, JoinedRuns
from ssmr_torch.evaluation.open_loop import score_horizons
from ssmr_torch.models.predictors import BASELINES, as_predictor

SHORTER = {"rmse_50ms": 0.05, "rmse_200ms": 0.2}  # s


def scores(model, scored: ScoredRuns) -> dict[str, float]:
    """Scores of a model, by name.

    rmse: mean error over the horizon, m, as in `score_open_loop` with the same runs, starts and seed; infinite if a
    start diverges. rmse_median: its median. diverged: share of starts that diverge.
    rmse_50ms, rmse_200ms: rmse over these shorter horizons, if they contain a sample.
    relative: geometric mean, over the horizons, of the error divided by the error of persistence, ŷ_k = y_0. Short and
    long horizons have the same weight in it.
    rmse_persistence, rmse_constant_velocity: errors of these baselines from the same starts.

    All these scores use the controlled runs, if any of them is as long as the horizon. Decays are many and easy to
    predict, so that they would dominate a common mean. Their scores are rmse_decays and diverged_decays.
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
    """Controlled runs and decays, each only if at least one of its runs is as long as the horizon and a window.

    Without controlled runs, the decays come first, with None after them.
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
    """Share of the rollouts that diverge under inputs `factor` times larger and played `speed` times faster, for the
    same runs as in `scores`.
    """
    predictor, (judged, _) = as_predictor(model), _apart(model, scored)

    def stressed(window, window_inputs, inputs):
        return predictor.predict(window, window_inputs, factor * hurried(inputs, speed))

    forecaster = Forecaster(replace(predictor, predict=stressed), JoinedRuns.of(judged.runs, judged.seen))
    return score_horizons(forecaster, (scored.horizon,), starts=scored.starts, seed=scored.seed)[0].diverged


def hurried(inputs: np.ndarray, factor: int) -> np.ndarray:
    """Inputs (N, H, m) played `factor` times faster: forwards, then backwards, and so on, until H steps are filled."""
    fast = inputs[:, ::factor]
    pieces = [fast[:, ::-1] if piece % 2 else fast for piece in range(factor)]
    return np.concatenate(pieces, axis=1)[:, :inputs.shape[1]]
