"""Open-loop scores of one model: its rollout errors over one horizon, and over all horizons."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

BLOCK = 1.0  # s


@dataclass(frozen=True, eq=False)
class HorizonScore:
    """Errors √(mean_k ‖ŷ_k − y_k‖²) of the rollouts over one horizon, m; infinite for a diverged rollout.

    label: "50 ms", …, or "full". steps: samples that are compared in each rollout; duration: their length in s. For
    "full" both are those of the longest rollout. errors: (N,), one per start; output_errors: (N, outputs), one per
    output. skipped: number of trajectories that are too short.
    trajectory_errors: (N,) mean_k ‖ŷ_k − y_k‖ / max ‖y‖, with the maximum over the whole measured trajectory, no unit.
    run, sample: (N,), trajectory and sample of each start. short: the trajectories that are too short.
    """

    label: str
    steps: int
    duration: float
    errors: np.ndarray
    output_errors: np.ndarray
    skipped: int
    trajectory_errors: np.ndarray | None = None
    run: np.ndarray | None = None
    sample: np.ndarray | None = None
    short: tuple[int, ...] = ()

    @property
    def diverged(self) -> float:
        """Share of diverged rollouts."""
        return float(np.isinf(self.errors).mean())

    @property
    def mean(self) -> float:
        """Mean over all starts, m; infinite if one diverged."""
        return float(self.errors.mean())

    @property
    def mean_of_survivors(self) -> float:
        """Mean over the starts that did not diverge, m; infinite if all diverged. Always quote it with `diverged`."""
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

    @property
    def nmte(self) -> float | None:
        """Normalized mean trajectory error, mean over all starts, no unit; infinite if one diverged, None if it was not
        computed.
        """
        return None if self.trajectory_errors is None else float(self.trajectory_errors.mean())

    @property
    def blocks(self) -> np.ndarray | None:
        """(N,), block of each start. Starts of one run within a second, or within a longer horizon, share a block,
        because their rollouts share samples. None if the starts are not known.
        """
        if self.run is None or self.sample is None:
            return None
        timestep = self.duration / self.steps
        within = np.floor(self.sample * timestep / max(BLOCK, self.duration)).astype(np.int64)
        return np.unique(np.stack([self.run, within]), axis=1, return_inverse=True)[1].reshape(-1)

    def of_runs(self, runs: Collection[int]) -> HorizonScore | None:
        """The same score for the starts in these trajectories only; None if there are no such starts."""
        kept = np.isin(self.run, list(runs))
        if not kept.any():
            return None
        short = tuple(run for run in self.short if run in runs)
        errors = None if self.trajectory_errors is None else self.trajectory_errors[kept]
        return replace(self, errors=self.errors[kept], output_errors=self.output_errors[kept], skipped=len(short),
                       trajectory_errors=errors, run=self.run[kept], sample=self.sample[kept], short=short)

    def as_dict(self) -> dict:
        """Plain JSON values in m and s; infinite values become None."""
        return {"label": self.label, "steps": self.steps, "duration": self.duration,
                "starts": len(self.errors), "skipped_trajectories": self.skipped, "diverged": self.diverged,
                "mean": _finite_or_none(self.mean), "median": _finite_or_none(self.median),
                "p95": _finite_or_none(self.p95),
                "mean_of_survivors": _finite_or_none(self.mean_of_survivors),
                "nmte": None if self.nmte is None else _finite_or_none(self.nmte),
                "mean_per_output": [_finite_or_none(value) for value in self.output_errors.mean(axis=0)]}


@dataclass(frozen=True, eq=False)
class OpenLoopScore:
    """One score per horizon, the last over full trajectories; margin, seed and columns as they were given.

    noise: standard deviation, m, of the noise added to the measured windows. noisy: the score from the same starts with
    noise on the windows, if it was computed.
    """

    horizons: tuple[HorizonScore, ...]
    margin: int
    seed: int
    outputs: tuple[int, ...]
    noise: float = 0.0
    noisy: OpenLoopScore | None = None

    def __getitem__(self, label: str) -> HorizonScore:
        """The score of "50 ms", "1 s", "full", …"""
        for score in self.horizons:
            if score.label == label:
                return score
        raise KeyError(f"there is no horizon {label!r}; the horizons are {[score.label for score in self.horizons]}")

    def of_runs(self, runs: Collection[int]) -> OpenLoopScore:
        """The same score for the starts in these trajectories only, without horizons that have no such start."""
        parts = (part.of_runs(runs) for part in self.horizons)
        return replace(self, horizons=tuple(part for part in parts if part is not None),
                       noisy=None if self.noisy is None else self.noisy.of_runs(runs))

    def as_dict(self) -> dict:
        """Plain JSON values in m and s; infinite values become None."""
        noisy = {} if self.noisy is None else {"noisy": self.noisy.as_dict()}
        return {"unit": "m", "margin": self.margin, "seed": self.seed, "outputs": list(self.outputs),
                "noise": self.noise, "horizons": [score.as_dict() for score in self.horizons]} | noisy


def _finite_or_none(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
