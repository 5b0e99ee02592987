"""Makes the problem that a predictive controller solves at every step, from settings, task and bounds."""

from __future__ import annotations

import numpy as np

from ssmr_torch.control.actuator import Actuator
from ssmr_torch.control.constraints import constraints_of
from ssmr_torch.control.mpc_settings import PredictiveControlSettings
from ssmr_torch.control.tracking_problem import TrackingProblem

# m: a violation costs more than tracking errors of this size at every stage, which is more than any in the workspace.
PULL = 0.05
ALIKE = 1e-3   # relative: timesteps that differ by less are equal


def tracking_problem(settings: PredictiveControlSettings, reference: TrackedReference, bounds: np.ndarray,
                     actuator: Actuator) -> TrackingProblem:
    """The problem in the transmitted inputs, which the actuator makes of commands within bounds (2, m)."""
    p, columns = reference.output_dim, reference.columns
    tracked = np.zeros(p)
    tracked[columns] = 1.0
    weight = settings.output_weight
    linear, quadratic = (2.0 * settings.horizon * PULL * weight, 10.0 * weight) \
        if settings.violation_weight is None else settings.violation_weight
    constraints = constraints_of(reference.task, columns, p, settings, linear=linear, quadratic=quadratic)
    planned = actuator.reachable(bounds) if actuator.rubs else bounds
    whole = None if settings.actuator is None else np.array(actuator.input_range)
    return TrackingProblem(reference, planned, weight * tracked, settings.input_weight,
                           settings.terminal_weight * tracked, settings.input_rate, settings.horizon, settings.period,
                           constraints, settings.move_weight, settings.huber, input_range=whole,
                           input_target=settings.input_target, posture_weight=_posture_weight(settings, tracked))


def _posture_weight(settings: PredictiveControlSettings, tracked: np.ndarray) -> np.ndarray | None:
    """(p,) weights, zero for tracked outputs. Raises ValueError unless there is one weight for each output."""
    if settings.posture_weight is None:
        return None
    weight = np.array(settings.posture_weight, dtype=np.float64)
    if weight.shape != tracked.shape:
        raise ValueError(f"posture_weight has {weight.size} entries; expected {len(tracked)}, one for each output")
    return weight * (tracked == 0)


def actuator_of(settings: PredictiveControlSettings, bounds: np.ndarray, timestep: float) -> Actuator:
    """The actuator of the settings, or one without effect. Raises ValueError where it does not fit the measurements."""
    given = settings.actuator
    if given is None:
        return Actuator(timestep, tuple(np.ptp(bounds, axis=0).tolist()))
    if len(given.input_range) != bounds.shape[1] or abs(given.timestep / timestep - 1.0) > ALIKE \
            or settings.period > (1.0 + ALIKE) * timestep:
        raise ValueError(f"the actuator has {len(given.input_range)} inputs and steps of {given.timestep:g} s; "
                         f"expected {bounds.shape[1]} inputs and the timestep {timestep:g} s, which must also be the "
                         f"period (it is {settings.period:g} s)")
    return given


class TrackedReference:
    """The task's reference in the tracked columns, and the posture in the others.

    The posture is relative to the estimated `disturbance` (p,), m, so that the model stays where its data are.
    approach: s in which the distance to the robot's first position goes to zero, twice continuously differentiable.
    Raises ValueError for a task that tracks an output which the model does not have.
    """

    def __init__(self, task, output_names, output_dim: int, approach: float, posture=None):
        self.posture = np.zeros(output_dim) if posture is None else np.array(posture, dtype=np.float64)
        if self.posture.shape != (output_dim,):
            raise ValueError(f"posture has {self.posture.size} entries; expected {output_dim}, one for each output")
        self.task, self.columns = task, list(task.columns(output_names))
        self.output_dim, self.approach = output_dim, approach
        if max(self.columns) >= output_dim:
            raise ValueError(f"the task tracks output {max(self.columns)}; the model has {output_dim} outputs, counted "
                             "from 0")
        self.begin_at(None, 0.0)

    def begin_at(self, observation: np.ndarray | None, time: float) -> None:
        """The robot is at observation (p,) m at this time, s; None: not known yet."""
        self.disturbance = None
        self.begun, self.start, self.distance = observation is not None, time, np.zeros(len(self.columns))
        if self.begun and self.approach:
            self.distance = observation[self.columns] - self.task.reference(np.array([time]))[0]

    def __call__(self, time: np.ndarray) -> np.ndarray:
        posture = self.posture if self.disturbance is None else self.posture + self.disturbance
        reference = np.tile(posture, (len(time), 1))
        reference[:, self.columns] = self.task.reference(time)
        if self.begun and self.approach and time[0] < self.start + self.approach:
            s = np.clip((time - self.start) / self.approach, 0.0, 1.0)[:, None]
            reference[:, self.columns] += (1.0 - s**3 * (s * (6.0 * s - 15.0) + 10.0)) * self.distance
        return reference


def names_seen(model, output_names):
    """The names of the outputs; by default those of the model. Raises ValueError for other names."""
    own = getattr(model, "output_names", None)
    if output_names is None:
        return own
    if own is not None and tuple(output_names) != tuple(own) or len(output_names) != model.reduced.output_dim:
        raise ValueError(f"output_names are {list(output_names)}; the model has {model.reduced.output_dim} outputs"
                         f"{'' if own is None else f', {list(own)}'}: give these names, in this order")
    return output_names
