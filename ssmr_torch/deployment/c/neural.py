"""C text of a neural ordinary differential equation."""

from __future__ import annotations

import numpy as np

from ssmr_torch.deployment.c.c_text import Family, product, table, times
from ssmr_torch.deployment.c.steps import FLOW, flow_scratch
from ssmr_torch.models.neural import NeuralModel

CODE = """\
/* table (QF, N): the columns of the rate that depend on the input, with u held */
static void hold_table(const double *restrict rate_table, const double *restrict field_table, int columns, int rows,
                       const double *restrict u, double *restrict held)
{
    int i, j;
    for (i = 0; i < columns * rows; i++) {
        held[i] = rate_table[i];
        for (j = 0; j < M; j++)
            held[i] += field_table[i * M + j] * u[j];
    }
}

typedef struct {
    double rate[QF * N];
} Held;

/* The table of the rate over [1, z, last layer], with u held. */
static void hold(const double *u, int slopes, Held *held)
{
    (void)slopes;
    hold_table(drift, field, QF, N, u, held->rate);
}

/* One layer: out = tanh(out + bias). Where J is not NULL, its rows are multiplied by the slope of tanh. */
static void activate(const double *restrict bias, double *restrict out, double *restrict J)
{
    int i, j;
    for (i = 0; i < W; i++) {
        out[i] = tanh(out[i] + bias[i]);
        for (j = 0; j < N && J != NULL; j++)
            J[i * N + j] *= 1.0 - out[i] * out[i];
    }
}

static void rate(const Held *held, const double *z, double *k, double *F, double *G)
{
    double features[QF], layer[W], J[W * N], J_below[W * N];
    double *const last = features + 1 + N;
    int i, j, l, r;
    features[0] = 1.0;
    for (i = 0; i < N; i++)
        features[1 + i] = z[i];
    first_times(z, last);
    for (i = 0; i < W; i++)
        for (j = 0; j < N && F != NULL; j++)
            J[i * N + j] = first[j * W + i];
    activate(biases, last, F != NULL ? J : NULL);
    for (l = 0; l < L - 1; l++) {
        const double *weight = hidden + l * W * W;
        hidden_times(weight, last, layer);
        for (i = 0; i < W; i++)
            last[i] = layer[i];
        if (F != NULL) {
            for (i = 0; i < W * N; i++) {
                J_below[i] = J[i];
                J[i] = 0.0;
            }
            for (r = 0; r < W; r++)
                for (i = 0; i < W; i++)
                    for (j = 0; j < N; j++)
                        J[i * N + j] += weight[r * W + i] * J_below[r * N + j];
        }
        activate(biases + (l + 1) * W, last, F != NULL ? J : NULL);
    }
    held_rate_times(held->rate, features, k);
    if (F == NULL)
        return;
    field_times(features, G);
    for (i = 0; i < N; i++)
        for (j = 0; j < N; j++) {
            F[i * N + j] = held->rate[(1 + j) * N + i];
            for (r = 0; r < W; r++)
                F[i * N + j] += held->rate[(1 + N + r) * N + i] * J[r * N + j];
        }
}

"""

ENDS = """\
static void encode_window(const double *window, const double *inputs, double *z)
{
    (void)inputs;
    chart_times(window, z);
}

static void decode_state(const double *z, double *y, double *C)
{
    int i, j;
    output_times(z, y);
    for (i = 0; i < P && C != NULL; i++)
        for (j = 0; j < N; j++)
            C[i * N + j] = output[j * P + i];
}

"""


def neural(model: NeuralModel) -> Family:
    """dz/dt = (drift + Σ_j u_j field_j) · [1, z, h_L], the table held over a step."""
    n, m = model.state_dim, model.input_dim
    depth, width = model.biases.shape
    first, linear, constant = model.operators  # (w, n), (n, 1 + m, n + w), (n, 1 + m)
    affine = np.concatenate([constant[..., None], linear], axis=-1)
    features = affine.shape[-1]
    code = (table("drift", affine[:, 0].T, "rate without input over [1, z, last layer]")
            + times("field", affine[:, 1:].reshape(n * m, -1), "control field over [1, z, last layer]")
            + times("first", first, "first layer")
            + table("hidden", model.hidden_weight.swapaxes(1, 2), "hidden layers, each column by column")
            + table("biases", model.biases, "biases")
            + times("chart", model.chart, "chart, over the window")
            + times("output", model.parametrization, "outputs")
            + product("held_rate_times", n, features) + product("hidden_times", width, width) + CODE + FLOW + ENDS)
    scratch = flow_scratch(n, m) + features * (n + 1) + width * (1 + 2 * n)
    return Family({"W": width, "L": depth, "QF": features, "SUBSTEPS": model.substeps}, code, scratch, True)
