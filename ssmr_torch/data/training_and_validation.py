"""The split of recorded runs into training and validation, and how many of the training runs are used."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ssmr_torch.trajectory import TrajectoryDataset


def limited(training: tuple, decays: int | None, duration: float | None) -> tuple:
    """The first `decays` decays, and the first `duration` s of the runs of other kinds."""
    kept, counted, left = [], 0, float("inf") if duration is None else duration
    for run in training:
        if run.kind == "decay":
            counted += 1
            if decays is None or counted <= decays:
                kept.append(run)
            continue
        samples = min(run.length, round(min(left, 1e9) / run.timestep))
        left -= samples * run.timestep
        if samples >= 2:
            kept.append(run if samples == run.length else run.part(0, samples))
    return tuple(kept)


def noisy(run, noise_std: float, seed: tuple[int, int]):
    """The run with white noise on its observations; noise_std: m, zero gives the run itself."""
    if not noise_std:
        return run
    whole = run.read()
    noise = np.random.default_rng(seed).normal(0.0, noise_std, whole.observation.shape)
    return replace(whole, observation=whole.observation + noise)


def hold_out(dataset: TrajectoryDataset, share: float) -> tuple[tuple, tuple]:
    """Training runs and validation runs, without set points.

    Runs marked "validation" are the validation runs. Without any, the last `share` (0 to 1) of every controlled
    training run is held out. Raises ValueError for a run that is too short for that.
    """
    training, validation = (tuple(run for run in dataset.select(split=split) if run.kind != "static")
                            for split in ("train", "validation"))
    if validation or share == 0:
        return training, validation
    kept, held = [], []
    for trajectory in training:
        if trajectory.kind != "controlled":
            kept.append(trajectory)
            continue
        boundary = round(trajectory.length * (1 - share))
        if min(boundary, trajectory.length - boundary) < 2:
            raise ValueError(f"trajectory {trajectory.name!r} has {trajectory.length} samples, too few to hold out a "
                             f"share of {share}; set validation_share=0 or mark a run as validation")
        kept.append(trajectory.part(0, boundary))
        held.append(trajectory.part(boundary, trajectory.length))
    return tuple(kept), tuple(held)
