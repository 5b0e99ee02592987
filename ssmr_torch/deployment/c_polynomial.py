"""A polynomial model in C."""

from __future__ import annotations

import numpy as np

from ssmr_torch.deployment.c_monomials import MULTIPLY_OUT, CMonomials
from ssmr_torch.deployment.c_steps import FLOW, HELD_TABLE, flow_scratch
from ssmr_torch.deployment.c_text import Family, product, table, times
from ssmr_torch.models.monomials import Monomials
from ssmr_torch.models.polynomial_tables import PolynomialTables

DYNAMICS = """\
typedef struct {
    double rate[QF * N];
    double slope[QS > 0 ? QS * N * N : 1];
} Held;

/* The parts of the tables that the input u changes; those of the Jacobian only with slopes. */
static void hold(const double *u, int slopes, Held *held)
{
    hold_table(rate_head, field, QF, N, u, held->rate);
    if (slopes)
        hold_table(slope_head, field_slope, QS, N * N, u, held->slope);
}

static void rate(const Held *held, const double *z, double *k, double *F, double *G)
{
    double powers[Q];
    multiply_out(z, N, dynamics_parent, dynamics_factor, Q - 1 - N, powers);
    held_rate_times(held->rate, powers, k);
    rate_rest_times(powers + QF, k);
    if (F == NULL)
        return;
    held_slope_times(held->slope, powers, F);
    slope_rest_times(powers + QS, F);
    field_times(powers, G);
}

"""

ENCODE_LINEAR = """\
static void encode_window(const double *window, const double *inputs, double *z)
{
    (void)inputs;
    chart_times(window, z);
}

"""

ENCODE_CURVED = """\
static void encode_window(const double *window, const double *inputs, double *z)
{
    double powers[QV];
    (void)inputs;
    multiply_out(window, (D + 1) * P, chart_parent, chart_factor, QV - 1 - (D + 1) * P, powers);
    chart_times(powers, z);
}

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


def polynomial(model: PolynomialTables) -> Family:
    """Tables over [1, z, z z, …]; the columns of the rate and of its Jacobian that the input changes come first."""
    n, m, p = model.state_dim, model.input_dim, model.output_dim
    dynamics = CMonomials(max(model.drift_monomials, model.control_monomials, key=lambda each: each.highest))
    drift, control = CMonomials(model.drift_monomials), CMonomials(model.control_monomials)
    by_monomial = model.control.reshape(n, -1, m)
    field = by_monomial.transpose(0, 2, 1).reshape(n * m, -1)
    field_slope = np.stack([control.derivative(by_monomial[:, 1:, j]) for j in range(m)], axis=1)  # (n n, m, ·)
    rate, slope = drift.widened(model.drift), drift.derivative(model.drift)
    qf, qs = field.shape[1], field_slope.shape[2]
    rate, slope = at_least(rate, qf), at_least(slope, qs)
    shapes = {"N": n, "Q": dynamics.size, "QF": qf, "QS": qs}
    chart_sizes, chart, window = _chart(model)
    output_sizes, output = polynomial_output(model.parametrization_monomials, model.parametrization[-p:])
    code = (MULTIPLY_OUT + HELD_TABLE + dynamics.declare("dynamics")
            + table("rate_head", rate[:, :qf].T, "rate without input, columns that the input changes")
            + times("rate_rest", rate[:, qf:], "rate without input, all other columns", accumulate=True)
            + table("slope_head", slope[:, :qs].T, "Jacobian of the rate, columns that the input changes")
            + times("slope_rest", slope[:, qs:], "Jacobian of the rate, all other columns", accumulate=True)
            + times("field", field, "control field")
            + table("field_slope", field_slope.reshape(n * n * m, qs).T, "Jacobian of the control field")
            + product("held_rate_times", n, qf) + product("held_slope_times", n * n, qs)
            + DYNAMICS + FLOW + chart + output)
    scratch = max(flow_scratch(n, m) + qf * n + qs * n * n + dynamics.size, window)
    return Family(shapes | chart_sizes | output_sizes | {"SUBSTEPS": model.substeps}, code, scratch)


def polynomial_output(monomials: Monomials, coefficients: np.ndarray) -> tuple[dict[str, int], str]:
    """Sizes and code of y = coefficients (p, ·) · monomials of z, with its Jacobian."""
    compact = CMonomials(monomials)
    code = (compact.declare("output") + times("output", compact.widened(coefficients), "outputs")
            + times("output_slope", compact.derivative(coefficients), "Jacobian of the outputs") + DECODE)
    return {"QW": compact.size}, code


def at_least(array: np.ndarray, columns: int) -> np.ndarray:
    """A table with columns of zeros added until it has as many."""
    return np.pad(array, ((0, 0), (0, max(0, columns - array.shape[1]))))


def _chart(model: PolynomialTables) -> tuple[dict[str, int], str, int]:
    if model.chart_degree == 1:
        return {}, times("chart", model.chart, "chart, over the window") + ENCODE_LINEAR, 0
    compact = CMonomials(model.chart_monomials)
    code = compact.declare("chart") + times("chart", compact.widened(model.chart), "chart") + ENCODE_CURVED
    return {"QV": compact.size}, code, compact.size
