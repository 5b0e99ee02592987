"""Every solver agrees with a dense one on the matrices that a mesh makes."""

import pickle
import threading

import numpy as np
import pytest

from ssmr_torch.plants.finite_element import pardiso
from ssmr_torch.plants.finite_element.linear_solvers import linear_solver
from ssmr_torch.plants.finite_element.sparsity import Sparsity

NAMES = ("block_ldl", "superlu", "pardiso")


@pytest.fixture(params=NAMES)
def solver(request):
    """(sparsity) -> solver; skipped where its library is missing."""

    def make(sparsity):
        try:
            return linear_solver(request.param, sparsity)
        except ValueError as missing:
            if "not installed" in str(missing):
                pytest.skip(str(missing))
            raise

    return make


@pytest.fixture
def sparsity(arm, cables):
    return Sparsity(99, [arm.tetrahedra, cables(arm).stretches], np.flatnonzero(arm.nodes[:, 2] == 0))


def random_symmetric(sparsity, seed=0):
    """Entries in the pattern, standard normal."""
    matrix = sparsity.matrix(np.random.default_rng(seed).standard_normal(len(sparsity.indices)))
    return ((matrix + matrix.T) / 2).tocsc()


def dominant(sparsity, signs=1.0, seed=0):
    """Random and symmetric, the diagonal larger than the sum of its row, with the signs given."""
    matrix = random_symmetric(sparsity, seed)
    matrix.sort_indices()
    matrix.setdiag(signs * (1.1 * abs(matrix).sum(axis=0)))
    np.testing.assert_array_equal(matrix.indices, sparsity.indices)
    return matrix.data


def assert_it_solves(found, sparsity, data, right, tolerance=1e-10):
    expected = np.linalg.solve(sparsity.matrix(data).toarray(), right)
    np.testing.assert_allclose(found, expected, atol=tolerance * np.abs(expected).max())


def test_it_solves_a_positive_definite_system(solver, sparsity):
    right = np.random.default_rng(1).standard_normal(sparsity.size)
    data = dominant(sparsity)
    assert np.linalg.eigvalsh(sparsity.matrix(data).toarray()).min() > 0
    assert_it_solves(solver(sparsity).solve(data, right), sparsity, data, right)


def test_it_solves_an_indefinite_system(solver, sparsity):
    rng = np.random.default_rng(2)
    data, right = dominant(sparsity, rng.choice([-1.0, 1.0], sparsity.size)), rng.standard_normal(sparsity.size)
    assert_it_solves(solver(sparsity).solve(data, right), sparsity, data, right)


def test_it_solves_the_stiffness_of_a_bent_arm(solver, body, arm, deform):
    structure = body("neo_hookean")
    data = structure.warped_stiffness(deform(arm.nodes))
    right = np.random.default_rng(3).standard_normal(structure.sparsity.size)
    assert_it_solves(solver(structure.sparsity).solve(data, right), structure.sparsity, data, right)


def test_it_solves_a_shifted_stiffness_which_is_indefinite(solver, body, arm):
    """K − ω² M, between two modes."""
    structure = body("corotational", mass=0.04)
    data = structure.warped_stiffness(arm.nodes)
    data[structure.sparsity.diagonal] -= 50.0**2 * structure.mass
    values = np.linalg.eigvalsh(structure.sparsity.matrix(data).toarray())
    assert (values < 0).sum() == 2
    right = np.random.default_rng(4).standard_normal(structure.sparsity.size)
    assert_it_solves(solver(structure.sparsity).solve(data, right), structure.sparsity, data, right, 1e-9)


def test_it_solves_for_other_entries_each_time(solver, sparsity):
    one = solver(sparsity)
    for seed in range(3):
        data, right = dominant(sparsity, seed=seed), np.random.default_rng(seed).standard_normal(sparsity.size)
        assert_it_solves(one.solve(data, right), sparsity, data, right)


def test_it_neither_changes_nor_keeps_the_arrays_of_the_caller(solver, sparsity):
    one, data, right = solver(sparsity), dominant(sparsity), np.ones(sparsity.size)
    first = one.solve(data, right)
    kept = first.copy()
    np.testing.assert_array_equal(data, dominant(sparsity))
    np.testing.assert_array_equal(right, np.ones(sparsity.size))
    one.solve(dominant(sparsity, seed=1), 2 * right)
    np.testing.assert_array_equal(first, kept)


def test_it_solves_for_a_single_free_node(solver, arm):
    sparsity = Sparsity(99, [arm.tetrahedra], np.arange(98))
    matrix = np.array([[4.0, 1, 0.5], [1, 3, -1], [0.5, -1, 5]])
    np.testing.assert_allclose(matrix @ solver(sparsity).solve(matrix.ravel(), np.array([1.0, 2, 3])), [1, 2, 3],
                               rtol=1e-13)


def test_a_solver_gives_the_same_digits_again_and_after_pickling(solver, sparsity):
    one, data, right = solver(sparsity), dominant(sparsity), np.ones(sparsity.size)
    first = one.solve(data, right)
    np.testing.assert_array_equal(one.solve(data, right), first)
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(one)).solve(data, right), first)


def test_solvers_in_two_threads_do_not_disturb_each_other(solver, sparsity):
    data, right, found = dominant(sparsity), np.ones(sparsity.size), {}
    expected = solver(sparsity).solve(data, right)

    def work(key):
        one = solver(sparsity)
        found[key] = [one.solve(data, right) for _ in range(20)]

    threads = [threading.Thread(target=work, args=(key,)) for key in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for results in found.values():
        for result in results:
            np.testing.assert_array_equal(result, expected)


def test_block_ldl_reads_the_lower_triangle_only(sparsity):
    data, right = dominant(sparsity), np.ones(sparsity.size)
    column = np.repeat(np.arange(sparsity.size), np.diff(sparsity.indptr))
    spoilt = np.where(sparsity.indices // 3 < column // 3, np.nan, data)
    one = linear_solver("block_ldl", sparsity)
    np.testing.assert_array_equal(one.solve(spoilt, right), one.solve(data, right))


# refusals

def test_an_unknown_solver_is_refused(sparsity):
    with pytest.raises(ValueError, match="linear_solver is 'cholmod'; expected one of .*block_ldl.*superlu.*pardiso"):
        linear_solver("cholmod", sparsity)


def test_pardiso_without_mkl_is_refused_with_the_remedy(sparsity, monkeypatch, tmp_path):
    monkeypatch.setattr(pardiso.sys, "prefix", str(tmp_path))
    monkeypatch.setattr(pardiso, "find_library", lambda name: None)
    with pytest.raises(ValueError, match="MKL, which is not installed; pip install .* or choose linear_solver=block"):
        linear_solver("pardiso", sparsity)
