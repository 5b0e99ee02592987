"""The tables of the compiled kernel: the forms of a polynomial model over a closure of monomials.

Where a step evaluates the dynamics often, or they are affine in the input, the held input is folded into the tables
once per step; the tables are then over monomials of z. Otherwise they are over monomials of z and u together.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from ssmr_torch.models.held_input import derivative_table, output_table, products, split, trimmed
from ssmr_torch.models.monomials import Monomials
from ssmr_torch.models.structure import SCHEMES

# A number in a column that is summed up alone costs as much as this many numbers of a whole table.
SCATTERED = 3


class KernelTables(NamedTuple):
    """Tables over the closure of the monomials of x, which is z or (z, u). Indices are unsigned, which is faster.

    products, u_products (2, ·): entry 1 + len(x) + i of the closure of x is entry products[0, i] times
    x[products[1, i]]; the same for u. free (n, ·): dynamics without the folded part. columns (C, 3): a column that the
    held input changes, where its terms begin, and how many there are. terms (E, 2): place of a monomial of u in the
    closure of u, and a factor. fields (n, E): the column that it multiplies. With _z (n n rows): for ∂f/∂z; with _u (n
    rows, m blocks of columns): for ∂f/∂u. output (p, ·), output_z (p n, ·): y and ∂y/∂z; or (p', ·), (p' n, ·) for ξ
    and ∂ξ/∂z where markers (·, 8) has rows, y = χ⁻¹(ξ), see `horizon_kernel_outputs`. linear (n, n): the part linear in
    z. edge (n,): where other terms saturate; empty without saturation. variables: length of x. scheme, length (s): of
    Runge-Kutta substeps or Euler steps. count: evaluations of the dynamics in a step.
    """

    products: np.ndarray
    u_products: np.ndarray
    free: np.ndarray
    columns: np.ndarray
    terms: np.ndarray
    fields: np.ndarray
    free_z: np.ndarray
    columns_z: np.ndarray
    terms_z: np.ndarray
    fields_z: np.ndarray
    free_u: np.ndarray
    columns_u: np.ndarray
    terms_u: np.ndarray
    fields_u: np.ndarray
    output: np.ndarray
    output_z: np.ndarray
    linear: np.ndarray
    edge: np.ndarray
    variables: int
    markers: np.ndarray
    scheme: int
    length: float
    count: int


def tables_of(model) -> KernelTables:
    """The kernel's tables of a `PolynomialModel` without re-lifting, whose output coordinates, if it has any, have
    `markers`.
    """
    count = 4 * model.substeps if model.flow else model.repeats
    states, inputs, folded = _folded(model)
    joint_states, joint = _joint(model)
    variables = model.state_dim
    if _work(joint, count) < _work(folded, count):
        states, folded, variables = joint_states, joint, joint_states.variables
    output = output_table(model.output_form, states)
    by_state = _of_variables(output, states, 0, model.state_dim)
    return KernelTables(
        _index(products(states)), _index(products(inputs)), *folded, output, by_state,
        np.ascontiguousarray(model.linear_part), np.array(model.edge if model.structure.saturated else ()), variables,
        np.zeros((0, 8)) if model.coordinates is None else np.ascontiguousarray(model.coordinates.markers()),
        SCHEMES.index(model.structure.scheme),
        model.timestep / model.substeps if model.flow else model.base_timestep, count)


def _folded(model) -> tuple[Monomials, Monomials, tuple]:
    """Monomials of z and of u; free, columns, terms, fields of f, ∂f/∂z and ∂f/∂u with the input folded in."""
    n, m = model.state_dim, model.input_dim
    found = split(model.dynamics_form, n, model.structure.parametrization)
    by_input = [(j * found.columns_u + first, count, offset, place, factor)
                for place, factor, j, first, count, offset in found.runs_u.tolist()]
    free_u = np.zeros((n, m * found.columns_u))
    for column, count, offset, _, factor in [run for run in by_input if run[3] == 0]:  # the runs linear in u
        free_u[:, column:column + count] += factor * found.fields[:, offset:offset + count]
    return found.states, found.inputs, (
        found.free, *_by_column(_plain(found.runs), found.fields),
        found.free_z, *_by_column(_plain(found.runs_z), found.fields_z),
        free_u, *_by_column([run for run in by_input if run[3]], found.fields))


def _joint(model) -> tuple[Monomials, tuple]:
    """The same over monomials of (z, u); nothing is left to fold in."""
    n, form = model.state_dim, model.dynamics_form
    states = Monomials(form.monomials.variables, dict.fromkeys([*form.monomials.factors,
                                                                *model.structure.parametrization.factors]))
    free, nothing = output_table(form, states), _by_column((), np.zeros((n, 0)))
    by_state = _of_variables(free, states, 0, n)
    by_input = _of_variables(free, states, n, states.variables).reshape(n, -1)
    return states, (free, *nothing, by_state, *_by_column((), np.zeros((n * n, 0))), by_input, *nothing)


def _of_variables(table: np.ndarray, states: Monomials, first: int, last: int) -> np.ndarray:
    """∂(table · closure)/∂x_j for first ≤ j < last, (rows (last − first), ·)."""
    whole = derivative_table(table, states).reshape(len(table), states.variables, -1)[:, first:last]
    return trimmed(np.ascontiguousarray(whole).reshape(len(table) * (last - first), -1))


def _work(tables: tuple, count: int) -> int:
    """Number of multiplications in a step: free tables once per evaluation of the dynamics, fields once."""
    free, fields = tables[0::4], tables[3::4]
    return count * sum(table.size for table in free) + SCATTERED * sum(table.size for table in fields)


def _plain(runs: np.ndarray) -> list[tuple]:
    return [(first, count, offset, place, 1) for place, first, count, offset in runs.tolist()]


def _by_column(runs: Iterable[tuple], fields: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Columns (C, 3), terms (E, 2) and fields (rows, E), with the terms of a column side by side."""
    found = sorted((first + k, place, factor, offset + k) for first, count, offset, place, factor in runs
                   for k in range(count))
    columns, counts = np.unique([column for column, *_ in found], return_counts=True)
    table = np.stack([columns, np.cumsum(counts) - counts, counts], axis=1) if found else np.zeros((0, 3))
    terms = np.array([(place, factor) for _, place, factor, _ in found]).reshape(-1, 2)
    return _index(table), _index(terms), np.ascontiguousarray(fields[:, [source for *_, source in found]])


def _index(table) -> np.ndarray:
    return np.ascontiguousarray(table, dtype=np.uint32)
