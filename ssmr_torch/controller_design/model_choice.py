"""Chooses the model of a controller: a predictive chart, chosen by held-out runs, or a requested kind."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from ssmr_torch.control.actuator import Actuator
from ssmr_torch.controller_design.predictive_chart import Form, Regression, Scaled, chart, held_error
from ssmr_torch.controller_design.recordings import Recordings
from ssmr_torch.models.base import Model
from ssmr_torch.models.polynomial import PolynomialModel
from ssmr_torch.run import Trajectory
from ssmr_torch.trajectory import TrajectoryDataset

WINDOWS, STATES = (3, 6, 12), (8, 12, 16, 20)
DYNAMICS = ((1, 1e-7), (2, 1e-6), (3, 1e-6), (3, 1e-4))   # degree and ridge
STEPS, FUTURE = 20, 20
WILD = 1.01          # largest allowed spectral radius of 90 % of the local Jacobians
POINTS = 24          # number of points along the recordings with a Jacobian
SEARCHED = ("predictive", "auto", None)


@dataclass(frozen=True, eq=False)
class ChosenModel:
    """model: fitted on all runs, with acting inputs.   error: of predictions on held-out runs before the final fit, as
    a share of the reach.   twin: a second model with another structure, fitted the same way, that stands for the robot.
    words: what was chosen.   tried: forms with their errors, best first.
    """

    model: Model
    error: float
    twin: Model
    twin_error: float
    words: str
    twin_words: str
    tried: list[tuple[Form, float]]


def choose_predictive(acted: Recordings, tried: list[tuple[Form, float]] | None = None, *,
                      say: Callable[[str], None] = lambda line: None) -> ChosenModel:
    """The predictive model with the smallest error on held-out runs over 20 samples, and the best with another
    structure.

    A model is rejected if its Jacobians along the recordings grow by more than `WILD` at a tenth of the points; such
    a model diverges outside its data. Both models are then fitted again, with the held-out runs.
    tried: the result of `all_tried` for the same recordings, if it is known already.
    """
    scaled, found = Scaled(acted, FUTURE), all_tried(acted) if tried is None else tried
    tame = _tame(scaled, found)
    best = next(tame, None)
    if best is None:
        raise ValueError(f"all {len(found)} models grow outside their data (spectral radius above {WILD} along the "
                         "recordings); record longer, more slowly or with smaller motions, and run ssmr check")
    other = next((each for each in tame if each[0].states != best[0].states and each[0].window != best[0].window), best)
    whole = Scaled(replace(acted, train=acted.all), FUTURE)
    say(f"model: {best[0].words}; held-out error {100 * best[1]:.3g} % of the reach")
    return ChosenModel(_fitted(whole, best[0]), best[1], _fitted(whole, other[0]), other[1], best[0].words,
                       other[0].words, found)


def all_tried(acted: Recordings) -> list[tuple[Form, float]]:
    """Every form with its held-out error, as a share of the reach, best first."""
    scaled, recordings, found = Scaled(acted, FUTURE), acted, []
    p, m = recordings.output_dim, recordings.input_dim
    everything = tuple(range(p))
    keeps = dict.fromkeys([tuple(recordings.tracked), everything])
    for keep, length, past_inputs in product(keeps, WINDOWS, (True, False)):
        values = length * p + (length - 1) * m * past_inputs
        if values < len(keep) + 2:
            continue
        directions = chart(scaled, keep, length, past_inputs)
        for states in STATES:
            if not len(keep) + 2 <= states <= directions.E.shape[1]:
                continue
            form = Form(keep, length, states, 3, past_inputs=past_inputs)
            regression = Regression(scaled, directions, form)
            for degree, ridge in DYNAMICS:
                errors = regression.errors(regression.dynamics(degree, ridge), STEPS)
                found.append((replace(form, degree=degree, ridge=ridge), held_error(errors, recordings.tracked)))
    return sorted(found, key=lambda each: each[1])


def _tame(scaled: Scaled, found):
    """The models, in order, whose Jacobians do not grow along the recordings."""
    for form, error in found:
        model = _fitted(scaled, form)
        if np.quantile(spectral_radii(model, scaled.recordings), 0.9) <= WILD:
            yield form, error


def _fitted(scaled: Scaled, form: Form) -> PolynomialModel:
    directions = chart(scaled, form.keep, form.window, form.past_inputs)
    return Regression(scaled, directions, form).model(form.degree, form.ridge)


def spectral_radii(model: Model, acted: Recordings, count: int = POINTS) -> np.ndarray:
    """Spectral radii of ∂z⁺/∂z at points (count,) along the controlled runs."""
    z, u = points_along(model, acted, count)
    A = model.linearize(z, u).A
    return np.abs(np.linalg.eigvals(np.nan_to_num(A, nan=1e6, posinf=1e6, neginf=-1e6))).max(-1)


def points_along(model: Model, acted: Recordings, count: int, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """States (count, n) and acting inputs (count, m) at random samples of the controlled training runs."""
    rng, states, inputs = np.random.default_rng(seed), [], []
    for _ in range(count):
        piece = acted.controlled[rng.integers(len(acted.controlled))]
        k = int(rng.integers(model.delays, len(piece.input)))
        states.append(model.encode(piece.observation[k - model.delays:k + 1], piece.input[k - model.delays:k]))
        inputs.append(piece.input[k - 1])
    return np.stack(states), np.stack(inputs)


def acting_dataset(data: TrajectoryDataset, actuator: Actuator) -> TrajectoryDataset:
    """The dataset with acting inputs in place of commands, without test runs."""
    runs = [run.read() for run in data if run.split != "test"]
    return replace(data, trajectories=tuple(
        Trajectory(run.time, run.observation, actuator.acting(run.input), run.kind, run.split, run.name)
        for run in runs))


def horizon_error(model: Model, acted: Recordings, steps: int = STEPS, stride: int = 7) -> float:
    """The error of any model on held-out runs, as `held_error` defines it, as a share of the reach."""
    errors, d = [], model.delays
    for piece in acted.held:
        start = np.arange(d, len(piece.input) - steps, stride)
        back, ahead = start[:, None] + np.arange(-d, 1), start[:, None] + np.arange(steps)
        z = model.encode(piece.observation[back], piece.input[back[:, :-1]])
        with np.errstate(over="ignore", invalid="ignore"):
            outputs = model.decode(model.rollout(z, piece.input[ahead]).states[:, 1:])
        errors.append((outputs - piece.observation[start[:, None] + np.arange(1, steps + 1)]) / acted.reach)
    return held_error(np.concatenate(errors), acted.tracked)
