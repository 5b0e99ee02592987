"""A control-augmented model in C."""

from __future__ import annotations

import numpy as np

from ssmr_torch.deployment.c_monomials import MULTIPLY_OUT, CMonomials
from ssmr_torch.deployment.c_polynomial import polynomial_output
from ssmr_torch.deployment.c_steps import map_scratch, map_steps
from ssmr_torch.deployment.c_text import Family, table, times
from ssmr_torch.models.control_augmented_tables import ControlAugmentedTables
from ssmr_torch.models.integrators import whole_multiple

CODE = """\
/* z where it is not larger than in training; beyond 1 to 1.5 times the largest, with the slope 1 - bend^2. */
static double saturated(double z, double largest, double *bend)
{
    double over = fabs(z) / largest - 1.0;
    *bend = 0.0;
    if (!(over > 0.0))
        return z;
    *bend = tanh(2.0 * over);
    return z * (1.0 + 0.5 * *bend) / (1.0 + over);
}

static void advance(const double *z, const double *u, double *next, double *F, double *G)
{
    double joint[N + M], powers[Q], change[N], slope[N * (N + M)], bend[N];
    int i, j;
    for (i = 0; i < N; i++)
        joint[i] = saturated(z[i], edge[i], &bend[i]);
    for (j = 0; j < M; j++)
        joint[N + j] = u[j];
    multiply_out(joint, N + M, dynamics_parent, dynamics_factor, Q - 1 - N - M, powers);
    if (F != NULL)
        dynamics_slope_times(powers, slope);
    for (i = 0; i < N; i++)
        powers[1 + i] = z[i];
    dynamics_times(powers, change);
    for (i = 0; i < N; i++)
        next[i] = z[i] + base_timestep * change[i];
    if (F == NULL)
        return;
    for (i = 0; i < N; i++) {
        for (j = 0; j < N; j++)
            F[i * N + j] = (i == j ? 1.0 : 0.0) + base_timestep * (
                (1.0 - bend[j] * bend[j]) * slope[i * (N + M) + j] + bend[j] * bend[j] * linear[i * N + j]);
        for (j = 0; j < M; j++)
            G[i * M + j] = base_timestep * slope[i * (N + M) + N + j];
    }
}

static void encode_window(const double *window, const double *inputs, double *z)
{
    chart_times(window, z);
    input_chart_times(inputs, z);
}

"""


def control_augmented(model: ControlAugmentedTables) -> Family:
    """Tables over [1, (z, u), products of them], only those of a degree in u that the model has."""
    n, m, window = model.state_dim, model.input_dim, (model.delays + 1) * model.output_dim
    joint, repeats = CMonomials(model.dynamics_monomials), whole_multiple(model.timestep, model.base_timestep)
    output_sizes, output = polynomial_output(model.parametrization_monomials, model.parametrization)
    code = (MULTIPLY_OUT + joint.declare("dynamics") + times("dynamics", joint.widened(model.dynamics), "dynamics")
            + times("dynamics_slope", joint.derivative(model.dynamics), "Jacobian of the dynamics")
            + times("chart", model.chart[:, :window], "chart, over the window")
            + times("input_chart", model.chart[:, window:], "chart, over the inputs within it", accumulate=True)
            + table("edge", np.minimum(model.edge, np.finfo(float).max), "largest states of the training")
            + table("linear", model.dynamics[:, :n], "of the dynamics, what is linear in the state")
            + f"static const double base_timestep = {model.base_timestep!r};\n\n"
            + CODE + map_steps(repeats) + output)
    scratch = map_scratch(n, m, repeats) + joint.size + (n + m) * (n + 1) + 2 * n
    return Family({"Q": joint.size, "REPEATS": repeats} | output_sizes, code, scratch, mathematics=True)
