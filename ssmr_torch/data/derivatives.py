"""Stencils for time derivatives of uniformly sampled signals, and the mean input that belongs to each derivative."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.signal import savgol_coeffs

from ssmr_torch.checked_arguments import checked
from ssmr_torch.ranges import Number, Whole


@dataclass(frozen=True)
class Stencil:
    """dz/dt(t_k) ≈ Σ_j weights[w + j] z(t_{k+j}) / h, j = -w … w.

    weights: (2w + 1,), dimensionless. Raises ValueError unless they are exact for straight lines: Σ weights = 0 and
    Σ j weights = 1.
    """

    weights: tuple[float, ...]
    name: str = "stencil"

    def __post_init__(self):
        weights = np.asarray(self.weights, dtype=np.float64)
        if len(weights) % 2 != 1 or len(weights) < 3:
            raise ValueError(f"{self.name}: {len(weights)} weights; expected an odd number of at least 3")
        offsets = np.arange(len(weights)) - len(weights) // 2
        if not (abs(weights.sum()) <= 1e-9 and abs(weights @ offsets - 1) <= 1e-9):
            raise ValueError(f"{self.name}: the sum of the weights is {weights.sum():.3g} and the derivative of a ramp "
                             f"of slope 1 is {weights @ offsets:.12g}; expected 0 and 1")
        object.__setattr__(self, "weights", tuple(weights.tolist()))

    @property
    def half_width(self) -> int:
        return len(self.weights) // 2

    def __call__(self, signal, timestep: float):
        """Signal (T, n) sampled every `timestep` s → derivative (T - 2w, n) at samples w … T - w - 1.

        It takes NumPy arrays and Torch tensors. A signal shorter than the stencil gives no rows.
        """
        rows = max(len(signal) - 2 * self.half_width, 0)
        return sum(weight * signal[j:j + rows] for j, weight in enumerate(self.weights)) / timestep

    def held_input(self, inputs):
        """Input (T, m), held between samples → the weighted mean input of each difference, (T - 2w, m).

        For dz/dt = u with u held, Σ_j a_j z_{k+j} / h = Σ_i b_i u_{k+i} with b_i = Σ_{j>i} a_j. The difference around
        t_k depends on the inputs before and after t_k; u_k alone would be late by half a sample.
        """
        felt = np.cumsum(self.weights[::-1])[::-1][1:]
        rows = max(len(inputs) - 2 * self.half_width, 0)
        return sum(float(weight) * inputs[i:i + rows] for i, weight in enumerate(felt))

    def sampled_input(self, inputs):
        """Input (T, m) at the samples of the derivative, (T - 2w, m)."""
        rows = max(len(inputs) - 2 * self.half_width, 0)
        return inputs[self.half_width:self.half_width + rows]


@checked(order=Whole(2, 20))
def central_difference(order: int = 6) -> Stencil:
    """Central difference of even order; order 6 has the weights ±3/4, ∓3/20, ±1/60."""
    if order < 2 or order % 2:
        raise ValueError(f"central difference of order {order}; expected an even order of at least 2")
    offsets = np.arange(-order // 2, order // 2 + 1, dtype=np.float64)
    conditions = np.vander(offsets, increasing=True).T
    weights = np.linalg.solve(conditions, np.eye(order + 1)[1])
    return Stencil(tuple(0.5 * (weights - weights[::-1])), f"central difference of order {order}")


@checked(window=Whole(3, 1001), degree=Whole(1, 10))
def savitzky_golay(window: int = 9, degree: int = 4) -> Stencil:
    """Derivative of the least-squares polynomial of this degree over `window` samples (SciPy's coefficients)."""
    if window % 2 != 1 or not 1 <= degree < window:
        raise ValueError(f"Savitzky-Golay with window {window} and degree {degree}; "
                         "expected an odd window and 1 ≤ degree < window")
    return Stencil(tuple(savgol_coeffs(window, degree, deriv=1, use="dot")),
                   f"Savitzky-Golay, {window} samples, degree {degree}")


@checked(width=Number(0.25, 1e3))
def gaussian(width: float = 1.5) -> Stencil:
    """Derivative of the signal smoothed by a Gaussian of standard deviation `width` samples (SciPy's filter)."""
    if not 0.25 <= width < np.inf:
        raise ValueError(f"Gaussian width {width} samples; expected at least 0.25, to include neighbouring samples")
    half = int(np.ceil(4 * width))
    impulse = np.zeros(4 * half + 1)
    impulse[2 * half] = 1.0
    weights = gaussian_filter1d(impulse, width, order=1)[half:3 * half + 1][::-1]
    weights = 0.5 * (weights - weights[::-1])
    return Stencil(tuple(weights / (weights @ (np.arange(2 * half + 1) - half))), f"Gaussian, {width:g} samples")
