"""Static pregain: a feedforward input from set points, and feedback by a linear-quadratic regulator."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from math import isfinite

import numpy as np
from scipy.linalg import solve_discrete_are

from ssmr_torch.checked_arguments import checked
from ssmr_torch.control.base import Command
from ssmr_torch.control.chart_estimator import ChartEstimator
from ssmr_torch.control.input_bounds import admissible_input, changed_bounds
from ssmr_torch.control.mpc_settings import PredictiveControlSettings as Predictive
from ssmr_torch.control.sampling import Sampling
from ssmr_torch.keywords import configurable
from ssmr_torch.models.polynomial import PregainModel
from ssmr_torch.periods import whole_steps
from ssmr_torch.quantities import OUTPUT_WEIGHT, PER_INPUT, TIMESTEP, VECTOR
from ssmr_torch.ranges import OrNone, Whole
from ssmr_torch.settings import positive_or_none
from ssmr_torch.status import Status

# Weight of states that no output shows. It keeps the Riccati equation solvable.
STATE_WEIGHT = 1e-6


class StaticPregainController:
    """u = G [1, ŷ] − K (z − ẑ), clipped to the bounds (paper, "Koopman static pregain"; Haggerty et al. 2023).

    G: the model's pregain, u = G [1, y] at rest. With cables that only pull, its constant is their common tension. ŷ:
    the reference now. ẑ: the chart of the window of the reference. Outputs that the task does not prescribe have, in
    both, the mean value of set points with the prescribed outputs; with measured values, G would feed back on itself.
    K: gain of the linear-quadratic regulator for Σ ‖y‖²_Q + ‖u / range‖²_R of the model at the control period. It is
    the stationary gain or, with `horizon` N, the first gain of the recursion over N steps. A constant state, which is
    the same in z and ẑ, is left out of it.

    model: a `PregainModel` without bilinear terms and of degree one, such as that of a `StaticPregainKoopman`. task,
    input_bounds, timestep, period, output_weight (1/m²), input_weight (without unit, of inputs in units of the range of
    these bounds), safe_input: as in `ModelPredictiveController`.
    A measurement that is not finite, or that leads to an input that is not finite, gives safe_input; `fallbacks` counts
    it. Time and measurements are treated as in `ModelPredictiveController`, and counted in `counts`. `input_bounds` can
    be changed between steps.
    Raises ValueError for another model, a period that is not a multiple of the timestep, crossed bounds, or a weight
    that is not positive.
    """

    @configurable(given=("timestep", "output_names"))
    @checked(period=TIMESTEP, output_weight=OUTPUT_WEIGHT, input_weight=PER_INPUT, horizon=OrNone(Whole(1, 500)),
             safe_input=VECTOR)
    def __init__(self, model, task, input_bounds, *, timestep: float | None = None, output_names=None,
                 period: float = Predictive.period, output_weight: float = Predictive.output_weight,
                 input_weight: float | Sequence[float] = Predictive.input_weight, horizon: int | None = None,
                 safe_input=None):
        model = model.reduced.numpy()
        if not isinstance(model, PregainModel) or not model.affine or model.structure.chart.highest > 1:
            raise ValueError("this controller takes a linear Koopman model with a pregain; train one with "
                             "model=static_pregain on data with static runs")
        self.timestep = float(model.window_timestep if timestep is None else timestep)
        self.period = float(period)
        every = whole_steps("period", period, self.timestep)
        stride = whole_steps("the model's window_timestep", model.window_timestep, self.timestep)
        self.estimator = ChartEstimator(model, stride)
        self._sampling = Sampling(model, self.timestep, every, max(every, model.delays * stride))
        self.bounds = np.array(input_bounds, dtype=np.float64)
        self.model, self.task, self.columns = model, task, list(task.columns(output_names))
        self.completion = completion(model.set_points, self.columns)
        weight = np.zeros(model.output_dim)
        weight[self.columns] = output_weight
        A, B, _ = model.at_timestep(period).linearize(np.zeros(model.state_dim), np.zeros(model.input_dim))
        varying = ~model.constant_states
        C = model.linearize_output(np.zeros(model.state_dim)).C[:, varying]
        self.gain = np.zeros((model.input_dim, model.state_dim))
        self.gain[:, varying] = regulator_gain(A[varying][:, varying], B[varying], C.T @ (weight[:, None] * C),
                                               self._input_cost(input_weight), horizon)
        self.safe_input = self._safe = admissible_input("safe_input", safe_input, self.bounds)
        self.reset()

    def _input_cost(self, weight: float | Sequence[float]) -> np.ndarray:
        """R for inputs in their own unit, (m, m)."""
        lower, upper = self.bounds
        if not (np.isfinite(self.bounds).all() and (lower < upper).all()):
            raise ValueError(f"input_bounds are {self.bounds.tolist()}; expected finite numbers, lowest below highest")
        return np.diag(np.broadcast_to(positive_or_none("input_weight", weight), lower.shape) / (upper - lower)**2)

    @property
    def counts(self) -> Counter[str]:
        """Counts of events in time and measurements since the last reset, by name."""
        return +self._sampling.counts

    @property
    def input_bounds(self) -> np.ndarray:
        """(2, m), for all later commands; as in `ModelPredictiveController`."""
        return self.bounds.copy()

    @input_bounds.setter
    def input_bounds(self, bounds) -> None:
        self.bounds = changed_bounds(bounds, self.bounds.shape)
        self.safe_input, self._last_input = (np.clip(u, *self.bounds) for u in (self._safe, self._last_input))

    def reset(self) -> None:
        """Forget measurements and counts."""
        self.estimator.reset()
        self._sampling.reset()
        self._last_input = self.safe_input
        self.fallbacks: Counter[Status] = Counter()

    def __call__(self, time: float, observation: np.ndarray) -> Command:
        """The command at time s for any observation (p,), m. Raises ValueError for an observation of another size."""
        sample = self._sampling.take(time, observation)
        if not sample.new:
            self.fallbacks[Status.WRONG_TIME] += 1
            return Command(self._last_input.copy(), fallback=Status.WRONG_TIME)
        if sample.anew:
            self.estimator.reset()
        for _ in range(sample.missed):
            self.estimator.measure(np.full_like(sample.observation, np.nan), self._last_input)
        self.estimator.measure(sample.observation, self._last_input)
        command = self._decide(sample.time) if sample.due else Command(self._last_input.copy(), held=True)
        self._last_input = command.input.copy()
        return command

    def completed(self, reference: np.ndarray) -> np.ndarray:
        """All outputs (..., p) that belong to the prescribed ones (..., t)."""
        return np.concatenate([np.ones_like(reference[..., :1]), reference], axis=-1) @ self.completion

    def _decide(self, time: float) -> Command:
        if not isfinite(time):
            return self._fall_back()
        model = self.model
        window, held = self.estimator.window()
        ages = model.window_timestep * np.arange(model.delays, -1, -1)
        wanted = self.completed(self.task.reference(np.maximum(time - ages, 0.0)))
        with np.errstate(over="ignore", invalid="ignore"):
            error = model.encode(window, held) - model.encode(wanted, held)
            intended = model.pregain @ np.r_[1.0, wanted[-1]] - self.gain @ error
        if not np.isfinite(intended).all():
            return self._fall_back()
        return Command(np.clip(intended, *self.bounds))

    def _fall_back(self) -> Command:
        self.fallbacks[Status.NOT_FINITE] += 1
        return Command(self.safe_input.copy(), fallback=Status.NOT_FINITE)


def completion(set_points: np.ndarray, columns: list[int]) -> np.ndarray:
    """(1 + t, p): [1, the t prescribed outputs] @ completion = all outputs. The others follow by linear regression over
    the set points; `set_points` (1 + p, 1 + p) is the factor of their [1, y].
    """
    given = [0, *(1 + column for column in columns)]
    table = np.linalg.lstsq(set_points[:, given], set_points[:, 1:], rcond=None)[0]
    table[:, columns] = np.eye(len(given))[:, 1:]
    return table


def regulator_gain(A: np.ndarray, B: np.ndarray, Q: np.ndarray, R: np.ndarray,
                   horizon: int | None = None) -> np.ndarray:
    """K (m, n) of u = −K z with the least Σ zᵀ Q z + uᵀ R u for z⁺ = A z + B u, over `horizon` steps or without end.

    A small multiple of the identity is added to Q, so that states which no output shows do not make it singular.
    Raises ValueError for a horizon below 1.
    """
    if horizon is not None and horizon < 1:
        raise ValueError(f"horizon is {horizon}; expected 1 step or more, or None for the stationary gain")
    Q = Q + STATE_WEIGHT * max(np.abs(Q).max(), 1.0) * np.eye(len(A))
    if horizon is None:
        P = solve_discrete_are(A, B, Q, R)
        return np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)
    P = Q
    for _ in range(horizon):
        K = np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)
        P = Q + A.T @ P @ (A - B @ K)
    return K
