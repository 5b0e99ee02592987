"""Checks of the signals: sampling, noise, delay and dither."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ssmr_torch.recording_checks.context import Recorded
from ssmr_torch.recording_checks.finding import GOOD, LOOK, MISSING, UNTOLD, Finding, graded, millimetres
from ssmr_torch.recording_clocks.lag import Lag
from ssmr_torch.trajectory import Trajectory

SAMPLES, FEWEST = 20.0, 8.0         # per period, or per time constant times 2π, of the fastest slow mode
NOISE, LOUD = 0.003, 0.02           # relative to the reach
UNFORESEEN, TOO_SMOOTH = 0.01, 0.001    # unpredictable part of the next input, relative to the input's range
PAST = 5                            # number of past inputs from which the next one is predicted


def sampling(recorded: Recorded) -> Finding:
    """Samples per period of the fastest mode that carries the motion."""
    subject, modes, rate = "sampling", recorded.modes, 1 / recorded.dataset.timestep
    if modes.fastest is None:
        return Finding(subject, UNTOLD, f"{rate:.4g} Hz; these runs show no slow mode.",
                       "Record decays that last several periods.", {"rate_hz": rate})
    samples = 2 * np.pi * rate / abs(modes.fastest)
    numbers = {"rate_hz": rate, "samples": float(samples), "rates": [[r.real, r.imag] for r in modes.rates.tolist()],
               "from_decays": modes.free}
    said = (f"{samples:.3g} samples per period of the fastest slow mode, {modes.fastest.real:.3g} ± "
            f"{abs(modes.fastest.imag):.3g}i 1/s at {rate:.4g} Hz"
            f"{'' if modes.free else ' (rough, because from controlled runs only)'}.")
    severity = graded(-samples, -SAMPLES, -FEWEST)
    needed = SAMPLES * abs(modes.fastest) / 2 / np.pi
    remedy = "" if severity == GOOD else f"Sample at {needed:.2g} Hz or more, for better delays and derivatives."
    return Finding(subject, severity, said, remedy, numbers, {"rates": modes.rates, "share": modes.share})


def noise(recorded: Recorded) -> Finding:
    """White measurement noise relative to the motion."""
    found = recorded.noise
    std, share = found.std.max(), float((found.std / np.where(recorded.extent > 0, recorded.extent, np.inf)).max())
    moving = " at most (motion is visible even in the quietest parts)" if found.bound else ""
    rounded = f"; values are rounded to {millimetres(found.step.max())}" if found.step.max() > 0 else ""
    said = f"White noise of {millimetres(std)}{moving}, {100 * share:.2g} % of the output's range{rounded}."
    severity = graded(share, NOISE, LOUD) if not found.bound else GOOD if share <= NOISE else LOOK
    remedy = "" if severity == GOOD else (f"Set module.noise_std={std:.2g} in the fit, or measure with less noise."
                                          if not found.bound else "Record some seconds at rest to measure it.")
    numbers = {"std_m": found.std.tolist(), "share": share, "rounding_m": found.step.tolist(),
               "bound": bool(found.bound)}
    return Finding("noise", severity, said, remedy, numbers)


def delay(recorded: Recorded) -> Finding:
    """Delay in samples between a command and the motion, in addition to the one sample of the convention."""
    subject, found, step = "delay", recorded.delay, recorded.dataset.timestep
    curves = {"lags": found.lags * step, "residual": found.residual}
    if not recorded.of("train", "controlled"):
        return Finding(subject, UNTOLD, "There is no controlled training run.", "Record runs under inputs.",
                       {"samples": None})
    if found.samples is None and recorded.lag.significant:
        found = found._replace(samples=-recorded.lag.samples)
    if found.samples is None:
        return Finding(subject, UNTOLD, "The inputs change too slowly to show when the robot responds.",
                       "Record ten seconds of input steps, or add dither.", {"samples": None}, curves)
    numbers = {"samples": found.samples, "delay_s": found.samples * step} | _lag(recorded.lag, step)
    said = f"The robot moves {found.samples} samples ({1e3 * found.samples * step:.3g} ms) after a command."
    if found.samples == 0:
        return Finding(subject, GOOD, "The robot responds to a command at the next sample: no delay.", "", numbers,
                       curves)
    if found.samples < 0:
        return Finding(subject, LOOK, f"The robot moves {-found.samples} samples ({-1e3 * found.samples * step:.3g} "
                       "ms) before the command.",
                       "The inputs were logged late, or a controller reacted to the robot: shift the input rows so "
                       "that input[k] is held from observation[k] on, as input_lag: remove does.", numbers, curves)
    return Finding(subject, LOOK if found.samples * step < 0.2 else MISSING, said,
                   f"Shift the inputs by {found.samples} rows (input_lag: remove), or give the model as many delays.",
                   numbers, curves)


def _lag(found: Lag, step: float) -> dict:
    """The shift of the inputs with which they predict the outputs best, s; positive where they stand late."""
    if found.samples is None:
        return {"lag_s": None}
    return {"lag_s": found.samples * step, "lag_low_s": (found.low - 1) * step, "lag_high_s": (found.high + 1) * step}


def dither(recorded: Recorded) -> Finding:
    """Part of the next input that its past cannot predict, and the power of the inputs above the fastest slow mode."""
    subject, runs = "dither", recorded.of("train", "controlled")
    if not runs:
        return Finding(subject, MISSING, "0 controlled training runs.", "Record a minute of controlled training "
                       "runs with dither: add N(0, 2.5 % of the range) every 20 ms.", {"unforeseen": 0.0})
    share = float(np.median(unforeseen(runs) / np.where(recorded.input_extent > 0, recorded.input_extent, np.inf)))
    frequencies, power = spectrum(runs)
    cut = abs(recorded.modes.fastest) / 2 / np.pi if recorded.modes.fastest is not None else np.nan
    fast = float(power[frequencies > cut].sum() / power.sum()) if np.isfinite(cut) and power.sum() > 0 else None
    numbers = {"unforeseen": share, "fast_power": fast}
    above = "" if fast is None else f"; {100 * fast:.2g} % of the inputs' power is faster than the fastest slow mode"
    said = f"The part of the next input that its past cannot predict is {100 * share:.2g} % of its range{above}."
    severity = graded(-share, -UNFORESEEN, -TOO_SMOOTH)
    remedy = "" if severity == GOOD else ("The data hardly show the immediate response to an input: add dither, "
                                          "N(0, 2.5 % of the range) every 20 ms.")
    return Finding(subject, severity, said, remedy, numbers,
                   {"frequencies": frequencies, "power": power, "mode": cut})


def unforeseen(runs: Sequence[Trajectory]) -> np.ndarray:
    """(m,), standard deviation of input[k] after a linear least-squares prediction from the `PAST` inputs before it."""
    long = [run.input for run in runs if run.length > 2 * PAST]
    if not long:
        return np.zeros(runs[0].input.shape[1])
    past = np.concatenate([np.hstack([u[PAST - 1 - lag:len(u) - 1 - lag] for lag in range(PAST)]) for u in long])
    past, now = np.hstack([past, np.ones((len(past), 1))]), np.concatenate([u[PAST:] for u in long])
    return np.std(now - past @ np.linalg.lstsq(past, now, rcond=1e-10)[0], axis=0)


def spectrum(runs: Sequence[Trajectory]) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies, Hz, and the power of the inputs (without their mean) there, summed over all inputs and runs."""
    from scipy.signal import welch

    size = min(1024, max(run.length for run in runs))
    total = 0.0
    for run in runs:
        if run.length < size:
            continue
        frequencies, power = welch(run.input, 1 / run.timestep, nperseg=size, axis=0)
        total = total + run.length * power.sum(axis=1)
    return frequencies, total
