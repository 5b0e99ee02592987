"""Output coordinates that suit the data, and output coordinates of a user."""

from dataclasses import dataclass

import numpy as np
import pytest

from ssmr_torch.models.output_coordinates import OutputCoordinates
from ssmr_torch.selection.choose import _coordinates
from ssmr_torch.selection.coordinates import arc_length, inferred_base, offered

LENGTH = 0.12


def tip_of_an_arc(seed=0, count=1500, length=LENGTH, stretch=0.01, most=1.0, dimensions=3):
    """Displacements of the tip of a constant-curvature arm that bends by up to `most` rad any way and stretches."""
    rng = np.random.default_rng(seed)
    bend, way = most * np.sqrt(rng.random(count)), rng.uniform(0, 2 * np.pi, count)
    chord = length * (1 + stretch * rng.normal(size=count)) * np.sinc(bend / 2 / np.pi)
    lateral = chord * np.sin(bend / 2)
    along = chord * np.cos(bend / 2) - length
    if dimensions == 2:
        return np.stack([lateral * np.sign(np.cos(way)), along], axis=1)
    return np.stack([lateral * np.cos(way), lateral * np.sin(way), along], axis=1)


@pytest.mark.parametrize("dimensions", [2, 3])
def test_the_base_of_a_constant_curvature_arm_is_inferred_from_displacements_alone(dimensions):
    y = tip_of_an_arc(dimensions=dimensions)
    expected = LENGTH * np.eye(dimensions)[-1]
    assert np.linalg.norm(np.array(inferred_base(y)) - expected) < 0.05 * LENGTH
    found = offered(y)
    assert list(found) == ["identity", "constant_curvature"] and found["identity"] is None
    chi = found["constant_curvature"]
    np.testing.assert_allclose(chi.inverse(chi.forward(y)), y, atol=1e-12)


def test_in_the_coordinates_of_its_base_an_arm_keeps_its_length():
    y, base = tip_of_an_arc(stretch=0.0), [0.0, 0.0, LENGTH]
    np.testing.assert_allclose(arc_length(y + base, base), LENGTH, rtol=1e-12)


def test_a_turned_arm_has_a_turned_base():
    turn = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    found = inferred_base(tip_of_an_arc() @ turn.T)
    assert np.linalg.norm(found - turn @ [0, 0, LENGTH]) < 0.05 * LENGTH


def test_a_random_cloud_has_no_base():
    rng = np.random.default_rng(0)
    assert inferred_base(0.02 * rng.normal(size=(1000, 3))) is None
    assert list(offered(0.02 * rng.normal(size=(1000, 3)))) == ["identity"]
    assert inferred_base(np.zeros((100, 3))) is None


def test_columns_that_are_no_markers_are_left_as_they_are():
    for columns in (1, 5, 7):
        assert list(offered(np.random.default_rng(0).normal(size=(100, columns)))) == ["identity"]


def test_a_marker_without_a_base_beside_one_that_has_one_is_left_nearly_as_it_is():
    other = 0.003 * np.random.default_rng(0).normal(size=(1500, 3))
    y = np.hstack([tip_of_an_arc(), other])
    chi = offered(y)["constant_curvature"]
    assert np.linalg.norm(np.array(chi.bases[0]) - [0, 0, LENGTH]) < 0.05 * LENGTH
    assert np.abs(chi.forward(y)[:, 3:] - other).max() < 0.01 * np.abs(other).max()


@dataclass(frozen=True)
class Cubed(OutputCoordinates):
    """One to one."""

    def forward(self, y):
        return y + 50.0 * y ** 3

    def inverse(self, xi):
        y = xi
        for _ in range(60):
            y = y - (y + 50.0 * y ** 3 - xi) / (1.0 + 150.0 * y ** 2)
        return y


@dataclass(frozen=True)
class Squared(OutputCoordinates):
    """Not one to one: the sign is lost."""

    def forward(self, y):
        return y ** 2

    def inverse(self, xi):
        return xi ** 0.5


@dataclass(frozen=True)
class Shifted(OutputCoordinates):
    """Rest is not mapped to rest."""

    def forward(self, y):
        return y + 0.01

    def inverse(self, xi):
        return xi - 0.01


def test_coordinates_of_a_user_are_loaded_by_their_name():
    assert _coordinates(tip_of_an_arc(), [f"{__name__}:Cubed"]) == {f"{__name__}:Cubed": Cubed()}


@pytest.mark.parametrize(("name", "says"), [
    (f"{__name__}:Squared", r"not invertible on the recordings: .* differs from y by up to \d+ mm.*correct the"),
    (f"{__name__}:Shifted", "must map rest to zero, but χ.0. ≠ 0; subtract χ.0."),
    (f"{__name__}:tip_of_an_arc", "is not a class of output coordinates; derive it from"),
    ("polar", "output coordinates 'polar' are not possible with these data; give one of .'identity', 'constant_curv")])
def test_coordinates_that_cannot_be_used_are_refused_with_the_remedy(name, says):
    with pytest.raises(ValueError, match=says):
        _coordinates(tip_of_an_arc(), [name])


@pytest.mark.parametrize("name", ["nowhere_to_be_found:Class", f"{__name__}:Missing"])
def test_coordinates_that_are_not_installed_are_refused_by_name(name):
    with pytest.raises((ImportError, AttributeError, ValueError), match=name.split(":")[0 if "nowhere" in name else 1]):
        _coordinates(tip_of_an_arc(), [name])
