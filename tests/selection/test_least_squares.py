"""Ridge regressions from moments are those of the rows themselves."""

import numpy as np
import pytest

from ssmr_torch.selection.least_squares import Moments, by_fold


@pytest.fixture
def rows():
    rng = np.random.default_rng(0)
    X = rng.normal(size=(200, 5)) * [1.0, 10.0, 0.1, 3.0, 1.0]
    return X, X @ rng.normal(size=(5, 2)) + rng.normal(size=(200, 2))


def test_the_solution_is_that_of_least_squares(rows):
    X, T = rows
    np.testing.assert_allclose(Moments.of(X, T).solution(0.0), np.linalg.lstsq(X, T, rcond=None)[0].T, rtol=1e-8)


@pytest.mark.parametrize("ridge", [0.3, np.array([0.0, 0.1, 1.0, 0.0, 2.0])])
def test_a_ridge_is_relative_to_the_mean_square_of_its_column(rows, ridge):
    """As rows √(N ridge_j) rms_j that want the coefficient j to be zero."""
    X, T = rows
    penalty = np.diag(np.sqrt(len(X) * np.broadcast_to(ridge, 5) * np.square(X).mean(0)))
    expected = np.linalg.lstsq(np.vstack([X, penalty]), np.vstack([T, np.zeros((5, 2))]), rcond=None)[0].T
    np.testing.assert_allclose(Moments.of(X, T).solution(ridge), expected, rtol=1e-9)


def test_moments_without_a_fold_are_those_of_the_rows_left(rows):
    X, T = rows
    touching = np.random.default_rng(1).random((4, 200)) < 0.3
    found = list(by_fold(X, T, touching))
    assert len(found) == 5
    for moments, left in zip(found, [*~touching, np.ones(200, bool)]):
        expected = Moments.of(X[left], T[left])
        assert moments.rows == expected.rows
        np.testing.assert_allclose(moments.regressors, expected.regressors, atol=1e-12 * np.square(X).max())
        np.testing.assert_allclose(moments.solution(0.1), expected.solution(0.1), rtol=1e-9)


def test_a_fold_that_holds_out_all_rows_is_refused_with_both_numbers(rows):
    with pytest.raises(ValueError, match="200 rows, of which a fold holds out 200, so that none remain; record longer"):
        list(by_fold(*rows, np.ones((1, 200), bool)))


def test_equal_columns_share_their_coefficient_and_a_column_of_zeros_has_none(rows):
    X, T = rows
    found = Moments.of(np.column_stack([X, X[:, 0], 0 * X[:, 0]]), T).solution(0.0)
    np.testing.assert_allclose(found[:, 0], found[:, 5], rtol=1e-2)
    np.testing.assert_allclose(found[:, 0] + found[:, 5], Moments.of(X, T).solution(0.0)[:, 0], rtol=1e-6)
    assert (found[:, 6] == 0).all()
