"""Errors, constraint violations and solve times of predictions and closed loops, computed from arrays."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

SETTLING_TIME = 1.0
TIME_TOLERANCE = 1e-9
# s, time between the points of a path at which obstacles are checked
JUDGED_EVERY = 1e-3


class SolveTimes(NamedTuple):
    """median, p99, maximum: s; late: share of the solves that took longer than the control period."""

    median: float
    p99: float
    maximum: float
    late: float


class Violations(NamedTuple):
    """ratio: share of the samples inside an obstacle; maximum: largest penetration depth, m (0 if there is none).
    """

    ratio: float
    maximum: float


def rollout_rmse(predicted: np.ndarray, measured: np.ndarray, steps: np.ndarray | None = None) -> np.ndarray:
    """Root mean square of the error's norm over one rollout, √(1/H Σ_{k=1..H} ‖ŷ_k − y_k‖²).

    predicted, measured: (..., H, p), only the predicted samples k = 1, …, H. The initial sample is known and would make
    the error too small. steps: (...,), number of samples that count in each rollout, default H; later samples are
    padding. Returns (...,) in the unit of y; a prediction that is not finite gives an infinite or NaN error.
    Raises ValueError when the shapes differ, there is no sample, or `steps` is outside 1 … H.
    """
    squares, counted, steps = _squares(predicted, measured, steps)
    with np.errstate(over="ignore", invalid="ignore"):
        return np.sqrt(np.where(counted, squares, 0.0).sum(axis=-1) / steps)


def rollout_nmte(predicted: np.ndarray, measured: np.ndarray, size: np.ndarray,
                 steps: np.ndarray | None = None) -> np.ndarray:
    """Normalized mean trajectory error of one rollout, (1/H Σ_{k=1..H} ‖ŷ_k − y_k‖) / max ‖y‖, no unit.

    As in SSMLearn: the mean of the error's norm, divided by the largest norm of the measured trajectory. size: (...,),
    that norm over the whole trajectory to which the rollout belongs; the norm over a rollout near rest would make every
    error look large. Other arguments as in `rollout_rmse`. If size is zero, the result is 0 for an exact prediction and
    infinite otherwise.
    """
    squares, counted, steps = _squares(predicted, measured, steps)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        norms = np.where(counted, np.sqrt(squares), 0.0).sum(axis=-1) / steps
        return np.where(norms == 0, 0.0, norms / np.asarray(size))


def tracking_error(time: np.ndarray, position: np.ndarray, reference: np.ndarray, *,
                   axes: Sequence[int] | None = None, settling_time: float = SETTLING_TIME) -> np.ndarray:
    """‖e_k‖ = ‖y_k − r_k‖ over the task's axes, for the samples with t_k − t_0 ≥ settling_time.

    time: (T,) s; position, reference: (T, p) m; axes: columns that the task prescribes, default all. Returns
    (K,) m. Raises ValueError if the shapes differ, a number is not finite, or the run ends before settling_time.
    """
    position, reference = _same_shape(position, reference, lowest_rank=2)
    time = np.asarray(time, dtype=np.float64)
    if time.shape != position.shape[:1]:
        raise ValueError(f"time has shape {time.shape}; expected {position.shape[:1]}, one per sample")
    columns = slice(None) if axes is None else list(axes)
    error = np.linalg.norm(position[:, columns] - reference[:, columns], axis=-1)
    if not np.isfinite(error).all():
        raise ValueError(f"{np.sum(~np.isfinite(error))} of {len(error)} tracking errors are not finite, the first at "
                         f"sample {np.argmin(np.isfinite(error))}; a run that stopped early has no tracking error")
    counted = time - time[0] >= settling_time - TIME_TOLERANCE
    if not counted.any():
        raise ValueError(f"the run lasts {time[-1] - time[0]:.4g} s, less than the settling time of "
                         f"{settling_time:.4g} s; make the task longer or settling_time shorter")
    return error[counted]


def integral_squared_error(time: np.ndarray, position: np.ndarray, reference: np.ndarray,
                           **selection) -> float:
    """ISE = Σ ‖e_k‖² over the samples with t ≥ 1 s, m²; a sum, not multiplied by the sampling time.

    Arguments and errors are those of `tracking_error`. Compare only runs with equal sampling time and length.
    """
    return float((tracking_error(time, position, reference, **selection) ** 2).sum())


def tracking_rmse(time: np.ndarray, position: np.ndarray, reference: np.ndarray, **selection) -> float:
    """√(mean_k ‖e_k‖²) over the samples with t ≥ 1 s, m. Arguments and errors are those of `tracking_error`.
    """
    return float(np.sqrt((tracking_error(time, position, reference, **selection) ** 2).mean()))


def max_tracking_error(time: np.ndarray, position: np.ndarray, reference: np.ndarray, **selection) -> float:
    """max_k ‖e_k‖ over the samples with t ≥ 1 s, m. Arguments and errors are those of `tracking_error`."""
    return float(tracking_error(time, position, reference, **selection).max())


def relative_ise(ise: float, reference_ises: Sequence[float]) -> float:
    """(ISE / mean reference ISE − 1) · 100, in %: by how much an ISE exceeds the mean ISE of the reference method.

    Raises ValueError without reference runs, if an ISE is negative, or if all reference ISEs are zero.
    """
    reference_ises = np.asarray(reference_ises, dtype=np.float64)
    if not (ise >= 0 and reference_ises.size and (reference_ises >= 0).all() and reference_ises.mean() > 0):
        raise ValueError(f"ISE {ise} against reference ISEs {reference_ises.tolist()}; expected values of 0 "
                         "or more and a reference with a positive mean")
    return float((ise / reference_ises.mean() - 1.0) * 100.0)


def violations(depth: np.ndarray) -> Violations:
    """Share of the samples with penetration depth > 0, and the largest depth.

    depth: (T,) or (T, obstacles) m, positive inside an obstacle; a sample inside several obstacles counts once.
    Raises ValueError when depth is empty in time or not finite.
    """
    depth = np.asarray(depth, dtype=np.float64)
    if depth.ndim not in (1, 2) or len(depth) == 0 or not np.isfinite(depth).all():
        raise ValueError(f"penetration depths of shape {depth.shape}; expected (T,) or (T, obstacles), "
                         "T ≥ 1, all finite")
    deepest = depth.reshape(len(depth), -1).max(axis=1, initial=0.0)
    return Violations(float((deepest > 0).mean()), float(deepest.max()))


def solve_times(seconds: np.ndarray, period: float) -> SolveTimes:
    """Median, 99th percentile and maximum of the solve times, and the share longer than the control period.

    seconds: (K,) s; period: s. Raises ValueError without values, or if one is negative or not finite.
    """
    seconds = np.asarray(seconds, dtype=np.float64)
    valid = seconds.ndim == 1 and len(seconds) > 0 and (np.isfinite(seconds) & (seconds >= 0)).all()
    if not (valid and period > 0):
        raise ValueError(f"solve times of shape {seconds.shape} against a period of {period} s; expected "
                         "(K,), K ≥ 1, finite and not negative, and a positive period")
    return SolveTimes(float(np.median(seconds)), float(np.percentile(seconds, 99)), float(seconds.max()),
                      float((seconds > period).mean()))


def resampled(time: np.ndarray, position: np.ndarray, spacing: float = JUDGED_EVERY) -> tuple[np.ndarray, np.ndarray]:
    """Times (K,), s, and positions (K, q), m, of a cubic spline there. The times are `spacing` apart and include the
    times of all samples.

    time (T,) s, increasing; position (T, q) m, finite. The spline passes through every sample, with continuous velocity
    and acceleration (SciPy's CubicSpline, not-a-knot). Raises ValueError for times that do not increase, or numbers
    that are not finite.
    """
    from scipy.interpolate import CubicSpline  # imported here so that a controller needs no SciPy

    parts = np.maximum(np.ceil(np.diff(time) / spacing - TIME_TOLERANCE).astype(int), 1)
    between = [np.linspace(start, end, count, endpoint=False) for start, end, count in zip(time, time[1:], parts)]
    times = np.concatenate([*between, time[-1:]])
    return times, CubicSpline(time, position)(times) if len(time) > 1 else np.array(position)


def obstacle_violations(time: np.ndarray, position: np.ndarray, obstacles) -> Violations:
    """`violations` of obstacles (`clearance(time, position)`) along the path `resampled` at 1 ms, also between samples.

    time (T,) s; position (T, q) m in the tracked outputs. Raises the errors of `resampled`.
    """
    time, position = resampled(time, position)
    return violations(-np.stack([obstacle.clearance(time, position) for obstacle in obstacles], axis=1))


def closed_loop_metrics(record, obstacles=()) -> dict[str, float]:
    """ISE (m²), RMSE and largest error (m), solve times (s), and fallbacks of a `ClosedLoopRecord`.

    With obstacles also the share of the time inside one, and the largest depth (m), see `obstacle_violations`. For
    plans under constraints also the largest violation that a plan predicted, margins included (m), and the number of
    steps in which hard constraints had to be softened.
    """
    position = record.observation[:, list(record.tracked)]
    arguments = (record.time, position, record.reference)
    times = solve_times(record.solve_time[np.isfinite(record.solve_time)], record.provenance["period"])
    found = {"ise": integral_squared_error(*arguments), "rmse": tracking_rmse(*arguments),
             "max_error": max_tracking_error(*arguments), "solve_time_median": times.median,
             "solve_time_p99": times.p99, "fallbacks": float(record.fallback.sum())}
    if obstacles:
        inside = obstacle_violations(record.time, position, obstacles)
        found |= {"violation_ratio": inside.ratio, "max_violation": inside.maximum}
    planned = record.violation[np.isfinite(record.violation)]
    if len(planned):
        found |= {"planned_violation": float(planned.max()),
                  "softened": float(sum(status == "SOFTENED" for status in record.statuses))}
    return found


def _squares(predicted: np.ndarray, measured: np.ndarray, steps: np.ndarray | None) -> tuple[np.ndarray, ...]:
    """‖ŷ_k − y_k‖² (..., H), whether each of them counts, and how many count (...,)."""
    predicted, measured = _same_shape(predicted, measured, lowest_rank=2)
    horizon = predicted.shape[-2]
    with np.errstate(over="ignore", invalid="ignore"):
        squares = ((predicted - measured) ** 2).sum(axis=-1)
    steps = np.full(squares.shape[:-1], horizon) if steps is None else np.asarray(steps)
    if steps.shape != squares.shape[:-1] or (steps < 1).any() or (steps > horizon).any():
        raise ValueError(f"steps has shape {steps.shape} and values {steps.min()} to {steps.max()}; "
                         f"expected shape {squares.shape[:-1]} and values 1 to {horizon}")
    return squares, np.arange(1, horizon + 1) <= steps[..., None], steps


def _same_shape(first: np.ndarray, second: np.ndarray, lowest_rank: int) -> tuple[np.ndarray, np.ndarray]:
    first, second = np.asarray(first, dtype=np.float64), np.asarray(second, dtype=np.float64)
    if first.shape != second.shape or first.ndim < lowest_rank or first.size == 0:
        raise ValueError(f"the two arrays have shapes {first.shape} and {second.shape}; "
                         "expected the same shape (..., samples, outputs), with at least one sample")
    return first, second
