"""C text of a polynomial model of any structure: the tables of its forms, and the functions that evaluate them."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ssmr_torch.deployment.c import output_coordinates as bent
from ssmr_torch.deployment.c import polynomial_text as text
from ssmr_torch.deployment.c.c_text import Family, product, table, times
from ssmr_torch.deployment.c.steps import FLOW, flow_scratch, map_scratch, map_steps
from ssmr_torch.models.held_input import derivative_table, output_table, products, reach, split, trimmed
from ssmr_torch.models.monomials import Form, Monomials, without
from ssmr_torch.models.polynomial import PolynomialModel


class Piece(NamedTuple):
    """A part of the file: its enumerators, its code, and the number of doubles that it has on the stack."""

    sizes: dict[str, int]
    code: str
    scratch: int


def polynomial(model: PolynomialModel) -> Family:
    """The C text of chart, dynamics, step (by the dynamics' scheme) and parametrization, each with its own tables.

    Raises ValueError for output coordinates that have no C form.
    """
    model, placed = _as_one_map(model), bent.coordinates(model)
    chart, dynamics, output = _chart(model), _dynamics(model), _output(model)
    step = _step(model)
    pieces = (chart, dynamics, step, output)
    sizes = {name: size for piece in pieces for name, size in piece.sizes.items()} | placed.sizes
    code = text.MULTIPLY_OUT + placed.code + "".join(piece.code for piece in pieces)
    scratch = max(chart.scratch + placed.encoding, output.scratch + placed.decoding, dynamics.scratch + step.scratch)
    return Family(sizes, code, scratch, mathematics=model.structure.saturated or model.coordinates is not None)


def _as_one_map(model: PolynomialModel) -> PolynomialModel:
    """A map that is affine in state and input, taken over all its repeats at once; any other model unchanged."""
    structure, n, m = model.structure, model.state_dim, model.input_dim
    if model.repeats == 1 or structure.relift or structure.dynamics.highest > 1:
        return model
    constant, A, B = model.step_jacobians(np.zeros(n), np.zeros(m))
    affine = Monomials(n + m, [(), *((k,) for k in range(n + m))])
    return replace(model, dynamics=np.concatenate([constant[:, None], A, B], -1), base_timestep=model.timestep,
                   structure=structure._replace(dynamics=affine, scheme="map", saturated=False))


def _dynamics(model: PolynomialModel) -> Piece:
    """C text of `Held`, `hold` and `rate`."""
    n, rows, saturates = model.state_dim, len(model.dynamics), model.structure.saturated
    parts = split(model.dynamics_form, n)
    linear, qf, qs = parts.states.highest <= 1, parts.columns_u, reach(parts.runs_z)
    widest = int(parts.runs_u[:, 4].max(initial=0))
    free = _at_least(parts.free, 1 + n) if linear or saturates else parts.free
    sizes = {"R": rows, "Q": len(parts.states.closure), "QF": qf, "QU": len(parts.inputs.closure),
             "RUNS": len(parts.runs), "INPUT_RUNS": len(parts.runs_u)}
    code = (_declare("state", parts.states) + _declare("input", parts.inputs)
            + table("rate_free", free.T, "rate without input, column by column")
            + table("fields", parts.fields.T, "what monomials of the input add to it, column by column")
            + table("rate_runs", parts.runs, "monomial of the input, first column, how many, where in fields")
            + table("input_runs", parts.runs_u, "by the inputs: what is left of it, exponent, input, columns as above")
            + _add_runs("add_rate_runs", rows) + product("run_times", rows, None, most=widest)
            + product("held_rate_times", rows, qf) + _rest("rest_rate_times", rows, free.shape[1] - qf))
    if not linear:
        sizes |= {"QS": qs, "SLOPE_RUNS": len(parts.runs_z)}
        code += (table("slope_free", parts.free_z.T, "Jacobian of the rate without input, column by column")
                 + table("slope_fields", parts.fields_z.T, "what monomials of the input add to it, column by column")
                 + table("slope_runs", parts.runs_z, "monomial of the input, first column, how many, where")
                 + _add_runs("add_slope_runs", rows * n) + product("held_slope_times", rows * n, qs)
                 + _rest("rest_slope_times", rows * n, parts.free_z.shape[1] - qs))
    if saturates:
        edge = np.minimum(model.edge, np.finfo(float).max)
        code += table("edge", edge, "from where on the states saturate") + text.SATURATED
    slopes = text.LINEAR_SLOPES if linear else "    held_slope_times(held->slope, powers, F);\n" + (
        "    rest_slope_times(slope_free + QS * R * N, powers + QS, F);\n" * (parts.free_z.shape[1] > qs))
    seen = f"    multiply_out({'seen' if saturates else 'z'}, N, state_parent, state_factor, Q - 1 - N, powers);\n"
    code += _filled(text.HELD, {"SLOPE": "" if linear else text.SLOPE,
                                "HOLD_SLOPE": "    (void)slopes;\n" if linear else text.HOLD_SLOPE})
    code += _filled(text.RATE, {
        "SEEN": text.SEEN * saturates + seen, "OVER": text.OVER * saturates, "BENT": text.BENT * saturates,
        "SLOPES": slopes, "J": ", j" * (linear or saturates),
        "RATE_REST": "    rest_rate_times(rate_free + QF * R, powers + QF, k);\n" * (free.shape[1] > qf)})
    held = sizes["QU"] + rows * qf + (0 if linear else rows * n * qs)
    return Piece(sizes, code, held + sizes["Q"] + rows + 2 * n * saturates)


def _rest(function: str, rows: int, columns: int) -> str:
    """The product with the columns that no input changes; empty where there are none."""
    return product(function, rows, columns, accumulate=True) if columns > 0 else ""


def _add_runs(function: str, rows: int) -> str:
    """A C function: held += the sum of u^q · the columns of its runs. Tables are stored column by column."""
    return (f"static void {function}(const int *restrict runs, int count, const double *restrict columns,\n"
            "                          const double *restrict inputs, double *restrict held)\n{\n    int c, i, r;\n"
            "    for (r = 0; r < count; r++) {\n        const int *run = runs + 4 * r;\n"
            "        const double share = inputs[run[0]];\n        for (c = 0; c < run[2]; c++)\n"
            f"            for (i = 0; i < {rows}; i++)\n"
            f"                held[(run[1] + c) * {rows} + i] += columns[(run[3] + c) * {rows} + i] * share;\n"
            "    }\n}\n\n")


def _step(model: PolynomialModel) -> Piece:
    """C text of `model_step` and `model_step_jacobians`."""
    structure, n, m, repeats = model.structure, model.state_dim, model.input_dim, model.repeats
    if model.flow:
        return Piece({"SUBSTEPS": model.substeps}, FLOW, flow_scratch(n, m))
    scratch, code = map_scratch(n, m, repeats), text.MAP
    if structure.scheme == "euler":
        scratch, code = scratch + n, f"static const double base_timestep = {model.base_timestep!r};\n\n" + text.EULER
    if structure.relift:
        row, variable, rest, count = _slopes(structure.chart)
        ends = np.searchsorted(row, np.arange(n), side="right")
        scratch += len(model.dynamics) * (n + m + 1) + len(structure.chart.closure)
        code = (table("lift_end", ends, "of the Jacobian of the lifting: entries up to each row")
                + table("lift_variable", variable, "the variable") + table("lift_rest", rest, "what is left")
                + table("lift_count", count, "the exponent that comes down") + text.LIFTED_ANEW)
    return Piece({"REPEATS": repeats}, code + map_steps(repeats, held=True), scratch)


def _chart(model: PolynomialModel) -> Piece:
    """C text of `encode_window` and of the chart's monomials; a model with re-lifting uses the monomials again."""
    structure, window = model.structure, model.latent_window
    bends = model.coordinates is not None
    order, monomials = np.array(structure.window_order), structure.chart
    code = _declare("chart", monomials) + table("order", order, "which values of [window, inputs] the chart sees")
    seen = f"{'latent' if bends else 'window'}[order[i]]"
    if model.takes_past_inputs:
        seen = f"order[i] < {window} ? {seen} : inputs[order[i] - {window}]"
    if len(model.window_scale):
        code += table("scale", model.window_scale, "by what they are divided")
        seen = f"({seen}) / scale[i]"
    chart = "    chart_times(powers, z);\n" if len(model.chart) else text.POSITIONS
    if len(model.chart):
        code += times("chart", output_table(Form(monomials, model.chart), monomials), "chart")
    if not len(model.chart) or structure.relift:
        code += table("chart_position", monomials.positions, "which of the products the state holds")
    code += _filled(text.ENCODE, {"SEEN": seen, "CHART": chart, "LATENT": bent.LATENT * bends,
                                  "BEND": bent.BEND * bends})
    return Piece({"O": len(order), "QV": len(monomials.closure)}, code, len(order) + len(monomials.closure))


def _output(model: PolynomialModel) -> Piece:
    """`decode_state`."""
    monomials = model.structure.parametrization
    tables = output_table(model.output_form, monomials)
    code = (_declare("output", monomials) + times("output", tables, "outputs")
            + times("output_slope", trimmed(derivative_table(tables, monomials)), "Jacobian of the outputs")
            + (text.DECODE if model.coordinates is None else bent.DECODE))
    return Piece({"QW": len(monomials.closure)}, code, len(monomials.closure))


def _declare(name: str, monomials: Monomials) -> str:
    """The index tables NAME_parent and NAME_factor of the monomials, see `MULTIPLY_OUT`."""
    parent, factor = products(monomials)
    return (table(f"{name}_parent", parent, "position of what each product multiplies")
            + table(f"{name}_factor", factor, "variable it is multiplied by"))


def _slopes(monomials: Monomials) -> list[np.ndarray]:
    """For each nonzero derivative of a monomial: monomial, variable, the remaining monomial, and the exponent."""
    found = []
    for row, factors in enumerate(monomials.factors):
        for variable in sorted(set(factors)):
            found.append((row, variable, monomials.position(without(factors, variable)), factors.count(variable)))
    return list(np.array(found, dtype=np.int64).reshape(-1, 4).T)


def _at_least(array: np.ndarray, columns: int) -> np.ndarray:
    """The table, with columns of zeros added until it has this many."""
    return np.pad(array, ((0, 0), (0, max(0, columns - array.shape[1]))))


def _filled(template: str, pieces: dict[str, str]) -> str:
    for name, piece in pieces.items():
        template = template.replace(f"@{name}@", piece)
    return template
