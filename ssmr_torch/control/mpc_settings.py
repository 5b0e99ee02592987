"""The settings of a predictive controller: one object and one set of defaults, for constructor, YAML and runner."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields

import numpy as np

from ssmr_torch.checked_arguments import checked
from ssmr_torch.control.actuator import Actuator
from ssmr_torch.quantities import FREE_PER_INPUT, FREE_WEIGHT, OUTPUT_WEIGHT, PER_INPUT, TEXT, TIMESTEP, TRUTH, VECTOR
from ssmr_torch.ranges import Each, Number, OrNone, Whole
from ssmr_torch.settings import Settings, non_negative, positive, positive_or_none, refuse_unknown, whole


@checked(horizon=Whole(1, 500), period=TIMESTEP, output_weight=OUTPUT_WEIGHT, input_weight=PER_INPUT,
         move_weight=FREE_PER_INPUT, huber=OrNone(Number(1e-9, 1e3, "m")), input_target=VECTOR, posture=VECTOR,
         posture_weight=OrNone(Each(FREE_WEIGHT)), terminal_weight=Number(0.0, 1e40, "1/m²"),
         input_rate=OrNone(PER_INPUT), safe_input=VECTOR,
         output_bounds=OrNone(Each(Each(Number(-1e12, 1e12, infinite=True)), 2, 2)),
         margins=OrNone(Each(Number(0.0, 1e3, "m"))), margin_quantile=Number(1e-6, 1 - 1e-6), hard_constraints=TRUTH,
         violation_weight=OrNone(Each(FREE_WEIGHT, 2, 2)), iterations=Whole(1, 1000), first_iterations=Whole(1, 1000),
         tolerance=Number(0.0, 1.0, above=True), range_factor=Number(0.1, 1e6), approach=Number(0.0, 1e4, "s"),
         measurement_delay=Number(0.0, 10.0, "s"), frozen_after=Whole(0, 1_000_000),
         step_budget=OrNone(Number(1e-3, 1e3)), qp=TEXT)
@dataclass(frozen=True)
class PredictiveControlSettings(Settings):
    """Settings of a `ModelPredictiveController`; `changed(name=value)` gives others.

    horizon: N, control steps.   period: s between two plans, a multiple of the timestep; the input is held in between.
    output_weight: of every tracked output, 1/m²; the default is 100 per mm², as the authors have it.
    terminal_weight: 1/m², added to it at the end of the horizon.
    input_weight: of every input in units of its range, one number or (m,), without unit.   move_weight: the same for
    its change from one control step to the next.   input_target: (m,), the input without cost, to which inputs tend
    where tracking leaves them free; None: zero.   huber: m; the cost of a larger tracking error grows only linearly, so
    that a reference out of reach is not forced; None: never.
    posture: (p,) m, to which untracked outputs tend where more inputs than tracked outputs leave them free.
    posture_weight: (p,) 1/m², its weight; None: zero.
    input_rate: input unit per s, one number or (m,); None: no limit.
    actuator: the `Actuator` between commands and robot, or a mapping of its settings; the model then takes acting
    inputs, and a control step is one sample; None: commands act directly.
    approach: s in which the reference goes from the robot's first position to the task's path; 0: at once.
    safe_input: (m,), input unit; None: the admissible input nearest to zero.
    output_bounds: (2, p) m, soft, lowest and highest of every output; infinite where there is no bound.
    margins: (N,) m, by which obstacles and output bounds are tightened at each stage.   margin_quantile: of the errors
    on held-out runs, from which `tightened` computes the margins.   hard_constraints: True violates obstacles and
    bounds only where no input can avoid it, whatever the tracking gains; such a step has the status SOFTENED.
    violation_weight: (1/m, 1/m²) of the exact penalty, see `OutputConstraints`; None: from output_weight.
    iterations: quadratic programs per step; one is the real-time iteration.   first_iterations: the same
    after a start, a fallback, a gap in time or a change of the reference.   tolerance: iterations end early when the
    next program promises a decrease of less than this share of the cost.
    range_factor: 1; a state is rejected when its norm exceeds that of state_scale by this factor.
    observer: (model at timestep, input range) → `Estimator`, such as a partial `KalmanObserver`; None: the chart.
    measurement_delay: s, age of the measurements, a whole number of timesteps; the model bridges it.
    frozen_after: number of exactly equal measurements, while the input changed, that mean a frozen sensor; 0: never.
    step_budget: share of the period that a step may compute, in CPU time. A program that would not end within it is not
    started; then the best plan so far, or the fallback, is used. None: no limit.
    qp: proxqp, daqp, qpsolvers:NAME, or package.module:Class, see `solver_named`.

    Raises ValueError for an impossible number, or a count that is not whole; TypeError for an unknown name.

    >>> PredictiveControlSettings().changed(horizon=3).horizon
    3
    """

    horizon: int = 5
    period: float = 0.02
    output_weight: float = 1e8
    input_weight: float | Sequence[float] = 225.0
    move_weight: float | Sequence[float] = 0.0
    huber: float | None = None
    input_target: Sequence[float] | None = None
    posture: Sequence[float] | None = None
    posture_weight: Sequence[float] | None = None
    terminal_weight: float = 0.0
    input_rate: float | Sequence[float] | None = None
    safe_input: Sequence[float] | None = None
    output_bounds: Sequence[Sequence[float]] | None = None
    margins: Sequence[float] | None = None
    margin_quantile: float = 0.99
    hard_constraints: bool = False
    violation_weight: Sequence[float] | None = None
    iterations: int = 1
    first_iterations: int = 10
    tolerance: float = 1e-6
    range_factor: float = 3.0
    observer: Callable | None = None
    actuator: Actuator | Mapping | None = None
    approach: float = 0.0
    measurement_delay: float = 0.0
    frozen_after: int = 5
    step_budget: float | None = 0.5
    qp: str = "proxqp"

    def __post_init__(self):
        for name in ("horizon", "iterations", "first_iterations"):
            self._set(name, whole(name, getattr(self, name), least=1))
        self._set("frozen_after", whole("frozen_after", self.frozen_after, least=0))
        for name, unit in (("period", "s"), ("output_weight", "1/m²"), ("tolerance", ""), ("range_factor", "")):
            self._set(name, positive(name, getattr(self, name), unit))
        for name, unit in (("terminal_weight", "1/m²"), ("measurement_delay", "s"), ("approach", "s")):
            self._set(name, non_negative(name, getattr(self, name), unit))
        if not (isinstance(self.margin_quantile, float) and 0 < self.margin_quantile < 1):
            raise ValueError(f"margin_quantile is {self.margin_quantile!r}; expected a share between 0 and 1")
        if not isinstance(self.hard_constraints, bool):
            raise ValueError(f"hard_constraints is {self.hard_constraints!r}; expected true or false")
        self._set("step_budget", positive_or_none("step_budget", self.step_budget))
        self._set("input_weight", positive_or_none("input_weight", self.input_weight))
        self._set("input_rate", positive_or_none("input_rate", self.input_rate, "input unit/s"))
        self._set("huber", positive_or_none("huber", self.huber, "m"))
        self._set("actuator", _actuator(self.actuator))
        if np.ndim(self.move_weight) == 0:
            self._set("move_weight", non_negative("move_weight", self.move_weight))
        else:
            self._set("move_weight", tuple(non_negative(f"move_weight[{i}]", each)
                                           for i, each in enumerate(self.move_weight)))
        if self.input_weight is None:
            raise ValueError("input_weight is None; expected positive numbers, because without them the optimal input "
                             "is not unique")
        for name in ("safe_input", "input_target", "posture", "posture_weight", "output_bounds", "margins",
                     "violation_weight"):
            self._set(name, _numbers(name, getattr(self, name)))
        if self.violation_weight is not None and (len(self.violation_weight) != 2 or min(self.violation_weight) < 0):
            raise ValueError(f"violation_weight is {self.violation_weight}; expected two numbers in 1/m and 1/m², none "
                             "negative")
        self._set("observer", self.observer or None)  # observer=none in the configuration is an empty mapping
        if self.observer is not None and not callable(self.observer):
            raise ValueError(f"observer is {self.observer!r}; expected a function that makes an observer from a model "
                             "and the input range, such as a partial KalmanObserver, or None")


def _actuator(given) -> Actuator | None:
    """The actuator as it is, or made from a mapping of its settings; None where none was given."""
    if given is None or isinstance(given, Actuator):
        return given
    if not isinstance(given, Mapping):
        raise ValueError(f"actuator is {given!r}; expected an Actuator, a mapping of its settings, or None")
    refuse_unknown("Actuator", given, [field.name for field in fields(Actuator)])
    lacking = [name for name in ("timestep", "input_range") if name not in given]
    if lacking:
        raise ValueError(f"the actuator has only {', '.join(given) or 'no settings'}; expected "
                         f"{' and '.join(lacking)} as well")
    return Actuator(**given)


def _numbers(name: str, values) -> tuple | None:
    """The given values as nested tuples; None where there are none."""
    if values is None:
        return None
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):  # not numbers, or rows of different lengths
        array = np.array(np.nan)
    if not array.ndim or np.isnan(array).any():
        raise ValueError(f"{name} is {values}; expected a list of numbers, or None")
    return _tuples(array.tolist())


def _tuples(values):
    return tuple(map(_tuples, values)) if isinstance(values, list) else values
