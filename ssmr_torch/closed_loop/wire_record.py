"""The closed-loop record of a run over the wire."""

from __future__ import annotations

import numpy as np

from ssmr_torch import __version__
from ssmr_torch.closed_loop.record import ClosedLoopRecord, planned_violations, told_by
from ssmr_torch.control.base import Command
from ssmr_torch.wire.answers import Sample, code_of
from ssmr_torch.wire.controller_end import ControllerEnd
from ssmr_torch.wire.messages import Code


def record_of(end: ControllerEnd, task, provenance: dict | None = None) -> ClosedLoopRecord:
    """The record of the controller's last run.

    The true outputs of the robot are not known here, so that the observation is the measurement, interpolated linearly
    where one was missing. Where the controller was not asked, because the run was suspended or more samples were
    missing than it is told of, the input is the robot's safe input by default. Raises ValueError for a run without a
    measurement.
    """
    robot, samples = end.description, without_holes(end)
    time = np.array([sample.time for sample in samples])
    measurement = np.array([sample.observation for sample in samples]).reshape(len(samples), -1)
    seen = np.isfinite(measurement).all(axis=1)
    if not seen.any():
        raise ValueError("no measurement arrived in this run, so there is nothing to record; check the robot's end")
    observation = np.stack([np.interp(time, time[seen], column) for column in measurement[seen].T], axis=1)
    commands = [sample.command for sample in samples]
    codes = [code_of(command) for command in commands]
    settings = {"task": task.name, "plant": robot.name, "controller": type(end.controller).__name__,
                "period": end.controller.period, "timestep": robot.timestep, "seed": end.seed, "version": __version__,
                "wire": dict(end.counts), "real_time": robot.real_time, "input_bounds": robot.input_bounds.tolist()}
    settings |= told_by(end.controller)
    return ClosedLoopRecord(
        time=time, reference=task.reference(time), observation=observation, measurement=measurement,
        input=np.stack([command.input for command in commands]),
        fallback=np.array([command.fallback is not None for command in commands]),
        solve_time=np.where([command.held for command in commands], np.nan, [sample.solve_time for sample in samples]),
        iterations=np.array([0 if command.plan is None else command.plan.iterations for command in commands]),
        statuses=tuple(_status(command, code) for command, code in zip(commands, codes)),
        tracked=task.columns(robot.output_names), output_names=robot.output_names, input_names=robot.input_names,
        input_unit=robot.input_unit, provenance=settings | (provenance or {}),
        violation=planned_violations(commands))


def without_holes(end: ControllerEnd) -> list[Sample]:
    """The samples of the last run, with those that were passed over."""
    robot, samples = end.description, []
    nothing = np.full(len(robot.output_names), np.nan)
    for sample in end.samples:
        before = round(samples[-1].time / robot.timestep) if samples else -1
        for place in range(before + 1, round(sample.time / robot.timestep)):
            safe = Command(np.clip(0.0, *robot.input_bounds), held=True)
            samples.append(Sample(place * robot.timestep, nothing, safe, np.nan))
        samples.append(sample)
    return samples


def _status(command, code: Code) -> str:
    if command.fallback is not None:
        return command.fallback.name
    return "" if command.plan is None or code is Code.HELD else command.plan.status.name
