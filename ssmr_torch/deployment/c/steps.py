"""C text of one step with its exact sensitivities: of a flow by Runge-Kutta, and of a repeated map."""

# A family of flows defines Held, hold(u, slopes, held), and rate(held, z, k, F, G): k = dz/dt, and where F is not NULL
# F = dk/dz and G = dk/du. S = [dz/dz_0, dz/du] is carried through the stages, as in `control.horizon_kernel`.
FLOW = """\
/* K (N, N + M) = F S + [0, G] */
static void carry(const double *restrict F, const double *restrict G, const double *restrict S, double *restrict K)
{
    int i, j, r;
    for (i = 0; i < N; i++) {
        for (j = 0; j < N; j++)
            K[i * (N + M) + j] = 0.0;
        for (j = 0; j < M; j++)
            K[i * (N + M) + N + j] = G[i * M + j];
        for (r = 0; r < N; r++)
            for (j = 0; j < N + M; j++)
                K[i * (N + M) + j] += F[i * N + r] * S[r * (N + M) + j];
    }
}

/* Stage 0 to 3 of the classical Runge-Kutta step of length h: x from the start and the sum of the slopes so far. */
static void advance_stage(int stage, double h, int size, const double *restrict start, const double *restrict k,
                          double *restrict total, double *restrict x)
{
    const double share = stage == 0 || stage == 3 ? 1.0 : 2.0, reach = stage == 2 ? h : 0.5 * h;
    int i;
    for (i = 0; i < size; i++) {
        total[i] += share * k[i];
        x[i] = start[i] + (stage < 3 ? reach * k[i] : h / 6.0 * total[i]);
    }
}

void model_step(const double *z, const double *u, double *next)
{
    double x[N], start[N], k[N], total[N];
    Held held;
    int i, part, stage;
    hold(u, 0, &held);
    for (i = 0; i < N; i++)
        x[i] = z[i];
    for (part = 0; part < SUBSTEPS; part++) {
        for (i = 0; i < N; i++) {
            start[i] = x[i];
            total[i] = 0.0;
        }
        for (stage = 0; stage < 4; stage++) {
            rate(&held, x, k, NULL, NULL);
            advance_stage(stage, MODEL_TIMESTEP / SUBSTEPS, N, start, k, total, x);
        }
    }
    for (i = 0; i < N; i++)
        next[i] = x[i];
}

void model_step_jacobians(const double *z, const double *u, double *next, double *A, double *B)
{
    double x[N], start[N], k[N], total[N], F[N * N], G[N * M];
    double S[N * (N + M)], S_start[N * (N + M)], S_k[N * (N + M)], S_total[N * (N + M)];
    Held held;
    int i, j, part, stage;
    hold(u, 1, &held);
    for (i = 0; i < N; i++) {
        x[i] = z[i];
        for (j = 0; j < N + M; j++)
            S[i * (N + M) + j] = i == j ? 1.0 : 0.0;
    }
    for (part = 0; part < SUBSTEPS; part++) {
        for (i = 0; i < N; i++) {
            start[i] = x[i];
            total[i] = 0.0;
        }
        for (i = 0; i < N * (N + M); i++) {
            S_start[i] = S[i];
            S_total[i] = 0.0;
        }
        for (stage = 0; stage < 4; stage++) {
            rate(&held, x, k, F, G);
            carry(F, G, S, S_k);
            advance_stage(stage, MODEL_TIMESTEP / SUBSTEPS, N, start, k, total, x);
            advance_stage(stage, MODEL_TIMESTEP / SUBSTEPS, N * (N + M), S_start, S_k, S_total, S);
        }
    }
    for (i = 0; i < N; i++) {
        next[i] = x[i];
        for (j = 0; j < N; j++)
            A[i * N + j] = S[i * (N + M) + j];
        for (j = 0; j < M; j++)
            B[i * M + j] = S[i * (N + M) + N + j];
    }
}

"""

# A family of maps defines advance(INPUT, z, next, F, G) over one base timestep; F and G are NULL where they are not
# wanted. INPUT is u, or what `hold` makes of it.
MAP_STEP = """\
void model_step(const double *z, const double *u, double *next)
{
    double x[N], following[N];
@HELD@    int i, repeat;
@HOLD@    for (i = 0; i < N; i++)
        x[i] = z[i];
    for (repeat = 0; repeat < REPEATS; repeat++) {
        advance(@INPUT@, x, following, NULL, NULL);
        for (i = 0; i < N; i++)
            x[i] = following[i];
    }
    for (i = 0; i < N; i++)
        next[i] = x[i];
}

"""

SINGLE_MAP_JACOBIANS = """\
void model_step_jacobians(const double *z, const double *u, double *next, double *A, double *B)
{
    double following[N];
@HELD@    int i;
@HOLD@    advance(@INPUT@, z, following, A, B);
    for (i = 0; i < N; i++)
        next[i] = following[i];
}

"""

REPEATED_MAP_JACOBIANS = """\
/* X (N, columns) = F X, in place */
static void multiply(const double *restrict F, int columns, double *restrict X)
{
    double column[N];
    int i, j, r;
    for (j = 0; j < columns; j++) {
        for (r = 0; r < N; r++) {
            column[r] = X[r * columns + j];
            X[r * columns + j] = 0.0;
        }
        for (i = 0; i < N; i++)
            for (r = 0; r < N; r++)
                X[i * columns + j] += F[i * N + r] * column[r];
    }
}

void model_step_jacobians(const double *z, const double *u, double *next, double *A, double *B)
{
    double x[N], following[N], F[N * N], G[N * M];
@HELD@    int i, repeat;
@HOLD@    advance(@INPUT@, z, x, A, B);
    for (repeat = 1; repeat < REPEATS; repeat++) {
        advance(@INPUT@, x, following, F, G);
        multiply(F, N, A);
        multiply(F, M, B);
        for (i = 0; i < N * M; i++)
            B[i] += G[i];
        for (i = 0; i < N; i++)
            x[i] = following[i];
    }
    for (i = 0; i < N; i++)
        next[i] = x[i];
}

"""


def map_steps(repeats: int, held: bool = False) -> str:
    """The steps of a map with this number of repeats. A single one needs no room for products of Jacobians.

    held: whether the family defines `Held` and `hold` for the columns that the input changes.
    """
    step, jacobians = MAP_STEP, SINGLE_MAP_JACOBIANS if repeats == 1 else REPEATED_MAP_JACOBIANS
    declared = "    Held held;\n" if held else ""
    return "".join(text.replace("@HELD@", declared).replace("@INPUT@", "&held" if held else "u")
                   .replace("@HOLD@", f"    hold(u, {slopes}, &held);\n" if held else "")
                   for text, slopes in ((step, 0), (jacobians, 1)))


def map_scratch(state_dim: int, input_dim: int, repeats: int) -> int:
    """Number of doubles that `map_steps` has on the stack."""
    return state_dim * (2 if repeats == 1 else 3 + state_dim + input_dim)


def flow_scratch(state_dim: int, input_dim: int) -> int:
    """Number of doubles that `FLOW` has on the stack, without those of `Held` and of the rate."""
    return 4 * state_dim + 5 * state_dim * (state_dim + input_dim)
