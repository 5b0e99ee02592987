"""Estimate of a robot's slow modes from its recordings, before any model is fitted."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ssmr_torch.trajectory import Trajectory

LAGS = 24           # number of samples of a delay window, spread over half a period of the strongest motion
CONTROLLED_LAGS = 6
CONTROLLED_LAG = 0.01   # s
ENERGY = 0.999      # share of the windows' energy to which the linear map is fitted
MOST_MODES = 12     # largest number of modes of the linear map
WEAKEST = 0.03      # a mode with a smaller share of the strongest mode's motion cannot be distinguished from noise
CARRIES = 0.1       # smallest share of the strongest mode's motion for a mode to count


class Modes(NamedTuple):
    """rates: (n,), 1/s, one of each conjugate pair, slowest decay first. share: (n,), motion of each mode relative to
    the strongest one. free: whether they come from decays; from controlled runs they are only rough.
    """

    rates: np.ndarray
    share: np.ndarray
    free: bool

    @property
    def fastest(self) -> complex | None:
        """The mode that oscillates or decays fastest, 1/s, among those with a share of at least `CARRIES`."""
        carrying = self.rates[self.share >= CARRIES]
        return complex(carrying[np.argmax(np.abs(carrying))]) if len(carrying) else None

    @property
    def memory(self) -> float | None:
        """Time in s after which the slowest mode that counts has decayed to 5 %.

        Controlled runs also show modes of their inputs, which are slow. Only modes near the fastest count there.
        """
        carrying = self.rates[self.share >= CARRIES]
        if not self.free:
            carrying = carrying[np.abs(carrying) > 0.3 * np.abs(carrying).max(initial=0.0)]
        return float(3.0 / np.abs(carrying.real).min()) if len(carrying) else None


def slow_modes(runs: Sequence[Trajectory]) -> Modes:
    """The main modes of the motion in the decays, or in the controlled runs if there are no decays.

    Dynamic mode decomposition of delay windows w: w(t + τ) = A w(t) + B u(t) by least squares on the leading singular
    directions, λ = ln(eigenvalues of A) / τ. The windows of decays cover half a period of the strongest frequency, the
    windows of controlled runs 60 ms. Modes with a share below `WEAKEST` and growing modes are left out.
    """
    moving = [run for run in runs if run.length >= 16 and np.ptp(run.observation, axis=0).max() > 0]
    decays = [run for run in moving if run.kind == "decay"]
    nothing = Modes(np.empty(0, dtype=complex), np.empty(0), bool(decays))
    used = decays or [run for run in moving if run.kind == "controlled"]
    if not used:
        return nothing
    timestep, half = used[0].timestep, 0.5 * np.median([run.length for run in used])
    lags, stride = (LAGS, round(0.5 / strongest_frequency(used) / timestep / LAGS)) if decays else (
        CONTROLLED_LAGS, round(CONTROLLED_LAG / timestep))
    stride = max(1, min(stride, int(half // lags)))
    lags = int(min(lags, half // stride))
    before, after, inputs = _windows(used, lags, stride)
    if lags < 2 or len(before) < 4 * lags:
        return nothing
    return Modes(*_decomposed(before, after, inputs, stride * timestep), bool(decays))


def strongest_frequency(runs: Sequence[Trajectory]) -> float:
    """Median frequency, Hz, of the spectrum of the motion."""
    frequencies, power = [], []
    for run in runs:
        y = run.observation - run.observation.mean(axis=0)
        spectrum = (np.abs(np.fft.rfft(y * np.hanning(len(y))[:, None], axis=0)) ** 2).sum(axis=1)
        at = np.fft.rfftfreq(len(y), run.timestep)
        frequencies.append(at)
        power.append(spectrum)
    at, power = np.concatenate(frequencies), np.concatenate(power)
    order = np.argsort(at)
    share = np.cumsum(power[order]) / power.sum()
    return float(max(at[order][np.searchsorted(share, 0.5)], 1.0 / max(run.length * run.timestep for run in runs)))


def _windows(runs: Sequence[Trajectory], lags: int, stride: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Delay windows, the windows one stride later, and the mean input in between; each run relative to its own mean."""
    before, after, inputs = [], [], []
    every = max(1, sum(run.length for run in runs) // 20000)
    for run in runs:
        rows = np.arange((lags - 1) * stride, run.length - stride, every)
        if not len(rows):
            continue
        y = run.observation
        reach = rows[:, None] - stride * np.arange(lags)
        before.append(y[reach].reshape(len(rows), -1))
        after.append(y[reach + stride].reshape(len(rows), -1))
        summed = np.cumsum(np.vstack([np.zeros(run.input.shape[1]), run.input]), axis=0)
        past = np.maximum(reach, 0)
        inputs.append(((summed[past + stride] - summed[past]) / stride).reshape(len(rows), -1))
    if not before:
        return np.empty((0, 1)), np.empty((0, 1)), np.empty((0, 1))
    return np.concatenate(before), np.concatenate(after), np.concatenate(inputs)


def _decomposed(before: np.ndarray, after: np.ndarray, inputs: np.ndarray, step: float) -> tuple[np.ndarray,
np.ndarray]:
    scale = np.sqrt(np.mean(before ** 2)) or 1.0
    left, singular, basis = np.linalg.svd(before / scale, full_matrices=False)
    energy = np.cumsum(singular ** 2) / np.sum(singular ** 2)
    size = int(min(np.searchsorted(energy, ENERGY) + 1, MOST_MODES, len(singular)))
    basis = basis[:size]
    z, later = before / scale @ basis.T, after / scale @ basis.T
    moving = inputs[:, np.ptp(inputs, axis=0) > 0]
    features = np.hstack([z, moving, np.ones((len(z), 1))])
    norms = np.linalg.norm(features, axis=0)
    solved = np.linalg.lstsq(features / norms, later, rcond=1e-8)[0] / norms[:, None]
    values, vectors = np.linalg.eig(solved[:size].T)
    amplitude = np.abs(np.linalg.solve(vectors, z.T.astype(complex)))
    share = np.sqrt(np.mean(amplitude ** 2, axis=1)) * np.linalg.norm(vectors, axis=0)
    share = share / share.max()
    with np.errstate(divide="ignore"):
        rates = np.log(values.astype(complex)) / step
    turning = (rates.imag > -1e-9) & (rates.imag < 3.1 / step)  # one of each pair, below the Nyquist frequency
    kept = (share > WEAKEST) & (rates.real < 0) & turning
    order = np.argsort(-rates[kept].real)
    return rates[kept][order], share[kept][order]
