"""The sparsity pattern of the stiffness matrix: free nodes in an order with little fill, 3 x 3 blocks in columns."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.sparse import coo_array, csc_array
from scipy.sparse.linalg import splu


class Sparsity:
    """Pattern of a matrix over the free degrees of freedom, made once and filled in place at every step.

    node_count: N.   groups: (G, k) numbers of nodes that are coupled, such as tetrahedra; then arrays of other widths,
    for the nodes that one cable couples.   clamped: numbers of the nodes that do not move.
    The free nodes are numbered in the minimum-degree order of their graph (SuperLU's MMD of Aᵀ + A), so that
    factorizations need no ordering of their own; `order` gives another order.
    order: (n / 3,) free nodes in that order.   indptr, indices: of the CSC matrix (n, n), n = 3 · free nodes.
    """

    def __init__(self, node_count: int, groups: Sequence[np.ndarray], clamped: np.ndarray,
                 order: np.ndarray | None = None):
        free = np.setdiff1d(np.arange(node_count), clamped)
        if not len(free):
            raise ValueError(f"all {node_count} nodes are clamped; leave some of them free")
        self.order = free[_minimum_degree(_graph(node_count, groups)[:, free][free])] if order is None else order
        self.number = np.full(node_count, -1)
        self.number[self.order] = np.arange(len(self.order))
        graph = _graph(node_count, groups)[self.order][:, self.order].tocsc()
        graph.sort_indices()
        self.size = 3 * len(self.order)
        self.graph = graph
        rows = [3 * graph.indices[start:stop, None] + np.arange(3)
                for start, stop in zip(graph.indptr, graph.indptr[1:])]
        self.indices = np.concatenate([np.tile(row.ravel(), 3) for row in rows]).astype(np.int32)
        self.heights = 3 * np.diff(graph.indptr)
        self.starts = np.concatenate([[0], np.cumsum(3 * self.heights)])
        self.indptr = np.append(np.repeat(self.starts[:-1], 3) + np.tile([0, 1, 2], len(self.heights))
                                * np.repeat(self.heights, 3), self.starts[-1]).astype(np.int32)
        self.diagonal = np.ravel([self.places(np.arange(len(self.order))[:, None], ordered=True)[0][:, 0, 0]
                                  + j * (self.heights + 1) for j in range(3)], order="F")

    def places(self, groups: np.ndarray, ordered: bool = False) -> tuple[np.ndarray, np.ndarray]:
        """For groups of nodes (G, k): the start of each block a, b in `data` (G, k, k), −1 where a or b is clamped, and
        the stride between the columns of the blocks of b (G, k).
        """
        numbers = groups if ordered else self.number[groups]
        k = groups.shape[1]
        rows, columns = np.repeat(numbers, k, axis=1).ravel(), np.tile(numbers, (1, k)).ravel()
        keys = np.repeat(np.arange(len(self.order)), np.diff(self.graph.indptr)) * len(self.order) \
            + self.graph.indices
        found = np.searchsorted(keys, columns * len(self.order) + rows)
        within = found - self.graph.indptr[np.maximum(columns, 0)]
        start = self.starts[np.maximum(columns, 0)] + 3 * within
        start[(rows < 0) | (columns < 0)] = -1
        return start.reshape(*groups.shape, k).astype(np.int64), np.where(numbers < 0, 0, self.heights[numbers])

    def matrix(self, data: np.ndarray) -> csc_array:
        """The (n, n) matrix with these entries, without copying them."""
        return csc_array((data, self.indices, self.indptr), (self.size, self.size))

    def gather(self, nodal: np.ndarray) -> np.ndarray:
        """(N, 3) → (n,): the values at the free degrees of freedom, in order."""
        return nodal[self.order].ravel()

    def scatter(self, values: np.ndarray, nodal: np.ndarray) -> np.ndarray:
        """Put (n,) into the free rows of a copy of nodal (N, 3)."""
        filled = nodal.copy()
        filled[self.order] = values.reshape(-1, 3)
        return filled


def _graph(node_count: int, groups: Sequence[np.ndarray]) -> csc_array:
    """(N, N) with ones on the diagonal and between all nodes of a group."""
    rows = np.concatenate([np.repeat(group, group.shape[1], axis=1).ravel() for group in groups])
    columns = np.concatenate([np.tile(group, (1, group.shape[1])).ravel() for group in groups])
    graph = coo_array((np.ones(len(rows)), (rows, columns)), (node_count, node_count)).tocsc()
    graph.data[:] = 1.0
    return graph


def _minimum_degree(graph: csc_array) -> np.ndarray:
    """SuperLU's elimination order: perm_c of a diagonally dominant matrix with this graph."""
    dominant = graph.copy()
    dominant.setdiag(graph.shape[0] + 1.0)
    factor = splu(dominant, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}, diag_pivot_thresh=0.0)
    return np.argsort(factor.perm_c)
