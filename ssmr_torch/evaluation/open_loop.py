"""How far models predict: rollouts from many measured starts, every model and baseline from the same ones.

Trajectories ─draw starts→ windows and inputs ─predict→ ŷ_1, …, ŷ_H ─against what was measured→ OpenLoopScore
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ssmr_torch.data.starts import samples_within, starts_over
from ssmr_torch.evaluation.metrics import rollout_rmse
from ssmr_torch.evaluation.predictors import BASELINES, as_predictor
from ssmr_torch.evaluation.rollouts import Forecaster, Recording
from ssmr_torch.models.integrators import DIVERGENCE_FACTOR

HORIZONS = (0.05, 0.2, 1.0)
SAMPLES_PER_BLOCK = 1 << 16


@dataclass(frozen=True, eq=False)
class HorizonScore:
    """Errors √(mean_k ‖ŷ_k − y_k‖²) of the rollouts over one horizon, m; infinite for a diverged rollout.

    label: "50 ms", …, or "full"; steps: of the model per rollout, duration: their length in s (the longest's,
    for "full"). errors: (N,), one per start; output_errors: (N, outputs), the same per output.
    skipped: number of trajectories that are too short.
    """

    label: str
    steps: int
    duration: float
    errors: np.ndarray
    output_errors: np.ndarray
    skipped: int

    @property
    def diverged(self) -> float:
        """Share of diverged rollouts."""
        return float(np.isinf(self.errors).mean())

    @property
    def mean(self) -> float:
        """Mean over all starts, m; infinite when one diverged."""
        return float(self.errors.mean())

    @property
    def mean_of_survivors(self) -> float:
        """Mean over the starts that did not diverge, m; infinite when all did. Quote it with `diverged`."""
        survivors = self.errors[np.isfinite(self.errors)]
        return float(survivors.mean()) if len(survivors) else math.inf

    @property
    def median(self) -> float:
        """Median over all starts, m."""
        return float(np.median(self.errors))

    @property
    def p95(self) -> float:
        """Smallest error, m, that 95 % of all starts do not exceed."""
        return float(np.quantile(self.errors, 0.95, method="inverted_cdf"))

    def as_dict(self) -> dict:
        """Plain JSON values, m and s; infinite ones are None."""
        return {"label": self.label, "steps": self.steps, "duration": self.duration,
                "starts": len(self.errors), "skipped_trajectories": self.skipped, "diverged": self.diverged,
                "mean": _finite_or_none(self.mean), "median": _finite_or_none(self.median),
                "p95": _finite_or_none(self.p95),
                "mean_of_survivors": _finite_or_none(self.mean_of_survivors),
                "mean_per_output": [_finite_or_none(value) for value in self.output_errors.mean(axis=0)]}


@dataclass(frozen=True, eq=False)
class OpenLoopScore:
    """One score per horizon, the last over full trajectories; margin, seed and columns as they were given."""

    horizons: tuple[HorizonScore, ...]
    margin: int
    seed: int
    outputs: tuple[int, ...]

    def __getitem__(self, label: str) -> HorizonScore:
        """The score of "50 ms", "1 s", "full", …"""
        for score in self.horizons:
            if score.label == label:
                return score
        raise KeyError(f"no horizon {label!r}; there are {[score.label for score in self.horizons]}")

    def as_dict(self) -> dict:
        """Plain JSON values, m and s; infinite ones are None."""
        return {"unit": "m", "margin": self.margin, "seed": self.seed, "outputs": list(self.outputs),
                "horizons": [score.as_dict() for score in self.horizons]}


def score_open_loop(model, trajectories: Iterable, *, horizons: Sequence[float] = HORIZONS,
                    starts: int = 500, seed: int = 0, margin: int | None = None,
                    outputs: Sequence[int] | None = None) -> OpenLoopScore:
    """Roll the model out from measured starts and compare with what was measured.

        error of a start = √(1/H Σ_{k=1..H} ‖ŷ_k − y_k‖²) over the columns `outputs` (default all), m

    model: a `Model`, who offers one (`reduced`: a Torch module, a trained model), or a `Predictor`. horizons: s.
    Per horizon, `starts` different samples (all, where there are fewer) are drawn uniformly over those with
    `margin` samples before them (default: what the window needs, at least 1) and the horizon after them in
    their trajectory; the draw depends on seed, margin and trajectories, not on the model. "full" is one
    rollout per trajectory, from sample `margin` to the end. A model that steps by several samples is compared
    at its own steps (`duration` says how much of the horizon they cover) and sees the mean input over each.
    A rollout has diverged when the model says so, a prediction is not finite, or ‖ŷ‖ over all
    outputs exceeds 10 times the largest measured ‖y‖. Raises ValueError when timesteps or columns do not
    match or no trajectory is long enough.
    """
    recording = Recording.of(trajectories)
    forecaster = Forecaster(as_predictor(model), recording)
    margin = forecaster.margin if margin is None else margin
    columns = _columns(outputs, recording.observation.shape[1])
    scores = score_horizons(forecaster, horizons, starts=starts, seed=seed, margin=margin, outputs=outputs)
    return OpenLoopScore((*scores, _score_full(forecaster, margin, columns)), margin, seed, tuple(columns.tolist()))


def score_horizons(forecaster: Forecaster, horizons: Sequence[float], *, starts: int = 500, seed: int = 0,
                   margin: int | None = None, outputs: Sequence[int] | None = None) -> tuple[HorizonScore, ...]:
    """The scores over `horizons` alone, for what is scored again and again; options and errors are those of
    `score_open_loop`.
    """
    if not horizons:
        raise ValueError("no horizons were given; expected at least one, in s")
    margin = forecaster.margin if margin is None else margin
    if margin < forecaster.margin:
        raise ValueError(f"margin is {margin} samples, but the model needs {forecaster.margin} before a start "
                         f"({forecaster.predictor.delays} delays of {forecaster.window_stride} samples)")
    columns = _columns(outputs, forecaster.recording.observation.shape[1])
    return tuple(_score_horizon(forecaster, horizon, starts, seed, margin, columns) for horizon in horizons)


def compare_open_loop(models: Mapping[str, object], trajectories: Iterable, *, margin: int | None = None,
                      **options) -> dict[str, OpenLoopScore]:
    """Scores of all models and both baselines from the same starts; options and errors are those of
    `score_open_loop`.

    The common margin is what the longest window needs, unless a larger one is given.
    """
    clash = sorted(set(models) & set(BASELINES))
    if clash:
        raise ValueError(f"models named {clash}; the baselines have these names, choose others")
    runs = [trajectory.read() for trajectory in trajectories]
    recording = Recording.of(runs)
    predictors = {name: as_predictor(model) for name, model in models.items()}
    predictors |= {name: baseline(recording.timestep) for name, baseline in BASELINES.items()}
    if margin is None:
        margin = max(Forecaster(predictor, recording).reach for predictor in predictors.values())
    return {name: score_open_loop(predictor, runs, margin=margin, **options)
            for name, predictor in predictors.items()}


def format_table(scores: Mapping[str, OpenLoopScore]) -> str:
    """Mean error in mm per model and horizon, as text; ∞ where one diverged, with the share and the others'
    mean.

    Raises ValueError when the models were not scored over the same horizons from the same starts.
    """
    first = next(iter(scores.values()))
    for name, score in scores.items():
        if _setting(score) != _setting(first):
            raise ValueError(f"{name!r} was scored over {_setting(score)}, the first model over "
                             f"{_setting(first)} (horizons and starts, margin, seed, outputs); "
                             "use compare_open_loop")
    rows = [["model", *(part.label for part in first.horizons)]]
    rows += [[name, *(_cell(part) for part in score.horizons)] for name, score in scores.items()]
    widths = [max(map(len, column)) for column in zip(*rows)]
    lines = ["  ".join(cell.rjust(width) if column else cell.ljust(width)
                       for column, (cell, width) in enumerate(zip(row, widths))) for row in rows]
    starts = ", ".join(f"{len(part.errors)} ({part.label})" for part in first.horizons)
    note = f"mean RMSE in mm over n = {starts} starts; ∞: some diverged (their share, mean of the others)"
    return "\n".join([lines[0], "-" * len(lines[0]), *lines[1:], note])


def _score_horizon(forecaster: Forecaster, horizon: float, starts: int, seed: int, margin: int,
                   columns: np.ndarray) -> HorizonScore:
    recording, stride = forecaster.recording, forecaster.stride
    owner, sample, steps = starts_over(recording.lengths, horizon, recording.timestep, stride, margin=margin,
                                       count=starts, seed=seed)
    errors = _errors(forecaster, owner, sample, np.full(len(owner), steps), columns)
    skipped = int((recording.lengths < margin + samples_within(horizon, recording.timestep) + 1).sum())
    return HorizonScore(_label(horizon), steps, steps * stride * recording.timestep, *errors, skipped)


def _score_full(forecaster: Forecaster, margin: int, columns: np.ndarray) -> HorizonScore:
    recording, stride = forecaster.recording, forecaster.stride
    steps = (recording.lengths - 1 - margin) // stride
    owner = np.flatnonzero(steps >= 1)
    if not len(owner):
        raise ValueError(f"the longest trajectory has {recording.lengths.max()} samples; a full rollout "
                         f"needs {margin} before its start and {stride} after")
    errors = _errors(forecaster, owner, np.full(len(owner), margin), steps[owner], columns)
    longest = int(steps.max())
    skipped = int((steps < 1).sum())
    return HorizonScore("full", longest, longest * stride * recording.timestep, *errors, skipped)


def _errors(forecaster: Forecaster, owner: np.ndarray, sample: np.ndarray, steps: np.ndarray,
            columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Error (N,) and error per output (N, outputs) of every start, in blocks so that memory stays bounded."""
    bound = DIVERGENCE_FACTOR * np.linalg.norm(forecaster.recording.observation, axis=-1).max()
    rows = max(1, SAMPLES_PER_BLOCK // int(steps.max()))
    errors, output_errors = [], []
    for block in (slice(first, first + rows) for first in range(0, len(owner), rows)):
        predicted, measured = forecaster(owner[block], sample[block], steps[block])
        counted = np.arange(1, predicted.shape[1] + 1) <= steps[block, None]
        with np.errstate(over="ignore", invalid="ignore"):
            diverged = (counted & ~(np.linalg.norm(predicted, axis=-1) <= bound)).any(axis=-1)
        predicted, measured = predicted[..., columns], measured[..., columns]
        each = [rollout_rmse(predicted[..., [j]], measured[..., [j]], steps[block])
                for j in range(len(columns))]
        errors.append(np.where(diverged, np.inf, rollout_rmse(predicted, measured, steps[block])))
        output_errors.append(np.where(diverged[:, None], np.inf, np.stack(each, axis=-1)))
    return np.concatenate(errors), np.concatenate(output_errors)


def _columns(outputs: Sequence[int] | None, available: int) -> np.ndarray:
    columns = np.arange(available) if outputs is None else np.asarray(outputs, dtype=np.int64)
    if columns.ndim != 1 or not len(columns) or columns.min() < 0 or columns.max() >= available:
        raise ValueError(f"outputs {outputs}; expected indices from 0 to {available - 1}")
    return columns


def _setting(score: OpenLoopScore) -> tuple:
    horizons = [(part.label, len(part.errors)) for part in score.horizons]
    return horizons, score.margin, score.seed, score.outputs


def _label(seconds: float) -> str:
    return f"{seconds:g} s" if seconds >= 1 else f"{1e3 * seconds:g} ms"


def _cell(score: HorizonScore) -> str:
    if score.diverged == 0:
        return f"{1e3 * score.mean:.3g}"
    survivors = "" if score.diverged == 1 else f", {1e3 * score.mean_of_survivors:.3g}"
    return f"∞ ({100 * score.diverged:.3g} %{survivors})"


def _finite_or_none(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
