"""Sampling, noise, delay and dither: whether the signals themselves carry what a fit needs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ssmr_torch.recording_checks.context import Recorded
from ssmr_torch.recording_checks.finding import GOOD, LOOK, MISSING, UNTOLD, Finding, graded, millimetres
from ssmr_torch.trajectory import Trajectory

SAMPLES, FEWEST = 20.0, 8.0         # per period, or per time constant times 2π, of the fastest slow mode
NOISE, LOUD = 0.003, 0.02           # of the reach
UNFORESEEN, TOO_SMOOTH = 0.01, 0.001    # of the input's range, of what the past does not tell of the next input
PAST = 5                            # inputs that the next is foreseen from


def sampling(recorded: Recorded) -> Finding:
    """Samples per period of the fastest mode that carries the motion."""
    subject, modes, rate = "sampling", recorded.modes, 1 / recorded.dataset.timestep
    if modes.fastest is None:
        return Finding(subject, UNTOLD, f"{rate:.4g} Hz; no slow mode can be told from these runs.",
                       "Record decays that last several periods.", {"rate_hz": rate})
    samples = 2 * np.pi * rate / abs(modes.fastest)
    numbers = {"rate_hz": rate, "samples": float(samples), "rates": [[r.real, r.imag] for r in modes.rates.tolist()],
               "from_decays": modes.free}
    said = (f"{samples:.3g} samples per period of the fastest slow mode, {modes.fastest.real:.3g} ± "
            f"{abs(modes.fastest.imag):.3g}i 1/s at {rate:.4g} Hz"
            f"{'' if modes.free else ' (roughly: from controlled runs alone)'}.")
    severity = graded(-samples, -SAMPLES, -FEWEST)
    needed = SAMPLES * abs(modes.fastest) / 2 / np.pi
    remedy = "" if severity == GOOD else f"Sample at {needed:.2g} Hz or more: delays and derivatives are coarse."
    return Finding(subject, severity, said, remedy, numbers, {"rates": modes.rates, "share": modes.share})


def noise(recorded: Recorded) -> Finding:
    """White noise of the measurement against the motion."""
    found = recorded.noise
    std, share = found.std.max(), float((found.std / np.where(recorded.extent > 0, recorded.extent, np.inf)).max())
    moving = " at most: motion still shows in the quietest parts" if found.bound else ""
    rounded = f"; values are rounded to {millimetres(found.step.max())}" if found.step.max() > 0 else ""
    said = f"White noise of {millimetres(std)}{moving}, {100 * share:.2g} % of the output's range{rounded}."
    severity = graded(share, NOISE, LOUD) if not found.bound else GOOD if share <= NOISE else LOOK
    remedy = "" if severity == GOOD else (f"State it to the fit, module.noise_std={std:.2g}, or measure more quietly."
                                          if not found.bound else "Record some seconds at rest to tell it.")
    numbers = {"std_m": found.std.tolist(), "share": share, "rounding_m": found.step.tolist(),
               "bound": bool(found.bound)}
    return Finding("noise", severity, said, remedy, numbers)


def delay(recorded: Recorded) -> Finding:
    """Samples from a command to the motion, beside the one that the convention has."""
    subject, found, step = "delay", recorded.delay, recorded.dataset.timestep
    curves = {"lags": found.lags * step, "residual": found.residual}
    if not recorded.of("train", "controlled"):
        return Finding(subject, UNTOLD, "There is no controlled training run.", "Record runs under inputs.",
                       {"samples": None})
    if found.samples is None:
        return Finding(subject, UNTOLD, "The inputs change too slowly to see when the robot answers.",
                       "Record ten seconds of input steps, or add dither.", {"samples": None}, curves)
    numbers = {"samples": found.samples, "delay_s": found.samples * step}
    said = f"The robot moves {found.samples} samples ({1e3 * found.samples * step:.3g} ms) after a command."
    if found.samples == 0:
        return Finding(subject, GOOD, "The robot answers a command at the next sample: no delay.", "", numbers, curves)
    if found.samples < 0:
        return Finding(subject, LOOK, f"The robot moves {-found.samples} samples ({-1e3 * found.samples * step:.3g} "
                       "ms) before the command.",
                       "Inputs are logged late, or a controller answers the robot: shift input rows, so that input[k] "
                       "is held from observation[k] on.", numbers, curves)
    return Finding(subject, LOOK if found.samples * step < 0.2 else MISSING, said,
                   f"Shift the inputs by {found.samples} rows, or give the model as many delays.", numbers, curves)


def dither(recorded: Recorded) -> Finding:
    """What of the next input its own past does not tell, and the input's power above the fastest slow mode."""
    subject, runs = "dither", recorded.of("train", "controlled")
    if not runs:
        return Finding(subject, MISSING, "0 controlled runs in the training.", "Record a minute of controlled training "
                       "with dither: N(0, 2.5 % of the range) every 20 ms on top.", {"unforeseen": 0.0})
    share = float(np.median(unforeseen(runs) / np.where(recorded.input_extent > 0, recorded.input_extent, np.inf)))
    frequencies, power = spectrum(runs)
    cut = abs(recorded.modes.fastest) / 2 / np.pi if recorded.modes.fastest is not None else np.nan
    fast = float(power[frequencies > cut].sum() / power.sum()) if np.isfinite(cut) and power.sum() > 0 else None
    numbers = {"unforeseen": share, "fast_power": fast}
    above = "" if fast is None else f"; {100 * fast:.2g} % of their power is faster than the fastest slow mode"
    said = f"The past of the inputs leaves {100 * share:.2g} % of their range of the next one open{above}."
    severity = graded(-share, -UNFORESEEN, -TOO_SMOOTH)
    remedy = "" if severity == GOOD else ("The immediate response to an input is hardly told: add dither, N(0, 2.5 % "
                                          "of the range) every 20 ms.")
    return Finding(subject, severity, said, remedy, numbers,
                   {"frequencies": frequencies, "power": power, "mode": cut})


def unforeseen(runs: Sequence[Trajectory]) -> np.ndarray:
    """(m,) standard deviation of input[k] given the `PAST` inputs before it, by linear least squares."""
    long = [run.input for run in runs if run.length > 2 * PAST]
    if not long:
        return np.zeros(runs[0].input.shape[1])
    past = np.concatenate([np.hstack([u[PAST - 1 - lag:len(u) - 1 - lag] for lag in range(PAST)]) for u in long])
    past, now = np.hstack([past, np.ones((len(past), 1))]), np.concatenate([u[PAST:] for u in long])
    return np.std(now - past @ np.linalg.lstsq(past, now, rcond=1e-10)[0], axis=0)


def spectrum(runs: Sequence[Trajectory]) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies, Hz, and the inputs' power (about their mean) there, all inputs and runs together."""
    from scipy.signal import welch

    size = min(1024, max(run.length for run in runs))
    total = 0.0
    for run in runs:
        if run.length < size:
            continue
        frequencies, power = welch(run.input, 1 / run.timestep, nperseg=size, axis=0)
        total = total + run.length * power.sum(axis=1)
    return frequencies, total
