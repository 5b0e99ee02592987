"""The extended Kalman filter in discrete time [Kalman 1960; Gelb 1974, section 6.1].

Only arithmetic and matrix products are used. The same lines therefore work for NumPy and Torch, for batches in the
leading dimensions, and in exported programs.
"""

from typing import NamedTuple

from ssmr_torch.models.arrays import Array, namespace


class Noise(NamedTuple):
    """The noise that a filter assumes. The state has the distribution N(mean (n,), covariance (n, n)) before the first
    measurement. Each step adds noise of covariance process (n, n), each measurement noise of covariance measurement
    (p, p), m².
    """

    mean: Array
    covariance: Array
    process: Array
    measurement: Array


def predict(model, z: Array, covariance: Array, u: Array, process: Array) -> tuple[Array, Array]:
    """State z (..., n) and its covariance one base_timestep later with u held: z⁺ = f(z, u), P⁺ = A P Aᵀ + Q.

    model: any model that has `advance_linearization`, such as a `PiecewiseLinearModel`.
    """
    following, A, _ = model.advance_linearization(z, u)
    return following, A @ covariance @ A.swapaxes(-1, -2) + process


def correct(model, z: Array, covariance: Array, y: Array, measurement: Array) -> tuple[Array, Array]:
    """State and covariance after a measurement y (..., p): z + K (y − w(z)), P − K C P, K = P Cᵀ (C P Cᵀ + R)⁻¹."""
    C, _ = model.linearize_output(z)
    seen = C @ covariance
    gain = solve(seen @ C.swapaxes(-1, -2) + measurement, seen).swapaxes(-1, -2)
    covariance = covariance - gain @ seen
    return (z + (gain @ (y - model.decode(z))[..., None])[..., 0],
            0.5 * (covariance + covariance.swapaxes(-1, -2)))


def filter_window(model, window: Array, inputs: Array, noise: Noise, repeats: int) -> Array:
    """State (..., n) at the newest sample of a window (..., n_d + 1, p), inputs (..., n_d, m) held between samples.

    repeats: base timesteps between two samples. Raises ValueError unless there is exactly one sample more than inputs.
    """
    if window.shape[-2] != inputs.shape[-2] + 1:
        raise ValueError(f"a window of {window.shape[-2]} samples and {inputs.shape[-2]} inputs between them; expected "
                         "one sample more than inputs")
    mean = noise.mean + 0.0 * window[..., 0, :1]
    z, covariance = correct(model, mean, noise.covariance, window[..., 0, :], noise.measurement)
    for k in range(inputs.shape[-2]):
        for _ in range(repeats):
            z, covariance = predict(model, z, covariance, inputs[..., k, :], noise.process)
        z, covariance = correct(model, z, covariance, window[..., k + 1, :], noise.measurement)
    return z


def solve(S: Array, X: Array) -> Array:
    """S⁻¹ X for a positive definite S (..., p, p) and X (..., p, n), by elimination without pivots.

    It is written out because programs in ONNX have no linear solver.
    """
    xp, both = namespace(X), namespace(X).concatenate([S, X], -1)
    rows = [both[..., k, :] for k in range(S.shape[-1])]
    for k in range(len(rows)):
        pivot = rows[k] / rows[k][..., k:k + 1]
        rows = [pivot if i == k else row - row[..., k:k + 1] * pivot for i, row in enumerate(rows)]
    return xp.stack(rows, -2)[..., S.shape[-1]:]
