"""Compiled rollouts of a polynomial model from many starts at once.

The rollouts of a block advance together, so that one vector instruction serves several starts. One start is one lane:
the last index of every array here. A monomial for all lanes is then the product of two rows, and a table times
monomials is a product of matrices. A table row with few nonzero entries, such as one of a shift register, adds only
those entries.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ssmr_torch import compiled_functions
from ssmr_torch.models.batch_rollout import BatchRollout
from ssmr_torch.models.held_input import output_table, products
from ssmr_torch.models.monomials import Form, Monomials
from ssmr_torch.models.structure import SCHEMES

RUNGE_KUTTA, EULER = SCHEMES.index("runge_kutta"), SCHEMES.index("euler")
LANES = 64         # starts in a block: their monomials fit into the cache
VECTOR = 8         # the number of lanes is a multiple of this
ROWS, COLUMNS = 4, 4   # block of a full table that is multiplied at a time
SPARSE = 3         # time for one entry of a sparse row, in entries of a full row

# The compiler may reorder sums, but must keep NaN and infinity, because they mark a diverged rollout.
compiled = compiled_functions.compiled(fastmath={"reassoc", "contract"})


class FormTables(NamedTuple):
    """A form in the layout that the kernel reads.

    products (2, ·): entry 1 + variables + i of the closure is entry products[0, i] times variable products[1, i].
    full (R, C): the rows full_rows of the table at the entries full_columns of the closure. Zeros fill R and C up to
    whole multiples of ROWS and COLUMNS. The added rows write to separate rows after the last one: if two rows were the
    same, the compiler could not vectorize.
    sparse_rows (S,): the other rows. Row i has the entries sparse_first[i] to sparse_first[i + 1] of sparse_columns and
    sparse_values.
    """

    products: np.ndarray
    full: np.ndarray
    full_rows: np.ndarray
    full_columns: np.ndarray
    sparse_rows: np.ndarray
    sparse_first: np.ndarray
    sparse_columns: np.ndarray
    sparse_values: np.ndarray


class CompiledBatch(BatchRollout):
    """Compiled rollouts of a `PolynomialModel`. They differ from `Model.rollout` only in the order of the sums."""

    def __init__(self, model):
        super().__init__(model)
        structure = self.model.structure
        lifted = structure.chart if structure.relift else Monomials(1, [])
        count = 4 * self.model.substeps if self.model.flow else self.model.repeats
        length = self.model.timestep / self.model.substeps if self.model.flow else self.model.base_timestep
        edge = np.array(self.model.edge if structure.saturated else (), dtype=np.float64)
        linear = np.ascontiguousarray(self.model.linear_part) if structure.saturated else np.zeros((0, 0))
        self._tables = (form_tables(self.model.dynamics_form), form_tables(self.model.output_form), _products(lifted),
                        _index(lifted.positions), linear, edge, len(self.model.dynamics),
                        SCHEMES.index(structure.scheme), float(length), count)

    def _run(self, z, inputs, lengths, bound, states, outputs):
        N, H, _ = inputs.shape
        found = np.empty((N if states else 0, H + 1, z.shape[1]))
        seen = np.empty((N if outputs else 0, H, self.model.latent_dim))
        diverged_at = np.empty(N, dtype=np.int64)
        _roll(*(np.ascontiguousarray(each, dtype=np.float64) for each in (z, inputs)),
              np.ascontiguousarray(lengths, dtype=np.int64), float(bound), self._tables, found, seen, diverged_at)
        return found, self._in_outputs(seen) if outputs else seen, diverged_at

    def _in_outputs(self, seen: np.ndarray) -> np.ndarray:
        """Outputs from the model's coordinates; infinite from the step at which a rollout diverged."""
        coordinates = self.model.coordinates
        if coordinates is None:
            return seen
        finite = np.isfinite(seen).all(-1, keepdims=True)
        with np.errstate(over="ignore", invalid="ignore"):
            return np.where(finite, coordinates.inverse(np.where(finite, seen, 0.0)), np.inf)


def form_tables(form: Form) -> FormTables:
    """The tables of a form with a NumPy table."""
    table, entries = output_table(form, form.monomials), np.flatnonzero
    used = np.count_nonzero(table.any(0))
    few = np.count_nonzero(table, axis=1) * SPARSE < used
    columns = entries(table[~few].any(0))
    rows = entries(~few)
    full = np.zeros((_padded(len(rows), ROWS), _padded(len(columns), COLUMNS)))
    full[:len(rows), :len(columns)] = table[np.ix_(rows, columns)]
    spare = range(len(table), len(table) + len(full) - len(rows))
    chosen, places = np.nonzero(table[few])
    first = np.concatenate([[0], np.cumsum(np.count_nonzero(table[few], axis=1))])
    return FormTables(_products(form.monomials), full, _index([*rows, *spare]),
                      _index([*columns, *[0] * (full.shape[1] - len(columns))]), _index(entries(few)), _index(first),
                      _index(places), np.ascontiguousarray(table[few][chosen, places]))


def _products(monomials: Monomials) -> np.ndarray:
    return _index(np.stack(products(monomials)))


def _padded(size: int, multiple: int) -> int:
    return -(-size // multiple) * multiple


def _index(values) -> np.ndarray:
    """Unsigned integers, because they index faster."""
    return np.ascontiguousarray(values, dtype=np.uint32)


@compiled
def _copy(x, out, rows):
    """Copy the first rows of x into out."""
    for i in range(rows):
        for lane in range(x.shape[1]):
            out[i, lane] = x[i, lane]


@compiled
def _multiply_out(products, variables, closure):
    """Compute the products of the closure from its constant and its first `variables` entries."""
    for i in range(products.shape[1]):
        a, b, out = closure[products[0, i]], closure[1 + products[1, i]], closure[1 + variables + i]
        for lane in range(len(out)):
            out[lane] = a[lane] * b[lane]


@compiled
def _apply(form, closure, out):
    """out = table · closure."""
    _, full, full_rows, full_columns, sparse_rows, sparse_first, sparse_columns, sparse_values = form
    lanes = closure.shape[1]
    for i in range(0, len(full_rows), 4):
        a, b, c, d = out[full_rows[i]], out[full_rows[i + 1]], out[full_rows[i + 2]], out[full_rows[i + 3]]
        for lane in range(lanes):
            a[lane], b[lane], c[lane], d[lane] = 0.0, 0.0, 0.0, 0.0
        for q in range(0, len(full_columns), 4):
            w, x = closure[full_columns[q]], closure[full_columns[q + 1]]
            y, z = closure[full_columns[q + 2]], closure[full_columns[q + 3]]
            a0, a1, a2, a3 = full[i, q], full[i, q + 1], full[i, q + 2], full[i, q + 3]
            b0, b1, b2, b3 = full[i + 1, q], full[i + 1, q + 1], full[i + 1, q + 2], full[i + 1, q + 3]
            c0, c1, c2, c3 = full[i + 2, q], full[i + 2, q + 1], full[i + 2, q + 2], full[i + 2, q + 3]
            d0, d1, d2, d3 = full[i + 3, q], full[i + 3, q + 1], full[i + 3, q + 2], full[i + 3, q + 3]
            for lane in range(lanes):
                e, f, g, h = w[lane], x[lane], y[lane], z[lane]
                a[lane] += a0 * e + a1 * f + a2 * g + a3 * h
                b[lane] += b0 * e + b1 * f + b2 * g + b3 * h
                c[lane] += c0 * e + c1 * f + c2 * g + c3 * h
                d[lane] += d0 * e + d1 * f + d2 * g + d3 * h
    for i in range(len(sparse_rows)):
        a = out[sparse_rows[i]]
        for lane in range(lanes):
            a[lane] = 0.0
        for e in range(sparse_first[i], sparse_first[i + 1]):
            w, a0 = closure[sparse_columns[e]], sparse_values[e]
            for lane in range(lanes):
                a[lane] += a0 * w[lane]


@compiled
def _saturate(edge, z, closure):
    """Write s(z) into the first entries of the closure; see `models.saturation`."""
    for i in range(len(z)):
        x, out = z[i], closure[1 + i]
        for lane in range(len(x)):
            over = abs(x[lane]) / edge[i] - 1.0
            out[lane] = x[lane] * (1.0 + 0.5 * np.tanh(2.0 * over)) / (1.0 + over) if over > 0.0 else x[lane]


@compiled
def _keep_linear(linear, z, closure, k):
    """Correct k, which was computed from s(z): its linear terms take z itself."""
    for j in range(len(z)):
        x, within = z[j], closure[1 + j]
        for lane in range(len(x)):
            beyond = x[lane] - within[lane]
            if beyond != 0.0:
                for i in range(len(z)):
                    k[i, lane] += linear[i, j] * beyond


@compiled
def _stepped(x, k, start, total, scheme, stage, h):
    """x after one evaluation k of the dynamics: the next Runge-Kutta stage, x + h k (Euler), or k itself (map)."""
    share, reach = 1.0 if stage % 3 == 0 else 2.0, h if stage == 2 else 0.5 * h
    for i in range(len(x)):
        z, f, z0, sum_ = x[i], k[i], start[i], total[i]
        for lane in range(len(z)):
            if scheme == RUNGE_KUTTA:
                if stage == 0:
                    z0[lane], sum_[lane] = z[lane], 0.0
                sum_[lane] += share * f[lane]
                z[lane] = z0[lane] + (reach * f[lane] if stage < 3 else h / 6.0 * sum_[lane])
            elif scheme == EULER:
                z[lane] += h * f[lane]
            else:
                z[lane] = f[lane]


@compiled
def _advance(x, inputs, tables, work):
    """x (n, lanes) one timestep later with the inputs (lanes, m) held."""
    dynamics, _, lifting, positions, linear, edge, rates, scheme, h, count = tables
    closure, lifted, k, start, total = work
    n, m = len(x), inputs.shape[1]
    for lane in range(len(inputs)):
        for j in range(m):
            closure[1 + n + j, lane] = inputs[lane, j]
    for application in range(count):
        if len(edge):
            _saturate(edge, x, closure)
        else:
            _copy(x, closure[1:], n)
        _multiply_out(dynamics[0], n + m, closure)
        _apply(dynamics, closure, k)
        if len(edge):
            _keep_linear(linear, x, closure, k)
        if len(positions):
            _copy(k, lifted[1:], rates)
            _multiply_out(lifting, rates, lifted)
            for i in range(n):
                _copy(lifted[positions[i]:], x[i:], 1)
        else:
            _stepped(x, k, start, total, scheme, application % 4, h)


@compiled
def _begin(states, x):
    """Copy states (·, n) into x (n, lanes), and zeros into the remaining lanes."""
    for i in range(len(x)):
        for lane in range(x.shape[1]):
            x[i, lane] = states[lane, i] if lane < len(states) else 0.0


@compiled
def _accept(x, z, bound, k, lengths, inside, diverged_at):
    """Set z = x in the lanes that are inside the bound and were so before. Returns how many lanes go on after step k.
    """
    running = 0
    for lane in range(len(inside)):
        if not inside[lane] or k >= lengths[lane]:
            continue
        square = 0.0
        for i in range(len(x)):
            square += x[i, lane] * x[i, lane]
        if np.sqrt(square) <= bound:
            diverged_at[lane] += 1
            running += 1
            for i in range(len(x)):
                z[i, lane] = x[i, lane]
        else:
            inside[lane] = False
    return running


@compiled
def _decode(output, z, seen, y, inside, outputs):
    """Write the outputs (lanes, p) of z, infinite in the lanes that have diverged."""
    _copy(z, seen[1:], len(z))
    _multiply_out(output[0], len(z), seen)
    _apply(output, seen, y)
    for lane in range(len(outputs)):
        for i in range(outputs.shape[1]):
            outputs[lane, i] = y[i, lane] if inside[lane] else np.inf


@compiled
def _roll(first_states, inputs, lengths, bound, tables, states, outputs, diverged_at):
    """Compute all rollouts, one block of lanes after another. states and outputs are filled unless they are empty."""
    dynamics, output, lifting, rates = tables[0], tables[1], tables[2], tables[6]
    (N, H, m), n, p = inputs.shape, first_states.shape[1], outputs.shape[2]
    lanes = min(LANES, max(-(-N // VECTOR), 1) * VECTOR)
    z, x, inside = np.empty((n, lanes)), np.empty((n, lanes)), np.empty(lanes, dtype=np.bool_)
    work = (np.ones((1 + n + m + dynamics[0].shape[1], lanes)), np.ones((1 + rates + lifting.shape[1], lanes)),
            np.zeros((rates + ROWS, lanes)), np.zeros((n, lanes)), np.zeros((n, lanes)))
    seen, y = np.ones((1 + n + output[0].shape[1], lanes)), np.zeros((p + ROWS, lanes))
    for first in range(0, N, lanes):
        here = slice(first, min(first + lanes, N))
        count = here.stop - here.start
        _begin(first_states[here], z)
        diverged_at[here], inside[:] = 1, True
        running = count
        for k in range(H):
            if running:
                _copy(z, x, n)
                _advance(x, inputs[here, k], tables, work)
                running = _accept(x, z, bound, k, lengths[here], inside[:count], diverged_at[here])
            if len(outputs):
                _decode(output, z, seen, y, inside, outputs[here, k])
            if len(states):
                for lane in range(count):
                    for i in range(n):
                        states[first + lane, k + 1, i] = z[i, lane]
    if len(states):
        states[:, 0] = first_states
