"""What a robot shows while nothing happens: noise, drift, missing samples, and how evenly it is sampled."""

from __future__ import annotations

import numpy as np

from ssmr_torch.commissioning.safety_guard import GuardedPlant

SETTLING = 0.2   # of the run, left out
APART = 0.01     # of the displacement limit, that the neutral position may lie beside the zero of the observation
MISSING, JITTER, DRIFT = 0.05, 0.25, 0.01  # shares of samples, timestep and displacement limit that are too much
LOUDEST = 6.0    # standard deviations, that medians of three samples may differ by


def measure_noise(plant: GuardedPlant, duration: float, seed: int = 0) -> dict:
    """Hold the neutral input for `duration` s.

    Per output: std_m of the white noise about a straight line; drift_m_s, its slope, with drift_error_m_s; rest_m,
    where it lies. missing, held: shares of samples that did not come, or repeat the last one to the last digit of a
    sensor with noise. jitter, worst_jitter: by how much sampling intervals are off by the robot's own clock, in
    timesteps, 99 % of them and the worst; None where it has none.
    """
    samples = [plant.reset(seed)]
    stamps = [plant.stamp]
    for _ in range(max(20, round(duration / plant.timestep))):
        samples.append(plant.step(plant.neutral_input))
        stamps.append(plant.stamp)
    y = np.array(samples)[round(SETTLING * len(samples)):]
    time, good = plant.timestep * np.arange(len(y)), np.isfinite(y).all(axis=1)
    if good.sum() < 10:
        raise ValueError(f"{good.sum()} of {len(y)} measurements at rest arrived; expected most of them: see why the "
                         "sensors are silent")
    new = np.flatnonzero(good)
    repeats = (np.diff(y[new], axis=0) == 0).all(axis=1)
    new = new[np.concatenate([[True], ~repeats])] if not repeats.all() else new
    line = np.column_stack([np.ones(len(new)), time[new] - time[new].mean()])
    found, *_ = np.linalg.lstsq(line, y[new], rcond=None)
    std = (y[new] - line @ found).std(axis=0, ddof=2)
    return {"duration_s": float(time[-1]), "std_m": std.tolist(), "drift_m_s": found[1].tolist(),
            "drift_error_m_s": (std / np.sqrt((line[:, 1] ** 2).sum())).tolist(), "rest_m": found[0].tolist(),
            "missing": float(1 - good.mean()), "held": float(repeats.mean()) if not repeats.all() else 0.0,
            **_jitter(np.array(stamps), plant.timestep)}


def _jitter(stamps: np.ndarray, timestep: float) -> dict:
    known = np.flatnonzero(np.isfinite(stamps))
    if len(known) < 2:
        return {"jitter": None, "worst_jitter": None}
    off = np.abs(np.diff(stamps[known]) / (timestep * np.diff(known)) - 1)
    return {"jitter": float(np.percentile(off, 99)), "worst_jitter": float(off.max())}


def noise_faults(noise: dict, plant: GuardedPlant) -> list[str]:
    """What of a robot at rest is not as it should be."""
    names, limit, faults = plant.output_names, plant.card.displacement_limit, []
    rest, drift = np.array(noise["rest_m"]), np.array(noise["drift_m_s"])
    far = int(np.argmax(np.abs(rest)))
    if abs(rest[far]) > max(APART * limit, 5 * noise["std_m"][far]):
        faults.append(f"{names[far]} is {1e3 * rest[far]:.3g} mm from its zero under the neutral input; the robot "
                      "should measure its displacement from there")
    certain = np.abs(drift) > 4 * np.array(noise["drift_error_m_s"])
    moved = np.where(certain, np.abs(drift) * noise["duration_s"], 0.0)
    if moved.max() > DRIFT * limit:
        faults.append(f"{names[int(np.argmax(moved))]} drifts by {1e3 * moved.max():.3g} mm in "
                      f"{noise['duration_s']:.3g} s at rest; let the robot come to rest, or give the "
                      "card a longer settle")
    apparent = LOUDEST * max(noise["std_m"]) / plant.timestep
    if apparent > plant.card.rate_limit:
        faults.append(f"noise alone looks like {apparent:.3g} m/s now and then; expected less than the rate_limit of "
                      f"{plant.card.rate_limit:.3g} m/s: measure more quietly, or raise it")
    lost = noise["missing"] + noise["held"]
    if lost > MISSING:
        faults.append(f"{100 * lost:.2g} % of the samples are missing or repeat the last; expected less than "
                      f"{100 * MISSING:g} %: see what the sensors lack")
    if (noise["jitter"] or 0.0) > JITTER:
        faults.append(f"one sampling interval in a hundred is off by {100 * noise['jitter']:.2g} % of a timestep; "
                      f"expected less than {100 * JITTER:g} %: see what keeps the robot's clock busy")
    return faults


def noise_said(noise: dict, plant: GuardedPlant) -> str:
    """A table of the outputs, and a sentence on the samples."""
    rows = ["| output | noise (mm) | drift (mm/s) | at (mm) |", "| --- | ---: | ---: | ---: |"]
    rows += [f"| {name} | {1e3 * std:.3g} | {1e3 * drift:.2g} ± {1e3 * error:.1g} | {1e3 * rest:.3g} |"
             for name, std, drift, error, rest in zip(plant.output_names, noise["std_m"], noise["drift_m_s"],
                                                      noise["drift_error_m_s"], noise["rest_m"])]
    clock = "the robot tells no clock of its own" if noise["jitter"] is None else \
        f"99 % of the intervals are within {100 * noise['jitter']:.2g} % of a timestep, all within " \
        f"{100 * noise['worst_jitter']:.2g} %"
    lost = f"{100 * noise['missing']:.2g} % of the samples missing, {100 * noise['held']:.2g} % repeated"
    return "\n".join([*rows, "", f"{noise['duration_s']:.3g} s under the neutral input: {lost}; {clock}."])
