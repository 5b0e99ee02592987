import numpy as np
import pytest
import torch
from sklearn.preprocessing import PolynomialFeatures

from ssmr_torch.models.monomials import Form, Monomials, count_monomials, graded, on_device


@pytest.mark.parametrize(("variables", "degree"), [(1, 5), (3, 4), (6, 3), (12, 2)])
def test_monomials_come_in_the_order_of_scikit_learn(variables, degree):
    z = np.random.default_rng(0).normal(size=(20, variables))
    expected = PolynomialFeatures(degree, include_bias=False).fit_transform(z)
    np.testing.assert_allclose(graded(variables, 1, degree)(z), expected, rtol=1e-13)
    np.testing.assert_allclose(graded(variables, 1, degree)(torch.from_numpy(z)).numpy(), expected, rtol=1e-13)
    assert len(graded(variables, 1, degree)) == count_monomials(variables, 1, degree) == expected.shape[1]


def test_a_range_of_degrees_is_the_tail_of_all_degrees():
    z = np.random.default_rng(0).normal(size=(4, 3))
    np.testing.assert_array_equal(graded(3, 2, 3)(z), graded(3, 1, 3)(z)[:, 3:])


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_the_jacobian_of_the_monomials_equals_automatic_differentiation(degree):
    features = graded(4, 1, degree)
    z = torch.randn(5, 4, dtype=torch.float64)
    expected = torch.func.vmap(torch.func.jacrev(features))(z)
    torch.testing.assert_close(features.jacobian(z), expected, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(graded(4, 1, degree).jacobian(z.numpy()), expected.numpy(), rtol=1e-12)


def test_monomials_and_their_factors_may_be_given_in_any_order():
    whole, z = graded(5, 0, 3), np.random.default_rng(0).normal(size=(4, 5))
    rows = np.random.default_rng(1).permutation(len(whole))[:20]
    part = Monomials(5, [whole.factors[row][::-1] for row in rows])
    np.testing.assert_array_equal(part(z), whole(z)[:, rows])
    np.testing.assert_array_equal(part.jacobian(z), whole.jacobian(z)[:, rows])
    np.testing.assert_array_equal(part(torch.from_numpy(z)).numpy(), part(z))
    np.testing.assert_array_equal(part.chosen_rows(part.rows(z.T)).T, part(z))
    np.testing.assert_array_equal(part.chosen_rows(part.rows(torch.from_numpy(z.T))).T, part(z))
    np.testing.assert_array_equal(part.jacobian(torch.from_numpy(z)).numpy(), part.jacobian(z))


def test_the_closure_holds_all_divisors_and_nothing_else():
    found = Monomials(3, [(0, 0, 2)])
    assert found.closure == [(), (0,), (1,), (2,), (0, 0), (0, 2), (0, 0, 2)]
    assert Monomials(2, [()]).closure == [(), (0,), (1,)]


@pytest.mark.parametrize("kind", [np.asarray, torch.from_numpy])
def test_a_form_and_its_jacobian_in_some_of_the_variables_are_those_of_the_polynomial(kind):
    """f(x) = [3 x0² x2 − x1, 2 + x2³]."""
    monomials = Monomials(3, [(2, 0, 0), (1,), (), (2, 2, 2)])
    form = Form(monomials, kind(np.array([[3.0, -1.0, 0.0, 0.0], [0.0, 0.0, 2.0, 1.0]])))
    x = np.random.default_rng(0).normal(size=(7, 3))
    np.testing.assert_allclose(form(kind(x)), np.stack([3 * x[:, 0]**2 * x[:, 2] - x[:, 1], 2 + x[:, 2]**3], 1),
                               rtol=1e-14)
    expected = np.zeros((7, 2, 3))
    expected[:, 0] = np.stack([6 * x[:, 0] * x[:, 2], -np.ones(7), 3 * x[:, 0]**2], 1)
    expected[:, 1, 2] = 3 * x[:, 2]**2
    closure = monomials.multiplied_out(kind(x))
    for first, last in ((0, 3), (0, 1), (1, 3)):
        np.testing.assert_allclose(form.jacobian(closure, first, last), expected[..., first:last], rtol=1e-13)


def test_index_copies_of_an_export_on_a_device_are_not_reused_after_it():
    class Features(torch.nn.Module):
        def forward(self, x):
            return Monomials(3, [(2, 0, 0), (1,), (2, 2, 2)])(x)

    x = torch.zeros(2, 3, device="meta")
    torch.export.export(Features(), (x,), strict=False)
    assert all(type(on_device(x, parent)) is torch.Tensor for parent, _ in Monomials(3, [(2, 0, 0), (2, 2, 2)]).levels)


@pytest.mark.parametrize(("factors", "message"), [([(0, 3)], "factors from 0 to 2"), ([(-1,)], "factors from 0 to 2"),
                                                  ([(0, 1), (1, 0)], "is given twice")])
def test_monomials_of_unknown_variables_and_repeated_monomials_are_refused(factors, message):
    with pytest.raises(ValueError, match=message):
        Monomials(3, factors)


def test_monomials_of_no_variables_are_refused():
    with pytest.raises(ValueError, match="at least 1 variable"):
        graded(0, 1, 2)
