"""A rehearsal: a task on the model before the robot. It shows what is out of reach, inputs at bounds, and the speed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import lsq_linear

from ssmr_torch import data_sheet as sheet
from ssmr_torch.control.actuator import ActuatorState
from ssmr_torch.control.model_step import Stepper
from ssmr_torch.data_sheet import DataSheet
from ssmr_torch.tasks.references import Task

if TYPE_CHECKING:
    from ssmr_torch.control.mpc import ModelPredictiveController

POINTS = 60            # number of points along the path for the static floor
ITERATIONS = 8         # of the search for the inputs that hold a point
SETTLED = 5.0          # s in which the model comes to rest
AT_BOUND = 1e-3        # of its range: an input nearer to a bound counts as being at it
OUT_OF_REACH = 0.01    # of the path's extent: a point with a larger static error is out of reach
SPEEDS = (0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0)
FEASIBLE = 2.0         # times the error at half the speed, or 1 % of the extent if that is more: largest feasible error


@dataclass(frozen=True, eq=False)
class Rehearsal(DataSheet):
    """floor: (K,) m, least static error at K points of the path.   out_of_reach: share of points with an error of more
    than 1 % of the path's extent.   static_ise: m², sum of the squared floor over the samples of the run; no controller
    is better at this speed.   held: {name of input and bound: share of samples at which the loop on the model had the
    input at this bound}.   rmse: m, of the loop on the model without noise.   fastest: largest factor of the task's
    speed that the model can track.
    """

    task: str
    floor: np.ndarray
    out_of_reach: float
    static_ise: float
    held: dict[str, float]
    rmse: float
    fastest: float | None

    def data_sheet(self) -> tuple[str, dict]:
        reach = "all within reach" if not self.out_of_reach else f"{100 * self.out_of_reach:.3g} % of the path"
        held = {name: f"{100 * share:.3g} % of the time" for name, share in self.held.items()}
        return f"Rehearsal of {self.task!r} on the model", {
            "out of reach at rest": reach,
            "static floor": f"ISE {sheet.number(1e6 * self.static_ise)} mm², at most "
                            f"{sheet.number(1e3 * self.floor.max())} mm",
            "RMSE on the model": f"{sheet.number(1e3 * self.rmse)} mm" if np.isfinite(self.rmse) else "lost",
            "inputs at a bound": held or "none",
            "fastest": "not at half the speed" if self.fastest is None else f"{self.fastest:g} times the speed"}


def rehearse(controller: ModelPredictiveController, task: Task | None = None) -> Rehearsal:
    """Run a task (None: the controller's own) on the controller's model, and find the inputs that hold its points.

    The static floor is the least distance to each point at rest, over all inputs within the bounds, by Gauss-Newton
    steps on the model's steady state. A path within reach at rest may still be too fast; `fastest` gives the largest
    feasible speed of the loop on the model. All this holds for the model, which is good only near its recordings.
    """
    task = controller.task if task is None else task
    columns = task.columns(controller.output_names)
    floor = _static(controller, task, columns)
    record, errors = _loop(controller, task, columns, 1.0)
    lower, upper = controller.input_bounds
    span = upper - lower
    held = {}
    for k in range(len(span)):
        for side, at in (("lowest", np.abs(record[:, k] - lower[k])), ("highest", np.abs(record[:, k] - upper[k]))):
            share = float((at < AT_BOUND * span[k]).mean())
            if share > 0:
                held[f"input {k + 1} at its {side}"] = share
    extent = float(np.ptp(task.reference(np.linspace(0.0, task.duration, 200)), axis=0).max())
    samples = task.duration / controller.timestep
    return Rehearsal(task.name, floor, float((floor > OUT_OF_REACH * extent).mean()),
                     float(np.square(floor).mean() * samples), held, _rms(errors),
                     _fastest(controller, task, columns, extent, _rms(errors)))


def _rms(errors: np.ndarray) -> float:
    return float(np.sqrt(np.square(errors).sum(1).mean())) if np.isfinite(errors).all() else np.inf


def _loop(controller, task: Task, columns, speed: float) -> tuple[np.ndarray, np.ndarray]:
    """Commands (T, m) and errors (T, q) of the task on the model, at this factor of its speed."""
    quick = task if speed == 1.0 else Task(task.name, task.duration / speed, task.tracked, _Faster(task, speed))
    runner = type(controller)(controller.model, quick, controller.input_bounds, controller.settings,
                              timestep=controller.timestep, output_names=controller.output_names)
    runner.reset()
    fine = controller.model.at_timestep(controller.timestep)
    step, state = Stepper(fine), ActuatorState(controller.actuator.actuator)
    state.rest_at(controller.safe_input)
    z, y = runner.estimator.rest(state.acting)
    commands, errors = [], []
    for k in range(round(quick.duration / controller.timestep)):
        time = k * controller.timestep
        command = runner(time, y).input
        commands.append(command)
        errors.append(y[list(columns)] - quick.reference(time)[0])
        state.apply(command)
        with np.errstate(over="ignore", invalid="ignore"):
            z, y = step(z, state.acting)
    return np.array(commands), np.array(errors)


@dataclass(frozen=True)
class _Faster:
    task: Task
    speed: float

    def __call__(self, time: np.ndarray) -> np.ndarray:
        return self.task.reference(self.speed * np.asarray(time))


def _fastest(controller, task: Task, columns, extent: float, as_it_is: float) -> float | None:
    """Largest factor of the speed at which the error stays within `FEASIBLE`; None where half the speed is too fast.

    extent: m, of the path.   as_it_is: m, the error at the task's own speed.
    """
    least, fastest = None, None
    for speed in SPEEDS:
        if task.duration / speed < 20 * controller.timestep:
            break
        error = as_it_is if speed == 1.0 else _rms(_loop(controller, task, columns, speed)[1])
        least = error if least is None else least
        if not (np.isfinite(error) and error <= max(FEASIBLE * least, OUT_OF_REACH * extent)):
            break
        fastest = speed
    return fastest


def _static(controller, task: Task, columns) -> np.ndarray:
    """Least static error (K,), m, at points along the path."""
    fine = controller.model.at_timestep(controller.timestep)
    step, actuator = Stepper(fine), controller.actuator.actuator
    lower, upper = (actuator.factor * bound + actuator.shift for bound in controller.input_bounds)
    columns = list(columns)
    z, _ = controller.estimator.rest(actuator.factor * controller.safe_input + actuator.shift)
    u = actuator.factor * np.clip(controller.safe_input, *controller.input_bounds) + actuator.shift
    floor, start = [], (z, u)
    for point in task.reference(np.linspace(0.0, task.duration, POINTS)):
        best = np.inf
        for _ in range(ITERATIONS):
            z, y = _settled(step, z, u, round(SETTLED / controller.timestep))
            error = y[columns] - point
            if not np.isfinite(error).all():  # the model left its range: the next point begins at rest again
                z, u = start
                break
            best = min(best, float(np.linalg.norm(error)))
            A, B, _ = fine.linearize(z, u)
            C, _ = fine.linearize_output(z)
            G = C[columns] @ np.linalg.lstsq(np.eye(len(A)) - A, B, rcond=None)[0]
            # A small weight on the change: if many inputs hold a point, take the nearest.
            system = np.vstack([G, 1e-3 * np.linalg.norm(G, 2) * np.eye(len(u))])
            target = np.concatenate([-error, np.zeros(len(u))])
            change = lsq_linear(system, target, (lower - u - 1e-12, upper - u + 1e-12)).x
            u = np.clip(u + change, lower, upper)
            if np.abs(change).max() < 1e-4 * (upper - lower).max():
                break
        floor.append(best)
    return np.array(floor)


def _settled(step, z: np.ndarray, u: np.ndarray, samples: int) -> tuple[np.ndarray, np.ndarray]:
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(samples):
            following, y = step(z, u)
            if np.abs(following - z).max() < 1e-9 * (1.0 + np.abs(z).max()):
                break
            z = following
    return following, y
