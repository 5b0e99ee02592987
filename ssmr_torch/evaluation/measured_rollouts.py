"""Rollouts from measured samples: where they may start, and what is predicted and was measured from there."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ssmr_torch.models.predictors import Predictor, as_predictor, at_every_sample
from ssmr_torch.periods import TOLERANCE, whole_multiple


class JoinedRuns(NamedTuple):
    """Trajectories end to end: observation (Σ T, p) m, input (Σ T, m); offsets, lengths (R,) of each.

    timestep: sampling time, s. seen: (Σ T, p) m, what windows are cut from: the observation, or it with noise.
    """

    observation: np.ndarray
    input: np.ndarray
    offsets: np.ndarray
    lengths: np.ndarray
    timestep: float
    seen: np.ndarray

    @classmethod
    def of(cls, trajectories: Iterable, seen: Iterable | None = None) -> JoinedRuns:
        """Read all trajectories; seen: the same ones as windows are to show them, None for as they are.

        Raises ValueError when there is none or their sampling times differ.
        """
        runs = [trajectory.read() for trajectory in trajectories]
        if not runs:
            raise ValueError("no trajectory to score on; select a split or kind that the dataset has")
        timesteps = np.array([run.timestep for run in runs])
        if np.ptp(timesteps) > TOLERANCE * timesteps.min():
            raise ValueError(f"the trajectories are sampled at {timesteps.min():.6g} to "
                             f"{timesteps.max():.6g} s; score equal ones together, or resample them")
        lengths = np.array([run.length for run in runs])
        observation = np.concatenate([run.observation for run in runs])
        shown = observation if seen is None else np.concatenate([run.read().observation for run in seen])
        return cls(observation, np.concatenate([run.input for run in runs]),
                   np.cumsum(lengths) - lengths, lengths, float(np.median(timesteps)), shown)


class Forecaster:
    """A predictor on joined runs: (trajectory, sample) of N starts → predicted and measured outputs.

    Outputs are compared at every sample of the runs, whatever the predictor's step: between two steps they are
    interpolated, see `predictors.at_every_sample`.
    stride, window_stride: samples per step of the model and per delay of its window. reach: samples that its
    window needs before a start; margin: that, and one at least, for the velocity of a baseline. Raises ValueError
    when columns differ or a timestep is no whole multiple.
    """

    def __init__(self, predictor: Predictor, runs: JoinedRuns):
        for label, given, own in (("outputs", runs.observation.shape[1], predictor.output_dim),
                                  ("inputs", runs.input.shape[1], predictor.input_dim)):
            if own is not None and own != given:
                raise ValueError(f"the trajectories have {given} {label}, the model {own}; "
                                 "give it the columns that it was fitted to")
        self.runs = runs
        self.stride, self.window_stride = (
            whole_multiple(f"the model's {name}", getattr(predictor, name), "the trajectories' sampling time",
                           runs.timestep, "use at_timestep, or resample the data")
            for name in ("timestep", "window_timestep"))
        self.predictor = at_every_sample(predictor, self.stride)
        self.reach = predictor.delays * self.window_stride
        self.margin = max(1, self.reach)

    def __call__(self, owner: np.ndarray, sample: np.ndarray,
                 steps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Predicted and measured (N, H, p), H = max(steps); rows are padded past their own steps.

        owner, sample, steps: (N,); the k-th output is k samples after the start. Nothing after a row's own last sample
        is read, neither of the inputs nor of another trajectory: padding repeats it.
        """
        runs = self.runs
        newest = runs.offsets[owner] + sample
        window = newest[:, None] - self.window_stride * np.arange(self.predictor.delays, -1, -1)
        behind = window[:, :-1, None] + np.arange(self.window_stride)
        ahead = newest[:, None] + np.minimum(np.arange(steps.max()), steps[:, None] - 1)
        predicted = self.predictor.predict(runs.seen[window], runs.input[behind].mean(axis=2),
                                           runs.input[ahead])
        return predicted, runs.observation[ahead + 1]


def noisy(runs: Iterable, noise: float, seed: int) -> list:
    """The runs (read ones) as the loop measures them: with white noise of the standard deviation `noise`, m.

    It is drawn per sample of the runs, so that windows that share a sample, and all models, see the same.
    Raises ValueError for a noise that is negative or not finite.
    """
    if not (np.isfinite(noise) and noise >= 0):
        raise ValueError(f"noise is {noise} m; expected a standard deviation of 0 or more")
    return [replace(run, observation=run.observation + np.random.default_rng((seed, number, 1)).normal(
        0.0, noise, run.observation.shape)) for number, run in enumerate(runs)]


def predict_trajectory(model, trajectory, *, margin: int | None = None) -> tuple[np.ndarray, np.ndarray]:
    """One rollout from sample `margin` (default: the first complete window) to the end of the trajectory.

    model: as in `score_open_loop`. Returns time (H,) s and outputs (H, p) m at every sample after the initial one;
    infinite from where the model calls the rollout diverged. Raises ValueError when the model does not fit or
    the run is too short.
    """
    run = trajectory.read()
    forecaster = Forecaster(as_predictor(model), JoinedRuns.of([run]))
    start = forecaster.reach if margin is None else margin
    steps = run.length - 1 - start
    if start < forecaster.reach or steps < 1:
        raise ValueError(f"a rollout from sample {start} of {run.length}: the model needs {forecaster.reach} "
                         "samples before its start and 1 after")
    predicted, _ = forecaster(np.array([0]), np.array([start]), np.array([steps]))
    return run.time[start + 1:], predicted[0]
