"""Open-loop scores: rollouts from many measured starts, with the same starts for every model and baseline.

Trajectories ─draw starts→ windows and inputs ─predict→ ŷ_1, …, ŷ_H ─against what was measured→ OpenLoopScore
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from ssmr_torch.data.starts import starts_over
from ssmr_torch.evaluation.horizon_scores import HorizonScore, OpenLoopScore
from ssmr_torch.evaluation.measured_rollouts import Forecaster, JoinedRuns, noisy
from ssmr_torch.evaluation.metrics import rollout_nmte, rollout_rmse
from ssmr_torch.models.integrators import DIVERGENCE_FACTOR
from ssmr_torch.models.predictors import BASELINES, as_predictor

HORIZONS = (0.05, 0.2, 1.0)
SAMPLES_PER_BLOCK = 1 << 16


def score_open_loop(model, trajectories: Iterable, *, horizons: Sequence[float] = HORIZONS,
                    starts: int = 500, seed: int = 0, margin: int | None = None,
                    outputs: Sequence[int] | None = None, noise: float | None = None) -> OpenLoopScore:
    """Roll the model out from measured starts, and compare the predictions with the measurement.

        error of a start = √(1/H Σ_{k=1..H} ‖ŷ_k − y_k‖²) over the columns `outputs` (default all), m

    model: a `Model`, an object with a model as its `reduced` (a Torch module, a trained model), or a `Predictor`.
    horizons: s. For each horizon, `starts` different samples are drawn at random, or all if there are fewer. A start
    has `margin` samples before it (default: as many as the window needs, at least 1) and the horizon after it in its
    trajectory. The draw depends on seed, margin and trajectories, not on the model. "full" is one rollout per
    trajectory, from sample `margin` to the end. k counts samples of the runs for every model. If a step of the
    model covers several samples, it takes the mean input over the step, and its outputs are interpolated linearly in
    between, beginning with the decoded initial state (`predictors.at_every_sample`).
    noise: standard deviation, m, of white noise added to the windows at the starts, as in closed loop. The score with
    noise is the field `noisy` of the score without it. Both use the same starts and are compared with the clean
    outputs. A rollout has diverged if the model says so, if a prediction is not finite, or if ‖ŷ‖ over all outputs
    exceeds 10 times the largest measured ‖y‖. Raises ValueError if timesteps or columns do not match, if no trajectory
    is long enough, or if noise is not positive.
    """
    if noise is not None and not (math.isfinite(noise) and noise > 0):
        raise ValueError(f"noise is {noise} m; expected a positive standard deviation, or None for windows as measured")
    runs = [trajectory.read() for trajectory in trajectories]
    joined, predictor = JoinedRuns.of(runs), as_predictor(model)
    options = {"horizons": horizons, "starts": starts, "seed": seed, "margin": margin, "outputs": outputs}
    score = _score(Forecaster(predictor, joined), **options)
    if noise is None:
        return score
    measured = Forecaster(predictor, JoinedRuns.of(runs, noisy(runs, noise, seed)))
    return replace(score, noisy=replace(_score(measured, **options), noise=float(noise)))


def score_horizons(forecaster: Forecaster, horizons: Sequence[float], *, starts: int = 500, seed: int = 0,
                   margin: int | None = None, outputs: Sequence[int] | None = None) -> tuple[HorizonScore, ...]:
    """Only the scores over `horizons`, for repeated scoring. Options and errors are those of `score_open_loop`."""
    if not horizons:
        raise ValueError("no horizons were given; expected at least one, in s")
    margin = forecaster.margin if margin is None else margin
    if margin < forecaster.margin:
        raise ValueError(f"margin is {margin} samples, but the model needs {forecaster.margin} samples before a start "
                         f"({forecaster.predictor.delays} delays of {forecaster.window_stride} samples)")
    columns = _columns(outputs, forecaster.runs.observation.shape[1])
    return tuple(_score_horizon(forecaster, horizon, starts, seed, margin, columns) for horizon in horizons)


def compare_open_loop(models: Mapping[str, object], trajectories: Iterable, *, margin: int | None = None,
                      **options) -> dict[str, OpenLoopScore]:
    """Scores of all models and both baselines, from the same starts and at the same instants.

    The common margin is that of the longest window, unless a larger one is given. Options and errors are those of
    `score_open_loop`.
    """
    clash = sorted(set(models) & set(BASELINES))
    if clash:
        raise ValueError(f"models are named {clash}, but these are names of the baselines; choose other names")
    runs = [trajectory.read() for trajectory in trajectories]
    if margin is None:
        margin = common_margin(models, runs)
    timestep = JoinedRuns.of(runs).timestep
    predictors = {**models, **{name: baseline(timestep) for name, baseline in BASELINES.items()}}
    return {name: score_open_loop(predictor, runs, margin=margin, **options)
            for name, predictor in predictors.items()}


def common_margin(models: Mapping[str, object], runs: Sequence) -> int:
    """Samples before every start that the longest window of the models and baselines needs."""
    joined = JoinedRuns.of(runs)
    predictors = [*map(as_predictor, models.values()), *(each(joined.timestep) for each in BASELINES.values())]
    return max(Forecaster(predictor, joined).reach for predictor in predictors)


def _score(forecaster: Forecaster, *, horizons: Sequence[float], starts: int, seed: int, margin: int | None,
           outputs: Sequence[int] | None) -> OpenLoopScore:
    margin = forecaster.margin if margin is None else margin
    columns = _columns(outputs, forecaster.runs.observation.shape[1])
    scores = score_horizons(forecaster, horizons, starts=starts, seed=seed, margin=margin, outputs=outputs)
    return OpenLoopScore((*scores, _score_full(forecaster, margin, columns)), margin, seed, tuple(columns.tolist()))


def _score_horizon(forecaster: Forecaster, horizon: float, starts: int, seed: int, margin: int,
                   columns: np.ndarray) -> HorizonScore:
    joined = forecaster.runs
    owner, sample, steps = starts_over(joined.lengths, horizon, joined.timestep, margin=margin, count=starts,
                                       seed=seed)
    return _rolled_out(forecaster, _label(horizon), owner, sample, np.full(len(owner), steps), columns, margin + steps)


def _score_full(forecaster: Forecaster, margin: int, columns: np.ndarray) -> HorizonScore:
    lengths = forecaster.runs.lengths
    steps = lengths - 1 - margin
    owner = np.flatnonzero(steps >= 1)
    if not len(owner):
        raise ValueError(f"the longest trajectory has {lengths.max()} samples; a full rollout needs {margin + 2}: "
                         f"{margin} before its start, the start, and 1 after it")
    return _rolled_out(forecaster, "full", owner, np.full(len(owner), margin), steps[owner], columns, margin + 1)


def _rolled_out(forecaster: Forecaster, label: str, owner: np.ndarray, sample: np.ndarray, steps: np.ndarray,
                columns: np.ndarray, needed: int) -> HorizonScore:
    """The score of these starts. Trajectories of up to `needed` samples count as too short."""
    joined, longest = forecaster.runs, int(steps.max())
    short = tuple(np.flatnonzero(joined.lengths <= needed).tolist())
    errors, output_errors, trajectory_errors = _errors(forecaster, owner, sample, steps, columns)
    return HorizonScore(label, longest, longest * joined.timestep, errors, output_errors, len(short),
                        trajectory_errors, owner, sample, short)


def _errors(forecaster: Forecaster, owner: np.ndarray, sample: np.ndarray, steps: np.ndarray,
            columns: np.ndarray) -> tuple[np.ndarray, ...]:
    """Error (N,), error per output (N, outputs) and normalized mean trajectory error (N,) of every start.

    They are computed in blocks, to limit the memory.
    """
    joined = forecaster.runs
    bound = DIVERGENCE_FACTOR * np.linalg.norm(joined.observation, axis=-1).max()
    sizes = np.maximum.reduceat(np.linalg.norm(joined.observation[:, columns], axis=-1), joined.offsets)
    rows = max(1, SAMPLES_PER_BLOCK // int(steps.max()))
    found = []
    for block in (slice(first, first + rows) for first in range(0, len(owner), rows)):
        predicted, measured = forecaster(owner[block], sample[block], steps[block])
        counted = np.arange(1, predicted.shape[1] + 1) <= steps[block, None]
        with np.errstate(over="ignore", invalid="ignore"):
            diverged = (counted & ~(np.linalg.norm(predicted, axis=-1) <= bound)).any(axis=-1)
        predicted, measured = predicted[..., columns], measured[..., columns]
        each = [rollout_rmse(predicted[..., [j]], measured[..., [j]], steps[block])
                for j in range(len(columns))]
        errors = [rollout_rmse(predicted, measured, steps[block]), np.stack(each, axis=-1),
                  rollout_nmte(predicted, measured, sizes[owner[block]], steps[block])]
        found.append([np.where(diverged.reshape(-1, *[1] * (values.ndim - 1)), np.inf, values) for values in errors])
    return tuple(map(np.concatenate, zip(*found)))


def _columns(outputs: Sequence[int] | None, available: int) -> np.ndarray:
    columns = np.arange(available) if outputs is None else np.asarray(outputs, dtype=np.int64)
    if columns.ndim != 1 or not len(columns) or columns.min() < 0 or columns.max() >= available:
        raise ValueError(f"outputs {outputs}; expected indices from 0 to {available - 1}")
    return columns


def _label(seconds: float) -> str:
    return f"{seconds:g} s" if seconds >= 1 else f"{1e3 * seconds:g} ms"
