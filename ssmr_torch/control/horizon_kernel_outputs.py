"""Compiled functions: outputs y = χ⁻¹(ξ) and their slopes from output coordinates, see `models.output_coordinates`.

markers: rows (first coordinate, first output, how many, weight, r₀, e), as `Mixture.markers` gives them.
"""

from __future__ import annotations

from ssmr_torch.control.condensing import compiled
from ssmr_torch.models.output_coordinates import COSINE, SINC, SINC_SLOPE, SPREAD


@compiled
def count_outputs(markers, coordinates):
    """p, the length of y; equal to the number of coordinates where there are no markers."""
    count = 0 if len(markers) else coordinates
    for k in range(len(markers)):
        count = max(count, int(markers[k, 1] + markers[k, 2]))
    return count


@compiled
def _series(coefficients, square):
    """Σ_k coefficients[k] (square / SPREAD)^k."""
    t, total = square / SPREAD, 0.0
    for k in range(len(coefficients) - 1, -1, -1):
        total = coefficients[k] + t * total
    return total


@compiled
def _bent(marker, xi, lateral):
    """Axial part and t = a² of a marker's coordinates; fills lateral (3,)."""
    first, count, r0, along, t = int(marker[0]), int(marker[2]), marker[4], 0.0, 0.0
    for i in range(count):
        along += xi[first + i] * marker[5 + i]
    for i in range(count):
        lateral[i] = (xi[first + i] - along * marker[5 + i]) / r0
        t += lateral[i] * lateral[i]
    return along, t


@compiled
def place(markers, xi, lateral, y):
    """y (p,) = χ⁻¹(ξ); lateral (3,) is scratch."""
    for i in range(len(y)):
        y[i] = 0.0
    for k in range(len(markers)):
        marker = markers[k]
        first, at, count, weight, r0 = int(marker[0]), int(marker[1]), int(marker[2]), marker[3], marker[4]
        if r0 == 0.0:
            for i in range(count):
                y[at + i] += weight * xi[first + i]
            continue
        along, t = _bent(marker, xi, lateral)
        sinc, cosine = _series(SINC, t), _series(COSINE, t)
        chord = (along + r0) * sinc
        for i in range(count):
            y[at + i] += weight * (chord * (cosine * marker[5 + i] + sinc * lateral[i]) - r0 * marker[5 + i])


@compiled
def place_slopes(markers, xi, D, lateral, C):
    """C (p, n) = ∂y/∂z of D (p', n) = ∂ξ/∂z; lateral (3,) is scratch."""
    p, n = C.shape
    for i in range(p):
        for j in range(n):
            C[i, j] = 0.0
    for k in range(len(markers)):
        marker = markers[k]
        first, at, count, weight, r0 = int(marker[0]), int(marker[1]), int(marker[2]), marker[3], marker[4]
        if r0 == 0.0:
            for i in range(count):
                for j in range(n):
                    C[at + i, j] += weight * D[first + i, j]
            continue
        along, t = _bent(marker, xi, lateral)
        sinc, cosine, slope = _series(SINC, t), _series(COSINE, t), _series(SINC_SLOPE, t)
        length = along + r0
        for j in range(n):
            d_along, d_t = 0.0, 0.0
            for i in range(count):
                d_along += marker[5 + i] * D[first + i, j]
                d_t += 2.0 / r0 * lateral[i] * D[first + i, j]
            d_chord = sinc * d_along + length * slope * d_t
            for i in range(count):
                e = marker[5 + i]
                turned = ((slope * lateral[i] - 0.5 * sinc * e) * d_t
                          + sinc * (D[first + i, j] - d_along * e) / r0)
                C[at + i, j] += weight * ((cosine * e + sinc * lateral[i]) * d_chord + length * sinc * turned)
