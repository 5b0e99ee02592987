"""A form over (z, u) with its inputs folded in: while u is held, it is a polynomial in z alone.

What runs a model step by step, the compiled kernel and the generated C, folds the held input in once per step and then
multiplies out monomials of z only.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ssmr_torch.models.monomials import Form, Monomials, without


class Split(NamedTuple):
    """f(z, u) = (free + Σ_q u^q · its fields) · c(z),   c the closure of `states`, u^q monomials of `inputs`.

    states: monomials of z; inputs: monomials of u alone, without the constant.
    free (r, ·): columns of c, as many from its beginning as are needed, also by the fields. runs (R, 4): the place of
    u^q in the closure of `inputs`, the first of neighbouring columns of c to which it adds, how many there are, and
    where their coefficients begin in fields (r, ·).
    free_z (r n, ·), runs_z (R', 4), fields_z (r n, ·): likewise of ∂f/∂z, row by row.
    runs_u (T, 6): of ∂f/∂u_j, the place of ∂u^q/∂u_j in the closure of `inputs` and its factor, j, and the last three
    entries of the run of `fields` that it multiplies. columns_u: how many columns of c ∂f/∂u has.
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
    """The form over the first `state_dim` variables z and the others u, NumPy tables.

    also: further monomials of z whose closure is to be part of `states`.
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
    """Neighbouring columns that are not zero, (R, 4), and the columns themselves side by side, (rows, ·)."""
    runs, fields = [], [np.zeros((rows, 0))]
    for place, table in tables.items():
        columns = np.flatnonzero(table.any(0))
        for run in np.split(columns, 1 + np.flatnonzero(np.diff(columns) > 1)) if len(columns) else ():
            runs.append((place, run[0], len(run), sum(part.shape[1] for part in fields)))
            fields.append(table[:, run])
    return np.array(runs, dtype=np.int64).reshape(-1, 4), np.ascontiguousarray(np.concatenate(fields, axis=1))


def reach(runs: np.ndarray) -> int:
    """How many columns the runs need, at least one."""
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
    """A form over z alone as a table over a closure that holds its monomials."""
    table = np.zeros((len(form.table), len(states.closure)))
    table[:, [states.position(row) for row in form.monomials.factors]] = form.table
    return trimmed(table)


def products(monomials: Monomials) -> tuple[np.ndarray, np.ndarray]:
    """parent and variable (·,) of all of the closure beyond the constant and the variables: entry 1 + n + i of the
    closure is entry parent[i] times variable[i].
    """
    parents, variables, offset, size = [], [], 1, monomials.variables
    for parent, variable in monomials.levels:
        parents.append(parent + offset)
        variables.append(variable)
        offset, size = offset + size, len(parent)
    empty = np.zeros(0, dtype=np.int64)
    return np.concatenate([empty, *parents]), np.concatenate([empty, *variables])


def trimmed(table: np.ndarray, runs: np.ndarray | None = None) -> np.ndarray:
    """Without the columns of zeros at the end that no run needs either; one column stays."""
    used = 1 + int(np.flatnonzero(table.any(0)).max(initial=0))
    return np.ascontiguousarray(table[:, :max(used, 1 if runs is None else reach(runs))])
