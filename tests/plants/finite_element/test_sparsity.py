"""The pattern holds what groups of nodes couple, each entry where it is said to be."""

import numpy as np
import pytest
from scipy.sparse import csc_array
from scipy.sparse.linalg import splu

from ssmr_torch.plants.finite_element.sparsity import Sparsity

CLAMPED = np.array([3, 0, 7])


@pytest.fixture
def groups(arm, cables):
    """Tetrahedra, and the wider groups that cables join."""
    return [arm.tetrahedra, cables(arm).stretches]


@pytest.fixture
def sparsity(groups):
    return Sparsity(99, groups, CLAMPED)


def rows_of(sparsity):
    """Degrees of freedom of all nodes, in the pattern's order: 3 · node + axis."""
    return (3 * sparsity.order[:, None] + np.arange(3)).ravel()


def scattered(groups, blocks):
    """The sum of blocks (G, 3k, 3k) of the groups, over the degrees of freedom of all 99 nodes, dense."""
    dense = np.zeros((297, 297))
    for group, each in zip(groups, blocks):
        for nodes, block in zip(group, each):
            rows = (3 * nodes[:, None] + np.arange(3)).ravel()
            np.add.at(dense, np.ix_(rows, rows), block)
    return dense


def filled(sparsity, groups, blocks):
    """The same entry by entry, through the places and strides of the pattern."""
    data = np.zeros(len(sparsity.indices))
    for group, each in zip(groups, blocks):
        places, strides = sparsity.places(group)
        for g, a, b in zip(*np.nonzero(places >= 0)):
            for i in range(3):
                for j in range(3):
                    data[places[g, a, b] + j * strides[g, b] + i] += each[g, 3 * a + i, 3 * b + j]
    return data


def test_a_matrix_assembled_block_by_block_is_the_dense_one(sparsity, groups):
    rng = np.random.default_rng(0)
    blocks = [rng.standard_normal((len(group), 3 * group.shape[1], 3 * group.shape[1])) for group in groups]
    rows = rows_of(sparsity)
    found = sparsity.matrix(filled(sparsity, groups, blocks)).toarray()
    np.testing.assert_allclose(found, scattered(groups, blocks)[np.ix_(rows, rows)], atol=1e-13)


def test_clamped_nodes_have_no_place(sparsity, groups):
    for group in groups:
        places, _ = sparsity.places(group)
        clamped = np.isin(group, CLAMPED)
        np.testing.assert_array_equal(places < 0, clamped[:, :, None] | clamped[:, None, :])


def test_the_order_is_a_permutation_of_the_free_nodes(sparsity):
    np.testing.assert_array_equal(np.sort(sparsity.order), np.setdiff1d(np.arange(99), CLAMPED))
    np.testing.assert_array_equal(sparsity.number[sparsity.order], np.arange(96))
    assert (sparsity.number[CLAMPED] == -1).all()
    assert sparsity.size == 3 * 96


def test_the_order_fills_the_factor_as_little_as_superlus_minimum_degree(arm, groups):
    """The factor of a dominant matrix with the pattern, in the pattern's order and in the one that SuperLU finds."""
    def fill(sparsity, ordering):
        matrix = sparsity.matrix(np.ones(len(sparsity.indices))).copy()
        matrix.setdiag(1e4)
        factor = splu(csc_array(matrix), permc_spec=ordering, diag_pivot_thresh=0.0, options={"SymmetricMode": True})
        return factor.L.nnz

    ours = Sparsity(99, groups, CLAMPED)
    as_numbered = Sparsity(99, groups, CLAMPED, np.setdiff1d(np.random.default_rng(0).permutation(99), CLAMPED))
    assert fill(ours, "NATURAL") <= 1.05 * fill(as_numbered, "MMD_AT_PLUS_A")


def test_a_prescribed_order_is_kept(groups):
    order = np.random.default_rng(1).permutation(np.setdiff1d(np.arange(99), CLAMPED))
    np.testing.assert_array_equal(Sparsity(99, groups, CLAMPED, order).order, order)


def test_the_diagonal_has_the_stated_positions(sparsity):
    data, values = np.zeros(len(sparsity.indices)), np.random.default_rng(2).uniform(1, 2, sparsity.size)
    data[sparsity.diagonal] = values
    np.testing.assert_array_equal(sparsity.matrix(data).toarray(), np.diag(values))


def test_the_indices_are_sorted_and_the_pattern_is_symmetric(sparsity):
    matrix = sparsity.matrix(np.ones(len(sparsity.indices)))
    for column in range(sparsity.size):
        assert (np.diff(sparsity.indices[sparsity.indptr[column]:sparsity.indptr[column + 1]]) > 0).all()
    assert (matrix != matrix.T).nnz == 0


def test_scatter_undoes_gather_and_leaves_clamped_nodes(sparsity, arm):
    values = sparsity.gather(arm.nodes)
    np.testing.assert_array_equal(values, arm.nodes.ravel()[rows_of(sparsity)])
    np.testing.assert_array_equal(sparsity.scatter(values, arm.nodes), arm.nodes)
    shifted = sparsity.scatter(values + 1, arm.nodes) - arm.nodes
    np.testing.assert_allclose(shifted, np.isin(np.arange(99), CLAMPED, invert=True)[:, None] * [1.0, 1, 1], rtol=1e-12)


def test_a_body_that_is_clamped_everywhere_is_refused(groups):
    with pytest.raises(ValueError, match="all 99 nodes are clamped; leave some of them free"):
        Sparsity(99, groups, np.arange(99))
