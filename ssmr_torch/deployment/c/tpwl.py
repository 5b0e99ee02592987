"""C text of a trajectory piecewise linear model. Its chart is a Kalman filter that runs through the window."""

from __future__ import annotations

from ssmr_torch.deployment.c.c_text import Family, product, table, times
from ssmr_torch.deployment.c.steps import map_scratch, map_steps
from ssmr_torch.models.piecewise_linear import PiecewiseLinearModel

DISTANCES = """\
/* Squared distance of the positions in z to point i, without the term that is the same for all points. */
static double distance(const double *z, int i)
{
    double both = 0.0, own = 0.0;
    int j;
    for (j = 0; j < N / 2; j++) {
        own += points[i * (N / 2) + j] * points[i * (N / 2) + j];
        both += z[j] * points[i * (N / 2) + j];
    }
    return own - 2.0 * both;
}

/* next = A_i z + B_i u + c_i */
static void local_map(int i, const double *z, const double *u, double *next)
{
    int r;
    for (r = 0; r < N; r++)
        next[r] = offsets[i * N + r];
    transition_times(transitions + i * N * N, z, next);
    actuation_times(actuations + i * N * M, u, next);
}

"""

NEAREST = """\
static void advance(const double *u, const double *z, double *next, double *F, double *G)
{
    double least = distance(z, 0);
    int i, j, nearest = 0;
    for (i = 1; i < POINTS; i++) {
        const double found = distance(z, i);
        if (found < least) {
            least = found;
            nearest = i;
        }
    }
    local_map(nearest, z, u, next);
    for (i = 0; i < N && F != NULL; i++) {
        for (j = 0; j < N; j++)
            F[i * N + j] = transitions[nearest * N * N + j * N + i];
        for (j = 0; j < M; j++)
            G[i * M + j] = actuations[nearest * N * M + j * N + i];
    }
}

"""

BLENDED = """\
static void blend(const double *z, double *weights)
{
    double least, sum = 0.0;
    int i;
    for (i = 0; i < POINTS; i++)
        weights[i] = distance(z, i);
    least = weights[0];
    for (i = 1; i < POINTS; i++)
        least = weights[i] < least ? weights[i] : least;
    for (i = 0; i < POINTS; i++) {
        weights[i] = exp((least - weights[i]) / (width * width));
        sum += weights[i];
    }
    for (i = 0; i < POINTS; i++)
        weights[i] /= sum;
}

/* F = d next/dz and G = d next/du: the blended tables, and how the weights change with the positions. */
static void blended_jacobians(const double *z, const double *u, const double *weights, const double *next, double *F,
                              double *G)
{
    double each[N], centre[N / 2];
    int i, j, r;
    for (i = 0; i < N * N; i++)
        F[i] = 0.0;
    for (i = 0; i < N * M; i++)
        G[i] = 0.0;
    for (j = 0; j < N / 2; j++)
        centre[j] = 0.0;
    for (i = 0; i < POINTS; i++)
        for (j = 0; j < N / 2; j++)
            centre[j] += weights[i] * points[i * (N / 2) + j];
    for (i = 0; i < POINTS; i++) {
        if (weights[i] == 0.0)
            continue;
        local_map(i, z, u, each);
        for (r = 0; r < N; r++) {
            for (j = 0; j < N / 2; j++)
                F[r * N + j] += 2.0 / (width * width) * weights[i] * each[r] * points[i * (N / 2) + j];
            for (j = 0; j < N; j++)
                F[r * N + j] += weights[i] * transitions[i * N * N + j * N + r];
            for (j = 0; j < M; j++)
                G[r * M + j] += weights[i] * actuations[i * N * M + j * N + r];
        }
    }
    for (r = 0; r < N; r++)
        for (j = 0; j < N / 2; j++)
            F[r * N + j] -= 2.0 / (width * width) * next[r] * centre[j];
}

static void advance(const double *u, const double *z, double *next, double *F, double *G)
{
    double weights[POINTS], each[N];
    int i, r;
    blend(z, weights);
    for (r = 0; r < N; r++)
        next[r] = 0.0;
    for (i = 0; i < POINTS; i++) {
        if (weights[i] == 0.0)
            continue;
        local_map(i, z, u, each);
        for (r = 0; r < N; r++)
            next[r] += weights[i] * each[r];
    }
    if (F != NULL)
        blended_jacobians(z, u, weights, next, F, G);
}

"""

FILTER = """\
/* X (P, N) = S^-1 X by elimination with row pivots; S (P, P) is lost. */
static void solve(double *S, double *X)
{
    int i, j, r, pivot;
    for (r = 0; r < P; r++) {
        pivot = r;
        for (i = r + 1; i < P; i++)
            pivot = fabs(S[i * P + r]) > fabs(S[pivot * P + r]) ? i : pivot;
        for (j = 0; j < P && pivot != r; j++) {
            const double kept = S[r * P + j];
            S[r * P + j] = S[pivot * P + j];
            S[pivot * P + j] = kept;
        }
        for (j = 0; j < N && pivot != r; j++) {
            const double kept = X[r * N + j];
            X[r * N + j] = X[pivot * N + j];
            X[pivot * N + j] = kept;
        }
        for (i = r + 1; i < P; i++) {
            const double factor = S[i * P + r] / S[r * P + r];
            for (j = r; j < P; j++)
                S[i * P + j] -= factor * S[r * P + j];
            for (j = 0; j < N; j++)
                X[i * N + j] -= factor * X[r * N + j];
        }
    }
    for (r = P - 1; r >= 0; r--)
        for (j = 0; j < N; j++) {
            for (i = r + 1; i < P; i++)
                X[r * N + j] -= S[r * P + i] * X[i * N + j];
            X[r * N + j] /= S[r * P + r];
        }
}

/* After y was measured: z + K (y - C z - d) and V - K C V, K = V C' (C V C' + measurement)^-1. */
static void correct(const double *y, double *z, double *V)
{
    double seen[P * N], gain[P * N], S[P * P], innovation[P], expected[P];
    int i, j, r;
    for (i = 0; i < P; i++)
        for (j = 0; j < N; j++) {
            seen[i * N + j] = 0.0;
            for (r = 0; r < N; r++)
                seen[i * N + j] += output[r * P + i] * V[r * N + j];
            gain[i * N + j] = seen[i * N + j];
        }
    for (i = 0; i < P; i++)
        for (j = 0; j < P; j++) {
            S[i * P + j] = measurement[i * P + j];
            for (r = 0; r < N; r++)
                S[i * P + j] += seen[i * N + r] * output[r * P + j];
        }
    solve(S, gain);
    decode_state(z, expected, NULL);
    for (i = 0; i < P; i++)
        innovation[i] = y[i] - expected[i];
    for (i = 0; i < N; i++)
        for (r = 0; r < P; r++) {
            z[i] += gain[r * N + i] * innovation[r];
            for (j = 0; j < N; j++)
                V[i * N + j] -= gain[r * N + i] * seen[r * N + j];
        }
    for (i = 0; i < N; i++)
        for (j = 0; j < i; j++)
            V[i * N + j] = V[j * N + i] = 0.5 * (V[i * N + j] + V[j * N + i]);
}

/* One base timestep later: the model's step, and F V F' + process. */
static void predict(const double *u, double *z, double *V)
{
    double next[N], F[N * N], G[N * M], T[N * N];
    int i, j, r;
    advance(u, z, next, F, G);
    for (i = 0; i < N; i++) {
        z[i] = next[i];
        for (j = 0; j < N; j++) {
            T[i * N + j] = 0.0;
            for (r = 0; r < N; r++)
                T[i * N + j] += F[i * N + r] * V[r * N + j];
        }
    }
    for (i = 0; i < N; i++)
        for (j = 0; j < N; j++) {
            V[i * N + j] = process[i * N + j];
            for (r = 0; r < N; r++)
                V[i * N + j] += T[i * N + r] * F[j * N + r];
        }
}

static void encode_window(const double *window, const double *inputs, double *z)
{
    double V[N * N];
    int i, k, repeat;
    for (i = 0; i < N; i++)
        z[i] = mean[i];
    for (i = 0; i < N * N; i++)
        V[i] = covariance[i];
    correct(window, z, V);
    for (k = 0; k < D; k++) {
        for (repeat = 0; repeat < WINDOW_REPEATS; repeat++)
            predict(inputs + k * M, z, V);
        correct(window + (k + 1) * P, z, V);
    }
}

"""

DECODE = """\
static void decode_state(const double *z, double *y, double *C)
{
    int i, j;
    output_times(z, y);
    for (i = 0; i < P; i++) {
        y[i] += output_rest[i];
        for (j = 0; j < N && C != NULL; j++)
            C[i * N + j] = output[j * P + i];
    }
}

"""


def tpwl(model: PiecewiseLinearModel) -> Family:
    """The C text of the local maps: the nearest point's map, or a blend where the model has a width."""
    n, m, count = model.state_dim, model.input_dim, len(model.points)
    repeats = model.repeats
    code = (table("points", model.points, "positions of the points")
            + table("transitions", model.A.swapaxes(1, 2), "A_i, each column by column")
            + table("actuations", model.B.swapaxes(1, 2), "B_i, each column by column")
            + table("offsets", model.c, "c_i")
            + times("output", model.C, "outputs") + table("output_rest", model.d, "outputs where the state is zero")
            + "".join(table(name, getattr(model, name), f"filter: {name}")
                      for name in ("mean", "covariance", "process", "measurement"))
            + product("transition_times", n, n, accumulate=True) + product("actuation_times", n, m, accumulate=True)
            + DISTANCES)
    if model.width > 0.0:
        code += f"static const double width = {model.width!r};\n\n" + BLENDED
    else:
        code += NEAREST
    code += map_steps(repeats) + DECODE + FILTER
    blended = count + 3 * n if model.width > 0.0 else 0
    scratch = blended + max(map_scratch(n, m, repeats), n * (3 * n + m + 1))
    return Family({"POINTS": count, "REPEATS": repeats, "WINDOW_REPEATS": model.window_steps}, code, scratch, True)
