"""A lifted linear or bilinear model in C."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ssmr_torch.deployment.c_monomials import MULTIPLY_OUT, CMonomials
from ssmr_torch.deployment.c_steps import map_scratch, map_steps
from ssmr_torch.deployment.c_text import Family, product, table, times
from ssmr_torch.models.integrators import map_linearization, whole_multiple
from ssmr_torch.models.koopman_tables import KoopmanTables

PROPAGATE = """\
/* x (R) = A z + B u + sum of u_j N_j z; where F is not NULL, F (R, N) = dx/dz and G (R, M) = dx/du. */
static void propagate(const double *z, const double *u, double *x, double *F, double *G)
{
    double part[R];
    int i, j, r;
    transition_times(z, x);
    actuation_times(u, part);
    for (i = 0; i < R; i++)
        x[i] += part[i];
    for (i = 0; i < R && F != NULL; i++) {
        for (r = 0; r < N; r++)
            F[i * N + r] = transition[r * R + i];
        for (j = 0; j < M; j++)
            G[i * M + j] = actuation[j * R + i];
    }
@BILINEAR@}

"""

BILINEAR = """\
    for (j = 0; j < M; j++) {
        bilinear_times(bilinear + j * N * R, z, part);
        for (i = 0; i < R; i++) {
            x[i] += u[j] * part[i];
            if (F == NULL)
                continue;
            G[i * M + j] += part[i];
            for (r = 0; r < N; r++)
                F[i * N + r] += u[j] * bilinear[j * N * R + r * R + i];
        }
    }
"""

KEPT = """\
static void advance(const double *z, const double *u, double *next, double *F, double *G)
{
    propagate(z, u, next, F, G);
}

"""

LIFTED_ANEW = """\
/* Rows FIRST and on of the Jacobian of [1, x, products of x] times T (O, columns) = dx/d... */
static void lift_rows(const double *x, const double *powers, const double *T, int columns, double *rows)
{
    int i, j;
    for (j = 0; j < columns; j++) {
        if (FIRST == 0)
            rows[j] = 0.0;
        for (i = 0; i < O; i++)
            rows[(1 + i - FIRST) * columns + j] = T[i * columns + j];
    }
    for (i = 0; i < Q - 1 - O; i++) {
        const int parent = lifting_parent[i], factor = lifting_factor[i];
        for (j = 0; j < columns; j++)
            rows[(1 + O + i - FIRST) * columns + j] = x[factor] * rows[(parent - FIRST) * columns + j]
                                                      + powers[parent] * T[factor * columns + j];
    }
}

static void advance(const double *z, const double *u, double *next, double *F, double *G)
{
    double x[R], powers[Q], T[R * N], T_u[R * M];
    int i;
    propagate(z, u, x, F == NULL ? NULL : T, T_u);
    multiply_out(x, O, lifting_parent, lifting_factor, Q - 1 - O, powers);
    for (i = 0; i < N; i++)
        next[i] = powers[FIRST + i];
    if (F == NULL)
        return;
    lift_rows(x, powers, T, N, F);
    lift_rows(x, powers, T_u, M, G);
}

"""

ENDS = """\
/* Newest sample first, of outputs and of inputs, each divided by its scale, then lifted. */
static void encode_window(const double *window, const double *inputs, double *z)
{
    double x[O], powers[Q];
    int i, k;
    for (k = 0; k <= D; k++)
        for (i = 0; i < P; i++)
            x[k * P + i] = window[(D - k) * P + i] / scale[k * P + i];
    for (k = 0; k < INPUT_DELAYS; k++)
        for (i = 0; i < M; i++)
            x[(D + 1) * P + k * M + i] = inputs[(D - 1 - k) * M + i] / scale[(D + 1) * P + k * M + i];
    multiply_out(x, O, lifting_parent, lifting_factor, Q - 1 - O, powers);
    for (i = 0; i < N; i++)
        z[i] = powers[FIRST + i];
}

static void decode_state(const double *z, double *y, double *C)
{
    int i, j;
    for (i = 0; i < P; i++) {
        y[i] = scale[i] * z[1 - FIRST + i];
        for (j = 0; j < N && C != NULL; j++)
            C[i * N + j] = j == 1 - FIRST + i ? scale[i] : 0.0;
    }
}

"""


def koopman(model: KoopmanTables) -> Family:
    """A, B, N_j, and the lifting as products; repeats of a linear map that is not lifted anew become one map."""
    n, m, bilinear = model.state_dim, model.input_dim, len(model.N)
    repeats = whole_multiple(model.timestep, model.base_timestep)
    if repeats > 1 and not bilinear and not model.relift:
        model, repeats = _repeated(model, repeats), 1
    lifting, rows = CMonomials(model.monomials), len(model.A)
    code = (MULTIPLY_OUT + lifting.declare("lifting") + table("scale", model.scale, "scale of what is lifted")
            + times("transition", model.A, "A") + times("actuation", model.B, "B"))
    if bilinear:  # the same product serves every N_j, at its place in the table
        code += (table("bilinear", model.N.transpose(0, 2, 1), "N_j, each column by column")
                 + product("bilinear_times", rows, n))
    code += PROPAGATE.replace("@BILINEAR@", BILINEAR if bilinear else "")
    code += (LIFTED_ANEW if model.relift else KEPT) + map_steps(repeats) + ENDS
    sizes = {"R": rows, "O": len(model.scale), "Q": lifting.size, "FIRST": 0 if model.constant else 1,
             "INPUT_DELAYS": model.input_delays, "REPEATS": repeats}
    scratch = map_scratch(n, m, repeats) + rows + lifting.size + (rows * (n + m + 1) if model.relift else 0)
    return Family(sizes, code, scratch)


def _repeated(model: KoopmanTables, repeats: int) -> KoopmanTables:
    """The linear map over all repeats."""
    zero = np.zeros(model.state_dim)
    _, A, B = map_linearization(lambda z: (z, model.A, model.B), zero, repeats)
    return replace(model, A=A, B=B, base_timestep=model.timestep)
