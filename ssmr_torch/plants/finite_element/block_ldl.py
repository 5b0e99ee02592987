"""Sparse L D Lᵀ factorization of a symmetric matrix of 3 x 3 blocks. Its pattern is analysed once."""

from __future__ import annotations

import numpy as np

from ssmr_torch.plants.finite_element.compiled import kernel
from ssmr_torch.plants.finite_element.sparsity import Sparsity


class BlockLDL:
    """Solves A x = b with A = L D Lᵀ, D of 3 x 3 blocks, without pivoting.

    It is stable for positive definite A (one step of the reference scheme), and for an indefinite A as long as no pivot
    block comes near singularity. Only the lower triangle of A is read. The analysis finds the fill and, for each
    update, the block that it changes. At each step only products of 3 x 3 blocks remain to be computed.
    """

    def __init__(self, sparsity: Sparsity):
        graph = sparsity.graph
        columns = _fill(graph)
        self._pointers = np.concatenate([[0], np.cumsum([len(column) for column in columns])])
        self._rows = np.concatenate([*columns, np.empty(0, dtype=np.int64)]).astype(np.int64)
        self._targets = _targets(self._pointers, self._rows)
        column = np.repeat(np.arange(len(columns)), np.diff(graph.indptr))
        lower = graph.indices >= column
        starts = sparsity.starts[column] + 3 * (np.arange(len(column)) - graph.indptr[column])
        keys = np.repeat(np.arange(len(columns)), np.diff(self._pointers)) * len(columns) + self._rows
        diagonal = graph.indices[lower] == column[lower]
        self._sources, self._strides = starts[lower], sparsity.heights[column[lower]]
        self._places = np.where(diagonal, -1 - column[lower],
                                np.searchsorted(keys, column[lower] * len(columns) + graph.indices[lower]))
        self._blocks, self._pivots = np.empty((len(self._rows), 9)), np.empty((len(columns), 9))

    def solve(self, data: np.ndarray, right: np.ndarray) -> np.ndarray:
        """x (n,) with A x = right; data: the entries of A in the pattern's order."""
        self._blocks[:], self._pivots[:] = 0.0, 0.0
        _load(data, self._sources, self._strides, self._places, self._blocks, self._pivots)
        _factorize(self._pointers, self._rows, self._targets, self._blocks, self._pivots)
        x = np.array(right)
        _substitute(self._pointers, self._rows, self._blocks, self._pivots, x)
        return x


def _fill(graph) -> list[np.ndarray]:
    """Rows below the diagonal of each column of L: those of A, and those of the columns whose parent it is."""
    columns: list[np.ndarray] = []
    children: list[list[int]] = [[] for _ in range(graph.shape[0])]
    for j in range(graph.shape[0]):
        own = graph.indices[graph.indptr[j]:graph.indptr[j + 1]]
        rows = np.unique(np.concatenate([own, *(columns[child] for child in children[j])]))
        rows = rows[rows > j]
        columns.append(rows)
        if len(rows):
            children[rows[0]].append(j)
    return columns


@kernel
def _targets(pointers, rows):
    """For each column and each pair a < b of its blocks: the place of block (row b, row a) among all blocks."""
    count = 0
    for j in range(len(pointers) - 1):
        c = pointers[j + 1] - pointers[j]
        count += c * (c - 1) // 2
    targets = np.empty(count, dtype=np.int32)
    at = 0
    for j in range(len(pointers) - 1):
        for a in range(pointers[j], pointers[j + 1]):
            place = pointers[rows[a]]
            for b in range(a + 1, pointers[j + 1]):
                while rows[place] != rows[b]:
                    place += 1
                targets[at] = place
                at += 1
    return targets


@kernel
def _load(data, sources, strides, places, blocks, pivots):
    for k in range(len(sources)):
        block = blocks[places[k]] if places[k] >= 0 else pivots[-1 - places[k]]
        for j in range(3):
            for i in range(3):
                block[3 * i + j] = data[sources[k] + j * strides[k] + i]


@kernel
def _invert(p):
    a, b, c, d, e, f = p[0], p[3], p[6], p[4], p[7], p[8]
    x, y, z = d * f - e * e, c * e - b * f, b * e - c * d
    determinant = a * x + b * y + c * z
    p[0], p[4], p[8] = x / determinant, (a * f - c * c) / determinant, (a * d - b * b) / determinant
    p[1] = p[3] = y / determinant
    p[2] = p[6] = z / determinant
    p[5] = p[7] = (b * c - a * e) / determinant


@kernel
def _subtract_product(target, left, right):
    """target −= left · rightᵀ."""
    for i in range(3):
        l0, l1, l2 = left[3 * i], left[3 * i + 1], left[3 * i + 2]
        for j in range(3):
            target[3 * i + j] -= l0 * right[3 * j] + l1 * right[3 * j + 1] + l2 * right[3 * j + 2]


@kernel
def _factorize(pointers, rows, targets, blocks, pivots):
    scaled = np.empty((np.max(pointers[1:] - pointers[:-1]), 9))
    at = 0
    for j in range(len(pivots)):
        _invert(pivots[j])
        first, last = pointers[j], pointers[j + 1]
        inverse = pivots[j]
        for a in range(first, last):
            block, result = blocks[a], scaled[a - first]
            for i in range(3):
                for k in range(3):
                    result[3 * i + k] = (block[3 * i] * inverse[k] + block[3 * i + 1] * inverse[3 + k]
                                         + block[3 * i + 2] * inverse[6 + k])
        for a in range(first, last):
            right = scaled[a - first]
            _subtract_product(pivots[rows[a]], blocks[a], right)
            for b in range(a + 1, last):
                _subtract_product(blocks[targets[at]], blocks[b], right)
                at += 1
        for a in range(first, last):
            blocks[a] = scaled[a - first]


@kernel
def _substitute(pointers, rows, blocks, pivots, x):
    for j in range(len(pivots)):
        for a in range(pointers[j], pointers[j + 1]):
            block, row = blocks[a], 3 * rows[a]
            for i in range(3):
                x[row + i] -= (block[3 * i] * x[3 * j] + block[3 * i + 1] * x[3 * j + 1]
                               + block[3 * i + 2] * x[3 * j + 2])
    for j in range(len(pivots) - 1, -1, -1):
        x0, x1, x2 = x[3 * j], x[3 * j + 1], x[3 * j + 2]
        pivot = pivots[j]
        for i in range(3):
            total = pivot[3 * i] * x0 + pivot[3 * i + 1] * x1 + pivot[3 * i + 2] * x2
            for a in range(pointers[j], pointers[j + 1]):
                block, row = blocks[a], 3 * rows[a]
                total -= block[i] * x[row] + block[3 + i] * x[row + 1] + block[6 + i] * x[row + 2]
            x[3 * j + i] = total
