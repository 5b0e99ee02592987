"""Simulation of a closed loop: a controller steers a plant, sample by sample."""

from __future__ import annotations

from collections.abc import Callable
from time import thread_time

import numpy as np

from ssmr_torch import __version__
from ssmr_torch.closed_loop.record import ClosedLoopRecord, planned_violations, told_by
from ssmr_torch.periods import whole_multiple

PATIENCE = 3.0  # s; a run that takes longer shows a progress bar


def simulate(plant, controller, task, *, seed: int = 0, noise_std: float = 0.0, progress: bool = False,
             provenance: dict | None = None, watch: Callable[..., None] | None = None) -> ClosedLoopRecord:
    """Let the controller steer the plant through the task, from the plant's rest, one call per plant sample.

    seed: fixes the plant's randomness and the measurement noise.   noise_std: m, noise of every observed value, added
    to the noise of the plant's own sensors.
    watch: called once per sample, after the command is computed and before it is applied, with time s, reference (q,)
    m, observation (p,) m, measurement (p,) m, the Command, and its computing time s. An error in it ends the run.
    Raises ValueError when the control period is not a multiple of the plant's timestep.
    """
    for what, given, parts in (("plant", plant, ("timestep", "output_names", "reset", "step")),
                               ("controller", controller, ("period", "reset", "__call__")),
                               ("task", task, ("duration", "reference", "columns"))):
        lacking = [part for part in parts if not hasattr(given, part)]
        if lacking:
            raise TypeError(f"the {what} is a {type(given).__name__}, which has no {', no '.join(lacking)}; "
                            f"expected a {what}")
    _ = whole_multiple("the control period", controller.period, "the plant's timestep", plant.timestep)
    if not noise_std >= 0:
        raise ValueError(f"noise_std is {noise_std} m; expected zero or more")
    time = plant.timestep * np.arange(int(np.ceil(task.duration / plant.timestep - 1e-9)) + 1)
    noise = noise_std * np.random.default_rng(seed).standard_normal((len(time), len(plant.output_names)))
    controller.reset()
    sample = np.array(plant.reset(seed), dtype=np.float64)
    truth, samples, commands, durations = [], [], [], []
    for k in _counted(range(len(time)), task.name) if progress else range(len(time)):
        start = thread_time()
        command = controller(float(time[k]), sample + noise[k])
        durations.append(thread_time() - start)
        truth.append(np.array(plant.displacement, dtype=np.float64))
        samples.append(sample)
        commands.append(command)
        if watch is not None:
            watch(float(time[k]), task.reference(time[k])[0], truth[-1], sample + noise[k], command, durations[-1])
        if k + 1 < len(time):
            sample = np.array(plant.step(command.input), dtype=np.float64)
    settings = {"task": task.name, "plant": plant.name, "controller": type(controller).__name__,
                "period": controller.period, "timestep": plant.timestep, "seed": seed, "noise_std": noise_std,
                "version": __version__} | told_by(controller)
    if hasattr(plant, "input_bounds"):
        settings["input_bounds"] = np.asarray(plant.input_bounds, dtype=np.float64).tolist()
    return _record(plant, task, time, np.stack(truth), np.stack(samples) + noise, commands, durations,
                   settings | (provenance or {}))


def _counted(steps, name: str):
    """The steps, with a progress bar where they take longer than `PATIENCE`."""
    from tqdm import tqdm

    return tqdm(steps, desc=name, delay=PATIENCE)


def _record(plant, task, time, observation, measurement, commands, durations, provenance) -> ClosedLoopRecord:
    held = np.array([command.held for command in commands])
    return ClosedLoopRecord(
        time=time, reference=task.reference(time), observation=observation, measurement=measurement,
        input=np.stack([command.input for command in commands]),
        fallback=np.array([command.fallback is not None for command in commands]),
        solve_time=np.where(held, np.nan, durations),
        iterations=np.array([0 if command.plan is None else command.plan.iterations for command in commands]),
        statuses=tuple(_status(command) for command in commands), tracked=task.columns(plant.output_names),
        output_names=plant.output_names, input_names=plant.input_names, input_unit=plant.input_unit,
        provenance=provenance, violation=planned_violations(commands))


def _status(command) -> str:
    if command.fallback is not None:
        return command.fallback.name
    return "" if command.plan is None else command.plan.status.name
