"""Turns the result of a design into the settings of the controller that runs it."""

from __future__ import annotations

from functools import partial

import numpy as np

from ssmr_torch.control.actuator import Actuator
from ssmr_torch.control.disturbance_observer import DisturbanceObserver
from ssmr_torch.control.mpc_settings import PredictiveControlSettings
from ssmr_torch.controller_design.linear_loop import Weights
from ssmr_torch.controller_design.noises import Likelihood, Observer
from ssmr_torch.controller_design.recordings import Recordings

HUBER = 5e-3         # of the reach: the cost of a larger tracking error grows only linearly
# Weight of all outputs that are not tracked: one standard deviation from their mean in the recordings costs as much as
# a tracking error of three tolerances. Without it such outputs drift to where there are no data.
POSTURE = 10.0
# One program per step is enough while the robot is as recorded. When it is not, and inputs saturate, a line search
# along the step kept loops stable that lost the reference with full steps.
ITERATIONS, CONVERGED = 4, 1e-4
LOST = 0.02          # of the reach: a good prediction never has a larger error
LIMIT = 1.5          # of the reach: the largest disturbance of an output that the observer accepts
APPROACH = 2.0       # s, from the robot's first position to the reference


def settings_of(weights: Weights, observer: Observer, actuator: Actuator, acted: Recordings,
                likelihood: Likelihood) -> PredictiveControlSettings:
    """Settings in SI units, from weights and an observer in units of the reach and of the input range."""
    n, reach = likelihood.model.state_dim, acted.reach
    gain = likelihood.whole_gain(observer)
    gain[:n] /= reach
    neutral, (usual, spread) = acted.neutral, acted.usual_outputs
    free = max(acted.output_dim - len(acted.tracked), 1)
    watch = partial(DisturbanceObserver, gain=gain, covariance=observer.covariance * reach**2, limit=LIMIT * reach,
                    lost=LOST * reach, watched=tuple(acted.tracked))
    return PredictiveControlSettings(
        horizon=weights.horizon, period=acted.timestep, output_weight=1.0 / (weights.tolerance * reach)**2,
        input_weight=weights.input, input_target=tuple(acted.usual_input.tolist()),
        posture=tuple(usual.tolist()), posture_weight=tuple((POSTURE / free / spread**2).tolist()),
        move_weight=weights.move, huber=HUBER * reach, observer=watch,
        actuator=actuator, approach=APPROACH,
        iterations=ITERATIONS, tolerance=CONVERGED, safe_input=tuple(neutral.tolist()),
        input_rate=None if actuator.rate is None else tuple((actuator.rate * np.array(actuator.input_range)).tolist()),
        frozen_after=0 if actuator.rubs else 5)
