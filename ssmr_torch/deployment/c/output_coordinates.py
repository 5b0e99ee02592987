"""C text of output coordinates: from outputs to the model's coordinates, and back with their derivatives."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ssmr_torch.deployment.c.c_text import table
from ssmr_torch.models.output_coordinates import ARCTANGENT, COSINE, HALVINGS, SINC, SINC_SLOPE, SPREAD, TINY
from ssmr_torch.models.polynomial import PolynomialModel


class Coordinates(NamedTuple):
    """The coordinates' part of the file: enumerators, code, and doubles on the stack for encoding and for decoding."""

    sizes: dict[str, int]
    code: str
    encoding: int
    decoding: int


def coordinates(model: PolynomialModel) -> Coordinates:
    """The C text of a model's output coordinates; empty where it has none. Raises ValueError without a C form."""
    if model.coordinates is None:
        return Coordinates({}, "", 0, 0)
    markers, latent = model.coordinates.markers(), model.latent_dim
    if markers is None:
        raise ValueError(f"the output coordinates {model.coordinates.words} have no C form; C has constant-curvature "
                         "arcs, plain outputs and mixtures of these. Leave c out of the formats (torch, onnx and "
                         "casadi have them), or fit with coordinates of this package")
    code = (table("marker", markers[:, :3].astype(np.int64), "first coordinate, first output, how many")
            + table("arc", markers[:, 3:], "weight, length at rest or 0 for plain outputs, axis")
            + table("arctangent", np.array(ARCTANGENT), f"atan(x)/x by x^2 / {SPREAD:g}")
            + table("sinc", np.array(SINC), f"sin(a)/a by a^2 / {SPREAD:g}")
            + table("sinc_slope", np.array(SINC_SLOPE), "its derivative by a^2")
            + table("cosine", np.array(COSINE), "cos(a)") + SERIES.replace("@SPREAD@", repr(SPREAD))
            + TO_COORDINATES.replace("@TINY@", repr(TINY)) + FROM_COORDINATES)
    return Coordinates({"MARKERS": len(markers), "L": latent, "TERMS": len(SINC), "ARCTANGENTS": len(ARCTANGENT),
                        "HALVINGS": HALVINGS}, code,
                       (model.delays + 1) * latent + 3, latent * (1 + model.state_dim) + 3)


TO_COORDINATES = """\
/* xi (L): the coordinates of the outputs y (P) of one sample. */
static void to_coordinates(const double *y, double *xi)
{
    int i, k, q;
    for (k = 0; k < MARKERS; k++) {
        const double *from = y + marker[3 * k + 1], *axis = arc + 5 * k + 2, r0 = arc[5 * k + 1];
        double *to = xi + marker[3 * k], axial = 0.0, squares = @TINY@, adjacent, over_rho, along;
        q = marker[3 * k + 2];
        if (r0 == 0.0) {
            for (i = 0; i < q; i++)
                to[i] = from[i];
            continue;
        }
        for (i = 0; i < q; i++)
            axial += (from[i] + r0 * axis[i]) * axis[i];
        for (i = 0; i < q; i++) {
            to[i] = from[i] + r0 * axis[i] - axial * axis[i];
            squares += to[i] * to[i];
        }
        adjacent = axial;
        for (i = 0; i < HALVINGS; i++)
            adjacent += sqrt(adjacent * adjacent + squares);
        over_rho = series(arctangent, ARCTANGENTS, squares / (adjacent * adjacent)) * (1 << HALVINGS) / adjacent;
        along = (axial * axial + squares) * over_rho - r0;
        for (i = 0; i < q; i++)
            to[i] = r0 * over_rho * to[i] + along * axis[i];
    }
}

"""

FROM_COORDINATES = """\
/* y (P): the outputs of coordinates xi (L); where C is not NULL, C (P, N) = dy/dz of X (L, N) = dxi/dz. */
static void from_coordinates(const double *xi, const double *X, double *y, double *C)
{
    double lateral[3];
    int i, j, k, q;
    for (i = 0; i < P; i++)
        y[i] = 0.0;
    for (i = 0; C != NULL && i < P * N; i++)
        C[i] = 0.0;
    for (k = 0; k < MARKERS; k++) {
        const double weight = arc[5 * k], r0 = arc[5 * k + 1], *axis = arc + 5 * k + 2, *from = xi + marker[3 * k];
        const double *slopes = X + marker[3 * k] * N;
        double along = 0.0, t = 0.0, s, c, ds, *to = y + marker[3 * k + 1];
        q = marker[3 * k + 2];
        if (r0 == 0.0) {
            for (i = 0; i < q; i++)
                to[i] += weight * from[i];
            for (i = 0; C != NULL && i < q * N; i++)
                C[marker[3 * k + 1] * N + i] += weight * slopes[i];
            continue;
        }
        for (i = 0; i < q; i++)
            along += from[i] * axis[i];
        for (i = 0; i < q; i++) {
            lateral[i] = (from[i] - along * axis[i]) / r0;
            t += lateral[i] * lateral[i];
        }
        s = series(sinc, TERMS, t);
        c = series(cosine, TERMS, t);
        ds = series(sinc_slope, TERMS - 1, t);
        for (i = 0; i < q; i++)
            to[i] += weight * ((along + r0) * s * (c * axis[i] + s * lateral[i]) - r0 * axis[i]);
        for (j = 0; C != NULL && j < N; j++) {
            double d_along = 0.0, d_t = 0.0, d_chord;
            for (i = 0; i < q; i++) {
                d_along += axis[i] * slopes[i * N + j];
                d_t += 2.0 / r0 * lateral[i] * slopes[i * N + j];
            }
            d_chord = s * d_along + (along + r0) * ds * d_t;
            for (i = 0; i < q; i++) {
                const double turned = (ds * lateral[i] - 0.5 * s * axis[i]) * d_t
                                      + s * (slopes[i * N + j] - d_along * axis[i]) / r0;
                C[(marker[3 * k + 1] + i) * N + j] += weight * ((c * axis[i] + s * lateral[i]) * d_chord
                                                                + (along + r0) * s * turned);
            }
        }
    }
}

"""

SERIES = """\
/* The sum of coefficients[k] (square / @SPREAD@)^k. */
static double series(const double *coefficients, int terms, double square)
{
    const double t = square / @SPREAD@;
    double total = coefficients[terms - 1];
    int k;
    for (k = terms - 2; k >= 0; k--)
        total = coefficients[k] + t * total;
    return total;
}

"""

LATENT = "    double latent[(D + 1) * L];\n"

BEND = """\
    for (i = 0; i <= D; i++)
        to_coordinates(window + i * P, latent + i * L);
"""

DECODE = """\
static void decode_state(const double *z, double *y, double *C)
{
    double powers[QW], xi[L], slopes[L * N];
    multiply_out(z, N, output_parent, output_factor, QW - 1 - N, powers);
    output_times(powers, xi);
    if (C != NULL)
        output_slope_times(powers, slopes);
    from_coordinates(xi, slopes, y, C);
}

"""
