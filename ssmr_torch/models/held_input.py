"""Split of a form over (z, u): for a held input u, the form is a polynomial in z alone.

The compiled kernel and the generated C insert the held input once per step. After that they compute only monomials of
z.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ssmr_torch.models.monomials import Form, Monomials, without


class Split(NamedTuple):
    """f(z, u) = (free + Σ_q u^q · fields_q) · c(z), with the closure c of `states` and the monomials u^q of `inputs`.

    states: monomials of z; inputs: monomials of u alone, without the constant.
    free (r, ·): coefficients without input, over the first columns of c. It has as many columns as free and fields
    need. runs (R, 4): one row for each run of neighbouring columns of c to which u^q adds: position of u^q in the
    closure of `inputs`, first column, number of columns, and where their coefficients begin in fields (r, ·).
    free_z (r n, ·), runs_z (R', 4), fields_z (r n, ·): the same for ∂f/∂z, row by row.
    runs_u (T, 6), for ∂f/∂u_j: position of ∂u^q/∂u_j in the closure of `inputs`, its factor, j, and the last three
    entries of the run of `fields` that it multiplies. columns_u: number of columns of c in ∂f/∂u.
    """

    states: Monomials
    inputs: Monomials
    free: np.ndarray
    runs: np.ndarray
    fields: np.ndarray
    free_z: np.ndarray
    runs_z: np.ndarray
    fields_z: np.ndarray
    runs_u: np.ndarray
    columns_u: int


def split(form: Form, state_dim: int, also: Monomials | None = None) -> Split:
    """Split a form with a NumPy table; its first `state_dim` variables are z, the others are u.

    also: further monomials of z whose closure becomes part of `states`.
    """
    n, rows = state_dim, len(form.table)
    parts = [(tuple(f for f in row if f < n), tuple(f - n for f in row if f >= n)) for row in form.monomials.factors]
    of_input = sorted({of_input for _, of_input in parts if of_input}, key=lambda row: (len(row), row))
    states = Monomials(n, dict.fromkeys([of_state for of_state, _ in parts] + list(also.factors if also else ())))
    inputs = Monomials(form.monomials.variables - n, of_input)
    free = np.zeros((rows, len(states.closure)))
    tables: dict[tuple, np.ndarray] = {}
    for k, (of_state, held) in enumerate(parts):
        target = free if not held else tables.setdefault(held, np.zeros_like(free))
        target[:, states.position(of_state)] += form.table[:, k]
    placed = {held: inputs.position(held) for held in of_input}
    runs, fields = _runs({placed[held]: table for held, table in tables.items()}, rows)
    runs_z, fields_z = _runs({placed[held]: derivative_table(table, states) for held, table in tables.items()},
                             rows * n)
    held_at = {place: held for held, place in placed.items()}
    runs_u = [(inputs.position(without(held_at[place], j)), held_at[place].count(j), j, *run)
              for place, *run in runs.tolist() for j in sorted(set(held_at[place]))]
    return Split(states, inputs, trimmed(free, runs), runs, fields, trimmed(derivative_table(free, states), runs_z),
                 runs_z, fields_z, np.array(runs_u, dtype=np.int64).reshape(-1, 6), reach(runs))


def _runs(tables: dict[int, np.ndarray], rows: int) -> tuple[np.ndarray, np.ndarray]:
    """Runs of neighbouring nonzero columns, (R, 4), and these columns side by side, (rows, ·)."""
    runs, fields = [], [np.zeros((rows, 0))]
    for place, table in tables.items():
        columns = np.flatnonzero(table.any(0))
        for run in np.split(columns, 1 + np.flatnonzero(np.diff(columns) > 1)) if len(columns) else ():
            runs.append((place, run[0], len(run), sum(part.shape[1] for part in fields)))
            fields.append(table[:, run])
    return np.array(runs, dtype=np.int64).reshape(-1, 4), np.ascontiguousarray(np.concatenate(fields, axis=1))


def reach(runs: np.ndarray) -> int:
    """Number of columns that the runs need, at least one."""
    return int((runs[:, 1] + runs[:, 2]).max(initial=1))


def derivative_table(table: np.ndarray, monomials: Monomials) -> np.ndarray:
    """∂(table · c)/∂z as a table over the closure c, (r, columns of c) → (r n, ·)."""
    n, columns = monomials.variables, table.shape[1]
    derivative = np.zeros((len(table), n, max(columns, 1)))
    for k in np.flatnonzero(table.any(0)):
        factors = monomials.closure[k]
        for j in set(factors):
            derivative[:, j, monomials.position(without(factors, j))] += factors.count(j) * table[:, k]
    return derivative.reshape(len(table) * n, -1)


def output_table(form: Form, states: Monomials) -> np.ndarray:
    """The table of a form over z, extended to the whole closure of `states`, which must contain its monomials."""
    table = np.zeros((len(form.table), len(states.closure)))
    table[:, [states.position(row) for row in form.monomials.factors]] = form.table
    return trimmed(table)


def products(monomials: Monomials) -> tuple[np.ndarray, np.ndarray]:
    """parent (·,) and variable (·,) of the products in a closure: entry 1 + n + i is entry parent[i] times the variable
    variable[i].
    """
    parents, variables, offset, size = [], [], 1, monomials.variables
    for parent, variable in monomials.levels:
        parents.append(parent + offset)
        variables.append(variable)
        offset, size = offset + size, len(parent)
    empty = np.zeros(0, dtype=np.int64)
    return np.concatenate([empty, *parents]), np.concatenate([empty, *variables])


def trimmed(table: np.ndarray, runs: np.ndarray | None = None) -> np.ndarray:
    """The table without columns of zeros at its end, unless a run needs them. At least one column stays."""
    used = 1 + int(np.flatnonzero(table.any(0)).max(initial=0))
    return np.ascontiguousarray(table[:, :max(used, 1 if runs is None else reach(runs))])
