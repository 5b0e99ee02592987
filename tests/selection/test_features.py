"""Each kind of flow map has the monomials that its name says."""

from math import comb

import pytest

from ssmr_torch.selection.features import LARGEST, flow_monomials
from ssmr_torch.selection.specification import FEATURES

SIZES = {"slow": 9, "leading": 3, "follows": 4, "memory": 4, "inputs": 2}


def closed_formula(kind, n, q, v, a):
    """Monomials beyond the linear ones, with a inputs, or states of the memory, that act."""
    pairs, cubes = comb(q + 1, 2), comb(q + 2, 3)
    affine = comb(q + a + 1, 2) + v * (q + a) + pairs * a
    return {"linear": 0, "bilinear": n * a, "leading_bilinear": q * a, "quadratic": n * a + pairs + q * v,
            "configuration_affine": affine, "cubic": affine + cubes, "leading_cubic": n * a + pairs + cubes,
            "full_quadratic": comb(n + a + 1, 2), "quadratic_map": comb(n + 1, 2)}[kind]


@pytest.mark.parametrize("pole", [False, True])
@pytest.mark.parametrize("kind", FEATURES)
def test_there_are_as_many_as_the_closed_formula_says_each_once(kind, pole):
    linear, beyond = flow_monomials(kind, **SIZES, pole=pole)
    assert linear[0] == () and sorted(linear[1:]) == [(k,) for k in range(15)]
    assert len(beyond) == len(set(beyond)) == closed_formula(kind, 9, 3, 4, 4 if pole else 2)
    assert all(len(row) > 1 for row in beyond)


@pytest.mark.parametrize("kind", sorted(set(FEATURES) - {"full_quadratic", "quadratic_map"}))
def test_the_velocity_enters_linearly(kind):
    _, beyond = flow_monomials(kind, **SIZES, pole=False)
    assert max((sum(3 <= factor < 9 for factor in row) for row in beyond), default=0) <= 1


def test_products_use_the_state_of_the_actuator_if_there_is_one():
    for pole, acting, idle in ((True, range(9, 13), range(13, 15)), (False, range(13, 15), range(9, 13))):
        _, beyond = flow_monomials("configuration_affine", **SIZES, pole=pole)
        seen = {factor for row in beyond for factor in row}
        assert set(acting) <= seen and not seen & set(idle)


def test_more_monomials_than_can_be_determined_are_refused_with_both_numbers():
    with pytest.raises(ValueError, match=rf"861 monomials in a full_quadratic flow map; at most {LARGEST}"):
        flow_monomials("full_quadratic", slow=38, leading=3, follows=3, memory=0, inputs=2, pole=False)
