"""Compiled checks of a quadratic program: whether it is well posed, and how far a point is from solving it."""

from __future__ import annotations

import numpy as np

from ssmr_torch.control.condensing import compiled

SOUND, NOT_FINITE, CROSSED, TOO_LARGE = 0, 1, 2, 3


@compiled
def soundness(H, g, lower, upper, C, row_lower, row_upper, limit):
    """NOT_FINITE for a cost, row or bound that is not a usable number; CROSSED for crossed bounds; TOO_LARGE for an
    entry of the cost beyond the limit.
    """
    total, largest = 0.0, 0.0
    for i in range(len(g)):
        total += 0.0 * g[i]
        largest = max(largest, abs(g[i]))
        for j in range(len(g)):
            total += 0.0 * H[i, j]
            largest = max(largest, abs(H[i, j]))
    for q in range(len(row_lower)):
        for i in range(len(g)):
            total += 0.0 * C[q, i]
    crossed = False
    for i in range(len(g)):
        if np.isnan(lower[i]) or np.isnan(upper[i]):
            return NOT_FINITE
        crossed = crossed or lower[i] > upper[i]
    for q in range(len(row_lower)):
        if np.isnan(row_lower[q]) or np.isnan(row_upper[q]):
            return NOT_FINITE
        crossed = crossed or row_lower[q] > row_upper[q]
    if total != 0.0:
        return NOT_FINITE
    if crossed:
        return CROSSED
    return TOO_LARGE if largest > limit else SOUND


@compiled
def drop_absent(multipliers, lower, upper):
    """Set multipliers of infinite bounds to zero, in place; rounding may have left them different."""
    for i in range(len(multipliers)):
        bound = upper[i] if multipliers[i] > 0.0 else lower[i]
        if np.isinf(bound):
            multipliers[i] = 0.0


@compiled
def kkt_residuals(H, g, lower, upper, C, row_lower, row_upper, x, box, rows):
    """Four numbers: the largest violation of a bound; ‖H x + g + w + Cᵀ z‖_∞; xᵀ H x + gᵀ x + Σ bound · multiplier;
    and 1 + |x| + |w| + |z| with sums of absolute values. NaN where anything is not finite. Multipliers of absent bounds
    are set to zero first.
    """
    drop_absent(box, lower, upper)
    drop_absent(rows, row_lower, row_upper)
    d, r = len(g), len(row_lower)
    primal, dual, gap, weight = 0.0, 0.0, 0.0, 1.0
    for i in range(d):
        stationarity = g[i] + box[i]
        Hx = 0.0
        for j in range(d):
            Hx += H[i, j] * x[j]
        stationarity += Hx
        for q in range(r):
            stationarity += C[q, i] * rows[q]
        primal, dual = max(primal, lower[i] - x[i], x[i] - upper[i]), max(dual, abs(stationarity))
        gap += x[i] * (Hx + g[i])
        if box[i] != 0.0:
            gap += box[i] * (upper[i] if box[i] > 0.0 else lower[i])
        weight += abs(x[i]) + abs(box[i])
    for q in range(r):
        Cx = 0.0
        for i in range(d):
            Cx += C[q, i] * x[i]
        primal = max(primal, row_lower[q] - Cx, Cx - row_upper[q])
        if rows[q] != 0.0:
            gap += rows[q] * (row_upper[q] if rows[q] > 0.0 else row_lower[q])
        weight += abs(rows[q])
    if not np.isfinite(weight + gap):
        return np.nan, np.nan, np.nan, np.nan
    return primal, dual, abs(gap), weight
