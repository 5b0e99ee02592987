"""Margins of a robust controller: how far its model's predictions were off on data that it has not seen."""

from __future__ import annotations

import numpy as np

from ssmr_torch.control.base import whole_steps


def prediction_margins(model, runs, columns, *, horizon: int, period: float, quantile: float = 0.95,
                       stride: int = 5) -> np.ndarray:
    """(N,) m: at stage k the quantile of ‖ŷ_k − y_k‖ over the tracked columns, made not to fall with k.

    The model predicts from the chart of every `stride`-th window of the runs under their recorded inputs, as the
    controller does; with probability `quantile` a plan that keeps this margin keeps the constraint, as far as the runs
    are like what comes [constraint tightening from residuals: Hewing et al., Annual Review of Control 2020, section 3].

    runs: of `observation` (T, p) m, `input` (T, m), `timestep` s, such as held-out `Trajectory`s.
    Raises ValueError for a quantile that is none, or where no run is long enough.
    """
    if not 0 < quantile < 1:
        raise ValueError(f"quantile is {quantile}; expected a number between 0 and 1")
    errors = []
    for run in runs:
        spacing = whole_steps("the model's window_timestep", model.window_timestep, run.timestep)
        step = whole_steps("period", period, run.timestep)
        errors.append(_errors(model.at_timestep(run.timestep), run, list(columns), spacing, step, horizon, stride))
    errors = np.concatenate(errors) if errors else np.empty((0, horizon))
    if not len(errors):
        raise ValueError(f"no run is long enough for a window of {model.delays + 1} samples and {horizon} steps of "
                         f"{period} s; give longer runs or a shorter horizon")
    # a rollout that diverged counts as the largest error that there is
    return np.maximum.accumulate(np.quantile(np.nan_to_num(errors, nan=np.inf, posinf=np.finfo(float).max), quantile,
                                             axis=0))


def _errors(model, run, columns, spacing, step, horizon, stride) -> np.ndarray:
    """(starts, N): ‖ŷ_k − y_k‖ of the rollouts from every stride-th sample."""
    observation, inputs = np.asarray(run.observation), np.asarray(run.input)
    starts = np.arange(model.delays * spacing, len(observation) - horizon * step, stride)
    if not len(starts):
        return np.empty((0, horizon))
    back = starts[:, None] + spacing * np.arange(-model.delays, 1)
    ahead = starts[:, None] + np.arange(horizon * step)
    with np.errstate(over="ignore", invalid="ignore"):
        states = model.rollout(model.encode(observation[back], inputs[back[:, :-1]]), inputs[ahead]).states
        predicted = model.decode(states[:, step::step])[..., columns]
    measured = observation[starts[:, None] + step * np.arange(1, horizon + 1)][..., columns]
    return np.linalg.norm(predicted - measured, axis=-1)
