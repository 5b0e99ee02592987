"""Errors, losses and times by which designed.py judges one closed loop."""

from __future__ import annotations

import numpy as np

from ssmr_torch.evaluation.metrics import closed_loop_metrics, integral_squared_error

SETTLING, APPROACH = 1.0, 2.0  # s, after which errors count
LOST, PATIENCE = 0.05, 0.3     # of the reach beyond the static floor, for so many s on end: the loop is lost
OUT_OF_REACH = 1e-3            # of the reach: a static floor above it


def finite(value: float) -> float | None:
    """The value as JSON has it: None where it is not finite."""
    return float(value) if np.isfinite(value) else None


def measured(record, task, controller, reach: float, floor: list | None) -> dict:
    """Errors of a run, m: rms after 1 s and after the approach, there also where the path is within static reach; ISE,
    m²; lost: whether it was further away than `LOST` beyond the floor for `PATIENCE`; share of the time at a bound of
    an input; fallbacks, counts, times, s.
    """
    error = np.linalg.norm(record.error, axis=1)
    late = record.time >= APPROACH
    floor = np.array([0.0] if floor is None else floor)
    known = np.isfinite(floor)  # the model did not come to rest elsewhere: no excuse is made
    least = np.interp(record.time, np.linspace(0.0, task.duration, len(floor)), np.where(known, floor, 0.0))
    within = late & (least <= OUT_OF_REACH * reach)
    beyond = ~(error[record.time >= SETTLING] - least[record.time >= SETTLING] <= LOST * reach)
    run = longest(beyond) * (record.time[1] - record.time[0])
    row = {"reach": reach, "rmse after 1 s": rms(error[record.time >= SETTLING]), "rmse": rms(error[late]),
           "rmse within": rms(error[within]), "within": float(within.sum() / late.sum()),
           "floor unknown": float((~known).mean()), "lost": bool(run >= PATIENCE),
           "at a bound": at_a_bound(record.input, controller.input_bounds),
           "counts": {name: int(count) for name, count in controller.counts.items() if count},
           "reasons": {getattr(reason, "name", str(reason)): count for reason, count in controller.fallbacks.items()}}
    if np.isfinite(error).all():
        found = closed_loop_metrics(record, task.obstacles)
        row |= {name: found[name] for name in ("ise", "max_error", "fallbacks", "solve_time_median", "solve_time_p99")}
        row |= {name: found[name] for name in ("violation_ratio", "max_violation") if name in found}
        row |= {"slowest step": float(np.nanmax(record.solve_time)),
                "static ise": integral_squared_error(record.time, least[:, None], np.zeros_like(least)[:, None])}
    return row


def at_a_bound(inputs: np.ndarray, bounds: np.ndarray) -> float:
    """Largest share of the samples at which one input was held by one of its bounds."""
    near = 1e-3 * np.ptp(bounds, axis=0)
    return float(max((inputs <= bounds[0] + near).mean(axis=0).max(), (inputs >= bounds[1] - near).mean(axis=0).max()))


def rms(error: np.ndarray) -> float | None:
    return finite(np.sqrt(np.square(error).mean())) if len(error) else None


def longest(marked: np.ndarray) -> int:
    """The longest run of marks on end."""
    most = count = 0
    for each in marked:
        count = count + 1 if each else 0
        most = max(most, count)
    return most
