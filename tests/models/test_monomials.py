import numpy as np
import pytest
import torch
from sklearn.preprocessing import PolynomialFeatures

from ssmr_torch.models.monomial_features import MonomialFeatures
from ssmr_torch.models.monomials import Monomials, count_monomials


@pytest.mark.parametrize(("variables", "degree"), [(1, 5), (3, 4), (6, 3), (12, 2)])
def test_monomials_come_in_the_order_of_scikit_learn(variables, degree):
    z = np.random.default_rng(0).normal(size=(20, variables))
    expected = PolynomialFeatures(degree, include_bias=False).fit_transform(z)
    np.testing.assert_allclose(Monomials(variables, 1, degree)(z), expected, rtol=1e-13)
    features = MonomialFeatures(Monomials(variables, 1, degree))
    np.testing.assert_allclose(features(torch.from_numpy(z)).numpy(), expected, rtol=1e-13)
    assert len(features) == count_monomials(variables, 1, degree) == expected.shape[1]


def test_a_range_of_degrees_is_the_tail_of_all_degrees():
    z = np.random.default_rng(0).normal(size=(4, 3))
    np.testing.assert_array_equal(Monomials(3, 2, 3)(z), Monomials(3, 1, 3)(z)[:, 3:])


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_the_jacobian_of_the_monomials_equals_automatic_differentiation(degree):
    features = MonomialFeatures(Monomials(4, 1, degree))
    z = torch.randn(5, 4, dtype=torch.float64)
    expected = torch.func.vmap(torch.func.jacrev(features))(z)
    torch.testing.assert_close(features.jacobian(z), expected, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(Monomials(4, 1, degree).jacobian(z.numpy()), expected.numpy(), rtol=1e-12)


def test_selected_monomials_are_those_rows_of_values_and_jacobian():
    whole = Monomials(5, 1, 3)
    rows = whole.exponents[:, 3:].sum(1) <= 1
    part, z = whole.selected(rows), np.random.default_rng(0).normal(size=(4, 5))
    np.testing.assert_array_equal(part(z), whole(z)[:, rows])
    np.testing.assert_array_equal(part.jacobian(z), whole.jacobian(z)[:, rows])
    fewer = whole.exponents[:, 0] == 0
    np.testing.assert_array_equal(part.selected(fewer[rows])(z), whole(z)[:, rows & fewer])
    features = MonomialFeatures(part)
    np.testing.assert_allclose(features(torch.from_numpy(z)).numpy(), part(z), rtol=1e-13)
    np.testing.assert_allclose(features.jacobian(torch.from_numpy(z)).numpy(), part.jacobian(z), rtol=1e-13)


def test_monomials_of_no_variables_are_refused():
    with pytest.raises(ValueError, match="at least 1 variable"):
        Monomials(0, 1, 2)
