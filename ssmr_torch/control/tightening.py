"""Margins of a robust controller: how far its model's predictions were off on data that it has not seen."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ssmr_torch.periods import whole_steps


def prediction_margins(source, runs, columns, *, horizon: int | None = None, period: float | None = None,
                       quantile: float = 0.95, stride: int = 5) -> np.ndarray:
    """(N,) m: at stage k the quantile of ‖ŷ_k − y_k‖ over the tracked columns, made not to fall with k.

    source: a controller, which follows each run with its own estimator and predicts from the state and the disturbance
    that this gives, its delay bridged; it is reset afterwards. Or a model, which predicts from its chart, as a
    controller without an observer does; it needs horizon, N steps, and period, s, which a controller knows itself.
    Either predicts from every `stride`-th sample under the recorded inputs. With probability `quantile` a plan that
    keeps this margin keeps the constraint, as far as the runs are like what comes [constraint tightening from
    residuals: Hewing et al., Annual Review of Control 2020, section 3]. The noise of the runs' measurements is in it.

    runs: of `observation` (T, p) m, `input` (T, m), `timestep` s, such as held-out `Trajectory`s.
    Raises ValueError for a quantile that is none, for runs of another timestep than the controller's, or where no run
    is long enough.
    """
    if not 0 < quantile < 1:
        raise ValueError(f"quantile is {quantile}; expected a number between 0 and 1")
    controls, columns = hasattr(source, "estimator"), list(columns)
    horizon = source.settings.horizon if controls and horizon is None else horizon
    period = source.period if controls and period is None else period
    if horizon is None or period is None:
        raise ValueError(f"horizon is {horizon} and period {period} s; a model needs both, a controller knows its own")
    of_one_run = _errors_of_controller if controls else _errors_of_chart
    errors = [of_one_run(source, run, columns, whole_steps("period", period, run.timestep), horizon, stride)
              for run in runs]
    errors = np.concatenate(errors) if errors else np.empty((0, horizon))
    errors = errors[~np.isnan(errors).all(axis=1)]
    if not len(errors):
        model = source.model if controls else source
        raise ValueError(f"no run is long enough for a window of {model.delays + 1} samples and {horizon} steps of "
                         f"{period} s; give longer runs or a shorter horizon")
    # a rollout that diverged counts as the largest error that there is
    return np.maximum.accumulate(np.quantile(np.nan_to_num(errors, nan=np.inf, posinf=np.finfo(float).max), quantile,
                                             axis=0))


def tightened(controller, runs, quantile: float | None = None):
    """The same controller, its constraints tightened by its `prediction_margins` on these runs.

    quantile: that of the setting margin_quantile where None is given. The settings then hold the margins, also where
    the task has no constraints. Raises ValueError as `prediction_margins` does, and where the error at the horizon's
    end exceeds the runs' own reach: such a margin leaves no room, and the model says nothing that far ahead.
    """
    quantile = controller.settings.margin_quantile if quantile is None else float(quantile)
    tracked = np.flatnonzero(controller.problem.output_weight)
    runs = list(runs)
    found = prediction_margins(controller, runs, tracked, quantile=quantile)
    reach = max(np.nanmax(np.linalg.norm(np.asarray(run.observation)[:, tracked], axis=1)) for run in runs)
    if not found[-1] <= reach:
        raise ValueError(f"the {quantile:g} quantile of the errors of prediction is {found[-1]:.3g} m after "
                         f"{len(found)} steps of {controller.period} s; the runs reach {reach:.3g} m. A margin of this "
                         "size means nothing: take a better model, a shorter horizon or a smaller quantile")
    controller.settings = controller.settings.changed(margins=found, margin_quantile=quantile)
    if controller.problem.constraints is not None:
        controller.problem.constraints.tighten(found)
    return controller


def _errors_of_chart(model, run, columns, step, horizon, stride) -> np.ndarray:
    """(starts, N): ‖ŷ_k − y_k‖ of the rollouts from every stride-th sample."""
    spacing = whole_steps("the model's window_timestep", model.window_timestep, run.timestep)
    observation, inputs, model = np.asarray(run.observation), np.asarray(run.input), model.at_timestep(run.timestep)
    starts = np.arange(model.delays * spacing, len(observation) - horizon * step, stride)
    if not len(starts):
        return np.empty((0, horizon))
    back = starts[:, None] + spacing * np.arange(-model.delays, 1)
    ahead = starts[:, None] + np.arange(horizon * step)
    with np.errstate(over="ignore", invalid="ignore"):
        states = model.rollout(model.encode(observation[back], inputs[back[:, :-1]]), inputs[ahead]).states
        predicted = model.decode(states[:, step::step])[..., columns]
    return _distance(predicted, observation, starts, step, columns)


def _errors_of_controller(controller, run, columns, step, horizon, stride) -> np.ndarray:
    """The same, from what the controller makes of the run so far; the first second, in which it settles, left out.

    What it knows at sample k is the state `late` samples before. With the inputs that act, it predicts from there to
    the stages of the plan that it would make, the first of which is a step after the first input that can still be
    chosen acts, `lead` samples on; what happens then is measured `late` samples later.
    """
    if abs(run.timestep - controller.timestep) > 1e-9:
        raise ValueError(f"a run has a timestep of {run.timestep} s; the controller expects its own, "
                         f"{controller.timestep} s")
    actuator, observation = controller.actuator.actuator, np.asarray(run.observation)
    inputs = np.asarray(run.input) if actuator.trivial else actuator.acting(run.input)
    delay, lead = controller.settings.measurement_delay, actuator.delay
    late = whole_steps("measurement_delay", delay, run.timestep) if delay else 0
    model, starts, predicted = controller.horizon.model.at_timestep(run.timestep), [], []
    span = late + lead + horizon * step
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        for k, (state, input_offset, output_offset) in enumerate(_followed(controller, observation, inputs, late)):
            if k * run.timestep < SETTLING or k % stride or k + span >= len(observation):
                continue
            acting = inputs[k - late:k - late + span] + (0.0 if input_offset is None else input_offset)
            outputs = model.decode(model.states(state, acting)[late + lead + step::step])
            starts.append(k + late + lead)
            predicted.append((outputs + (0.0 if output_offset is None else output_offset))[:, columns])
    if not starts:
        return np.empty((0, horizon))
    return _distance(np.array(predicted), observation, np.array(starts), step, columns)


# s of a run in which an observer finds the state and the disturbance
SETTLING = 1.0


def _followed(controller, observation: np.ndarray, inputs: np.ndarray, late: int) -> Iterator[tuple]:
    """State and offsets after each sample of a run, as the controller's estimator gives them at that time."""
    controller.reset()
    for k, measured in enumerate(observation):
        controller.estimator.measure(measured, inputs[max(k - 1 - late, 0)])
        yield controller.estimator.state()
    controller.reset()


def _distance(predicted, observation, starts, step, columns) -> np.ndarray:
    """‖ŷ_k − y_k‖; not a number where the measurement is missing."""
    measured = observation[starts[:, None] + step * np.arange(1, predicted.shape[1] + 1)][..., columns]
    missing = ~np.isfinite(measured).all(axis=-1)
    return np.where(missing, np.nan, np.nan_to_num(np.linalg.norm(predicted - measured, axis=-1), nan=np.inf))
