"""Check of the range: whether the test runs exceed the training runs in position, speed or input."""

from __future__ import annotations

import numpy as np

from ssmr_torch.recording_checks.context import Recorded
from ssmr_torch.recording_checks.finding import GOOD, LOOK, MISSING, Finding
from ssmr_torch.trajectory import Trajectory

OUTSIDE = 0.01      # share of the test samples that may be outside
TOLERANCE = 0.02    # share of the training range by which a sample may exceed it
REACH = 0.02        # s, shortest time over which speed is measured


def velocity(run: Trajectory, noise: np.ndarray) -> np.ndarray:
    """Central differences (T, p), m/s, over as many samples as keep the noise below a tenth of the motion."""
    y, step = run.observation, run.timestep
    reach = max(1, round(REACH / 2 / step))
    while reach < run.length // 8 and (np.std(y[2 * reach:] - y[:-2 * reach], axis=0) < 10 * 2 ** 0.5 * noise).any():
        reach += 1
        if reach * step > 0.05:
            break
    inner = (y[2 * reach:] - y[:-2 * reach]) / (2 * reach * step)
    return np.pad(inner, ((reach, reach), (0, 0)), mode="edge") if len(inner) else np.zeros_like(y)


def coverage(recorded: Recorded) -> Finding:
    """Share of the test samples outside the training range of position, speed and input, and by how much."""
    subject, training, test = "range", recorded.training, recorded.of("test")
    controlled = recorded.of("train", "controlled")
    if not controlled:
        return Finding(subject, MISSING, "0 controlled training runs: the effect of the inputs cannot be learned.",
                       "Record a minute with inputs that vary over the whole range of later use.",
                       {"controlled_s": 0.0})
    seconds = sum(run.length * run.timestep for run in controlled)
    if not test:
        return Finding(subject, LOOK, f"{seconds:.3g} s of controlled training runs, but no test run to compare.",
                       "Record a test run that moves as far and as fast as in later use.", {"controlled_s": seconds})
    noise = recorded.noise.std
    parts = {"position": lambda run: run.observation, "speed": lambda run: velocity(run, noise),
             "input": lambda run: run.input}
    numbers, curves = {"controlled_s": seconds}, {}
    for name, of in parts.items():
        known, asked = (np.concatenate([of(run) for run in runs]) for runs in (training, test))
        outside, factor = _beyond(known, asked)
        numbers |= {f"{name}_outside": outside, f"{name}_factor": factor}
        curves[name] = (known, asked)
    worst = max(parts, key=lambda name: numbers[f"{name}_outside"])
    share = numbers[f"{worst}_outside"]
    said = "Test samples outside the training range: " + ", ".join(
        f"{name} {100 * numbers[f'{name}_outside']:.2g} % (up to {numbers[f'{name}_factor']:.3g} "
        "times)" for name in parts)
    said += f"; {seconds:.3g} s of controlled training runs."
    if share > OUTSIDE:
        return Finding(subject, LOOK, said, f"Record training runs with {numbers[f'{worst}_factor']:.2g} times the "
                                            f"{worst}. "
                       "Otherwise the test score is one of extrapolation.", numbers, curves)
    return Finding(subject, GOOD, said, "", numbers, curves)


def _beyond(known: np.ndarray, asked: np.ndarray) -> tuple[float, float]:
    """Share of the rows of `asked` outside the range of `known` in any column, and the largest distance from the middle
    of the range, relative to the distance of its edge.
    """
    low, high = known.min(axis=0), known.max(axis=0)
    middle, half = (low + high) / 2, np.maximum((high - low) / 2, 1e-300)
    moving = (high > low) | (np.abs(asked - low).max(axis=0) > 0)
    far = np.where(moving, np.abs(asked - middle) / half, 0.0)
    return float(np.mean((far > 1 + 2 * TOLERANCE).any(axis=1))), float(min(far.max(), 1e6))
