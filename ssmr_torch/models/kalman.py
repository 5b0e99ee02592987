"""The extended Kalman filter in discrete time [Kalman 1960; Gelb 1974, section 6.1].

Written with arithmetic and matrix products only, and a `solve` that is given, so that the same lines serve NumPy arrays
and Torch tensors, batched over leading dimensions.
"""

from collections.abc import Callable
from typing import Any, NamedTuple


class Noise(NamedTuple):
    """What a filter assumes: N(mean (n,), covariance (n, n)) for the state before anything is measured, and the
    covariances of what each step, process (n, n), and each measurement, (p, p) m², add.
    """

    mean: Any
    covariance: Any
    process: Any
    measurement: Any


def predict(model, z, covariance, u, process):
    """State z (..., n) and its covariance one base_timestep later with u held: z⁺ = f(z, u), P⁺ = A P Aᵀ + Q.

    model: with `advance_linearization`, such as a `DiscreteTimeModel`.
    """
    following, A, _ = model.advance_linearization(z, u)
    return following, A @ covariance @ A.swapaxes(-1, -2) + process


def correct(model, z, covariance, y, measurement, solve: Callable):
    """State and covariance after y (..., p) was measured: z + K (y − w(z)), P − K C P, K = P Cᵀ (C P Cᵀ + R)⁻¹.

    solve(S, X) → S⁻¹ X for stacks of matrices: `numpy.linalg.solve` or `torch.linalg.solve`.
    """
    C, _ = model.linearize_output(z)
    seen = C @ covariance
    gain = solve(seen @ C.swapaxes(-1, -2) + measurement, seen).swapaxes(-1, -2)
    covariance = covariance - gain @ seen
    return (z + (gain @ (y - model.decode(z))[..., None])[..., 0],
            0.5 * (covariance + covariance.swapaxes(-1, -2)))


def filter_window(model, window, inputs, noise: Noise, repeats: int, solve: Callable):
    """State (..., n) at the newest sample of a window (..., n_d + 1, p), inputs (..., n_d, m) held between samples.

    repeats: base timesteps between two samples.
    """
    mean = noise.mean + 0.0 * window[..., 0, :1]
    z, covariance = correct(model, mean, noise.covariance, window[..., 0, :], noise.measurement, solve)
    for k in range(inputs.shape[-2]):
        for _ in range(repeats):
            z, covariance = predict(model, z, covariance, inputs[..., k, :], noise.process)
        z, covariance = correct(model, z, covariance, window[..., k + 1, :], noise.measurement, solve)
    return z
