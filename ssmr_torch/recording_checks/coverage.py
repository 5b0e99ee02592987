"""Range of amplitude, speed and input: what the test asks for beyond what the training holds."""

from __future__ import annotations

import numpy as np

from ssmr_torch.recording_checks.context import Recorded
from ssmr_torch.recording_checks.finding import GOOD, LOOK, MISSING, Finding
from ssmr_torch.trajectory import Trajectory

OUTSIDE = 0.01      # of the test samples
TOLERANCE = 0.02    # of the training's range, beyond it
REACH = 0.02        # s, over which speed is measured at least


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
    """Share of the test's samples outside of the training's range of position, speed and input, and how far."""
    subject, training, test = "range", recorded.training, recorded.of("test")
    controlled = recorded.of("train", "controlled")
    if not controlled:
        return Finding(subject, MISSING, "0 controlled runs in the training: how inputs act cannot be learned.",
                       "Record a minute with inputs that vary over the range the robot shall use.",
                       {"controlled_s": 0.0})
    seconds = sum(run.length * run.timestep for run in controlled)
    if not test:
        return Finding(subject, LOOK, f"{seconds:.3g} s of controlled training, and no test to compare its range with.",
                       "Record a test run that moves as far and as fast as the robot shall.", {"controlled_s": seconds})
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
    said = "Test samples outside of the training's range: " + ", ".join(
        f"{name} {100 * numbers[f'{name}_outside']:.2g} % (up to {numbers[f'{name}_factor']:.3g} "
        "times)" for name in parts)
    said += f"; {seconds:.3g} s of controlled training."
    if share > OUTSIDE:
        return Finding(subject, LOOK, said, f"Record training with {numbers[f'{worst}_factor']:.2g} times the "
                                            f"{worst}, or "
                       "read the score as one of extrapolation.", numbers, curves)
    return Finding(subject, GOOD, said, "", numbers, curves)


def _beyond(known: np.ndarray, asked: np.ndarray) -> tuple[float, float]:
    """Share of the rows asked that lie outside of the range known, in any column, and how many times as far from its
    middle as its edge.
    """
    low, high = known.min(axis=0), known.max(axis=0)
    middle, half = (low + high) / 2, np.maximum((high - low) / 2, 1e-300)
    moving = (high > low) | (np.abs(asked - low).max(axis=0) > 0)
    far = np.where(moving, np.abs(asked - middle) / half, 0.0)
    return float(np.mean((far > 1 + 2 * TOLERANCE).any(axis=1))), float(min(far.max(), 1e6))
