"""The fixed C text of a polynomial model. @NAME@ stands for parts that depend on the model's structure."""

MULTIPLY_OUT = """\
/* powers = [1, x, products of x], product i being that at parent[i] times x[factor[i]]. */
static void multiply_out(const double *x, int variables, const int *parent, const int *factor, int products,
                         double *powers)
{
    int i;
    powers[0] = 1.0;
    for (i = 0; i < variables; i++)
        powers[1 + i] = x[i];
    for (i = 0; i < products; i++)
        powers[1 + variables + i] = powers[parent[i]] * x[factor[i]];
}

"""

SATURATED = """\
/* z inside its edge. Outside: between 1 and 1.5 times the edge, with the slope 1 - bend^2. */
static double saturated(double z, double within, double *bend)
{
    double over = fabs(z) / within - 1.0;
    *bend = 0.0;
    if (!(over > 0.0))
        return z;
    *bend = tanh(2.0 * over);
    return z * (1.0 + 0.5 * *bend) / (1.0 + over);
}

"""

# The rate f(z, u) = (free + sum of u^q field_q) . powers of z. Each field consists of runs of neighbouring columns, see
# `ssmr_torch.models.held_input`. Its first QF columns, and the first QS of its Jacobian, are held over a step.
HELD = """\
typedef struct {
    double inputs[QU], rate[QF * R];
@SLOPE@} Held;

/* The columns that the input u changes; those of the Jacobian only if slopes is set. */
static void hold(const double *u, int slopes, Held *held)
{
    int i;
    multiply_out(u, M, input_parent, input_factor, QU - 1 - M, held->inputs);
    for (i = 0; i < QF * R; i++)
        held->rate[i] = rate_free[i];
    add_rate_runs(rate_runs, RUNS, fields, held->inputs, held->rate);
@HOLD_SLOPE@}

"""

SLOPE = "    double slope[QS * R * N];\n"

HOLD_SLOPE = """\
    if (!slopes)
        return;
    for (i = 0; i < QS * R * N; i++)
        held->slope[i] = slope_free[i];
    add_slope_runs(slope_runs, SLOPE_RUNS, slope_fields, held->inputs, held->slope);
"""

RATE = """\
/* k (R) = f(z, u) with u held; where F is not NULL, F (R, N) = df/dz and G (R, M) = df/du. */
static void rate(const Held *held, const double *z, double *k, double *F, double *G)
{
    double powers[Q], part[R];
    int i@J@, r;
@SEEN@    held_rate_times(held->rate, powers, k);
@RATE_REST@@OVER@    if (F == NULL)
        return;
@SLOPES@@BENT@    for (i = 0; i < R * M; i++)
        G[i] = 0.0;
    for (r = 0; r < INPUT_RUNS; r++) {
        const int *run = input_runs + 6 * r;
        const double share = run[1] * held->inputs[run[0]];
        run_times(fields + run[5] * R, run[4], powers + run[3], part);
        for (i = 0; i < R; i++)
            G[i * M + run[2]] += share * part[i];
    }
}

"""

SEEN = """\
    double seen[N], bend[N];
    for (i = 0; i < N; i++)
        seen[i] = saturated(z[i], edge[i], &bend[i]);
"""

OVER = """\
    for (j = 0; j < N; j++)
        for (i = 0; i < R && bend[j] != 0.0; i++)
            k[i] += rate_free[(1 + j) * R + i] * (z[j] - seen[j]);
"""

BENT = """\
    for (j = 0; j < N; j++)
        for (i = 0; i < R && bend[j] != 0.0; i++)
            F[i * N + j] += bend[j] * bend[j] * (rate_free[(1 + j) * R + i] - F[i * N + j]);
"""

LINEAR_SLOPES = """\
    for (i = 0; i < R; i++) {
        for (j = 0; j < N && 1 + j < QF; j++)
            F[i * N + j] = held->rate[(1 + j) * R + i];
        for (; j < N; j++)
            F[i * N + j] = rate_free[(1 + j) * R + i];
    }
"""

MAP = """\
static void advance(const Held *held, const double *z, double *next, double *F, double *G)
{
    rate(held, z, next, F, G);
}

"""

EULER = """\
static void advance(const Held *held, const double *z, double *next, double *F, double *G)
{
    double change[N];
    int i;
    rate(held, z, change, F, G);
    for (i = 0; i < N; i++)
        next[i] = z[i] + base_timestep * change[i];
    if (F == NULL)
        return;
    for (i = 0; i < N * N; i++)
        F[i] = (i % (N + 1) == 0 ? 1.0 : 0.0) + base_timestep * F[i];
    for (i = 0; i < N * M; i++)
        G[i] *= base_timestep;
}

"""

LIFTED_ANEW = """\
/* rows (N, columns): the Jacobian of the chart's monomials times T (R, columns) = dx/d... */
static void lift_rows(const double *powers, const double *T, int columns, double *rows)
{
    int i, j, e = 0;
    for (i = 0; i < N; i++) {
        for (j = 0; j < columns; j++)
            rows[i * columns + j] = 0.0;
        for (; e < lift_end[i]; e++) {
            const double share = lift_count[e] * powers[lift_rest[e]];
            for (j = 0; j < columns; j++)
                rows[i * columns + j] += share * T[lift_variable[e] * columns + j];
        }
    }
}

static void advance(const Held *held, const double *z, double *next, double *F, double *G)
{
    double x[R], powers[QV], T[R * N], T_u[R * M];
    int i;
    rate(held, z, x, F == NULL ? NULL : T, T_u);
    multiply_out(x, O, chart_parent, chart_factor, QV - 1 - O, powers);
    for (i = 0; i < N; i++)
        next[i] = powers[chart_position[i]];
    if (F == NULL)
        return;
    lift_rows(powers, T, N, F);
    lift_rows(powers, T_u, M, G);
}

"""

ENCODE = """\
static void encode_window(const double *window, const double *inputs, double *z)
{
    double x[O], powers[QV];
@LATENT@    int i;
    (void)inputs;
@BEND@    for (i = 0; i < O; i++)
        x[i] = @SEEN@;
    multiply_out(x, O, chart_parent, chart_factor, QV - 1 - O, powers);
@CHART@}

"""

POSITIONS = """\
    for (i = 0; i < N; i++)
        z[i] = powers[chart_position[i]];
"""

DECODE = """\
static void decode_state(const double *z, double *y, double *C)
{
    double powers[QW];
    multiply_out(z, N, output_parent, output_factor, QW - 1 - N, powers);
    output_times(powers, y);
    if (C != NULL)
        output_slope_times(powers, C);
}

"""
