"""Output coordinates: exact inverses and derivatives, arcs of known curvature, and their JSON values."""

import json
import sys
from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch

from ssmr_torch.control.horizon import LinearizedHorizon, horizon_for
from ssmr_torch.control.horizon_kernel import compiled_polynomial
from ssmr_torch.control.tracking_problem import TrackingProblem
from ssmr_torch.deployment import artifact
from ssmr_torch.deployment.c.model_source import write_c
from ssmr_torch.models.arrays import namespace
from ssmr_torch.models.monomials import graded
from ssmr_torch.models.output_coordinates import (
    ConstantCurvature,
    Identity,
    Mixture,
    OutputCoordinates,
    coordinates_from_plain,
)
from ssmr_torch.models.polynomial import PolynomialModel
from ssmr_torch.models.structure import Structure

SPACE = ConstantCurvature(((0.0, 0.0, 0.1), (0.02, -0.03, 0.18)))
PLANE = ConstantCurvature(((0.12, 0.0), (0.0, -0.3)))
AVERAGED = Mixture((SPACE, Identity(6), ConstantCurvature(((0.0, 0.1, 0.1), (0.0, 0.0, 0.2)))), (0.5, 0.3, 0.2), 6)
WITHIN = Mixture((Mixture((PLANE, Identity(4)), (0.5, 0.5), 4), PLANE), (0.25, 0.75), 4)
ALL = {"space": SPACE, "plane": PLANE, "identity": Identity(6), "averaged": AVERAGED, "a mixture within": WITHIN}


@dataclass(frozen=True)
class Stretched(OutputCoordinates):
    """ξ = factor sinh(y / factor), of a user."""

    factor: float

    def forward(self, y):
        return self.factor * namespace(y).sinh(y / self.factor)

    def inverse(self, xi):
        return self.factor * namespace(xi).arcsinh(xi / self.factor)


def bent(coordinates, rng, size=200, angle=3.0):
    """ξ of arcs that bend by up to `angle`, 20 % longer or shorter than at rest, (size, p)."""
    parts = []
    for base in coordinates.bases:
        r0, e = np.linalg.norm(base), np.array(base) / np.linalg.norm(base)
        lateral = rng.normal(size=(size, len(base)))
        lateral -= (lateral @ e)[:, None] * e
        lateral *= angle * rng.uniform(0, 1, (size, 1)) / np.linalg.norm(lateral, axis=1, keepdims=True)
        parts.append(r0 * (lateral + rng.uniform(-0.2, 0.2, (size, 1)) * e))
    return np.concatenate(parts, axis=1)


@pytest.mark.parametrize("coordinates", [SPACE, PLANE], ids=["space", "plane"])
def test_the_inverse_is_exact_for_arcs_that_bend_up_to_three_radians(coordinates):
    xi = bent(coordinates, np.random.default_rng(0))
    y = coordinates.inverse(xi)
    np.testing.assert_allclose(coordinates.forward(y), xi, rtol=0, atol=2e-14)
    np.testing.assert_allclose(coordinates.inverse(coordinates.forward(y)), y, rtol=0, atol=2e-15)


def test_the_inverse_of_tensors_is_that_of_arrays():
    xi = bent(SPACE, np.random.default_rng(0))
    y = SPACE.inverse(torch.from_numpy(xi))
    np.testing.assert_allclose(y.numpy(), SPACE.inverse(xi), rtol=0, atol=1e-16)
    np.testing.assert_allclose(SPACE.forward(y).numpy(), xi, rtol=0, atol=2e-14)
    assert SPACE.forward(y.float()).dtype == torch.float32
    np.testing.assert_allclose(SPACE.forward(torch.zeros(6, dtype=torch.float32)), np.zeros(6), atol=1e-7)


@pytest.mark.parametrize("angle", [1e-9, 0.3, np.pi / 2, 3.0, -2.0])
@pytest.mark.parametrize("length", [0.15, 0.2])
def test_an_arc_of_known_curvature_gives_its_angle_and_its_length(angle, length):
    """A planar arc along y of curvature κ ends at ((1 − cos κ s) / κ, sin κ s / κ), bent by κ s; the chord by half."""
    curvature = angle / length
    end = np.array([(1.0 - np.cos(angle)) / curvature if abs(angle) > 1e-6 else 0.5 * angle * length,
                    np.sin(angle) / curvature])
    r0 = 0.18
    xi = ConstantCurvature(((0.0, r0),)).forward(end - [0.0, r0])
    np.testing.assert_allclose(xi, [r0 * angle / 2, length - r0], rtol=0, atol=1e-15)
    turned = np.array([[0.6, 0.0], [0.8, 0.0], [0.0, 1.0]])                    # the same arc in a plane of space
    xi = ConstantCurvature(((0.0, 0.0, r0),)).forward(turned @ end - [0.0, 0.0, r0])
    np.testing.assert_allclose(xi, turned @ [r0 * angle / 2, length - r0], rtol=0, atol=1e-15)


@pytest.mark.parametrize("coordinates", [SPACE, PLANE, AVERAGED, WITHIN], ids=["space", "plane", "averaged", "within"])
def test_at_rest_coordinates_are_zero_and_to_first_order_the_outputs(coordinates):
    p = 6 if coordinates in (SPACE, AVERAGED) else 4
    assert np.abs(coordinates.forward(np.zeros(p))).max() <= 1e-16
    y = 1e-7 * np.random.default_rng(0).normal(size=p)
    np.testing.assert_allclose(coordinates.forward(y), np.tile(y, coordinates.latent(p) // p), rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", ALL)
def test_the_jacobian_is_that_of_central_differences_and_of_automatic_differentiation(name):
    coordinates, rng = ALL[name], np.random.default_rng(1)
    p = 4 if name in ("plane", "a mixture within") else 6
    for size in (0.0, 0.03, 0.1):
        xi = size * rng.normal(size=coordinates.latent(p))
        exact = coordinates.inverse_jacobian(xi)
        assert exact.shape == (p, len(xi))
        np.testing.assert_allclose(exact, OutputCoordinates.inverse_jacobian(coordinates, xi), rtol=0, atol=3e-8)
        automatic = torch.func.jacfwd(coordinates.inverse)(torch.from_numpy(xi))
        np.testing.assert_allclose(exact, automatic, rtol=0, atol=1e-13)
        tensors = coordinates.inverse_jacobian(torch.from_numpy(xi).expand(2, 3, -1))
        np.testing.assert_allclose(tensors, np.broadcast_to(exact, (2, 3, *exact.shape)), rtol=0, atol=1e-15)


def test_the_slopes_of_the_coordinates_are_finite_at_rest_and_undo_those_of_the_inverse():
    for y in (torch.zeros(6, dtype=torch.float64), 0.05 * torch.arange(6, dtype=torch.float64)):
        forward = torch.func.jacrev(SPACE.forward)(y)
        back = SPACE.inverse_jacobian(SPACE.forward(y))
        torch.testing.assert_close(back @ forward, torch.eye(6, dtype=torch.float64), rtol=0, atol=1e-12)


def test_a_mixture_is_the_weighted_mean_of_its_parts_side_by_side():
    rng = np.random.default_rng(2)
    xi, y = 0.05 * rng.normal(size=(5, 18)), 0.05 * rng.normal(size=(5, 6))
    mean = sum(weight * part.inverse(xi[:, 6 * k:6 * k + 6])
               for k, (part, weight) in enumerate(zip(AVERAGED.parts, AVERAGED.weights)))
    np.testing.assert_allclose(AVERAGED.inverse(xi), mean, rtol=1e-15)
    np.testing.assert_array_equal(AVERAGED.forward(y), np.concatenate([part.forward(y) for part in AVERAGED.parts], -1))
    np.testing.assert_allclose(AVERAGED.inverse(AVERAGED.forward(y)), y, rtol=0, atol=1e-15)  # all parts say the same


@pytest.mark.parametrize("coordinates", [*ALL.values(), Stretched(0.1)], ids=[*ALL, "a user's own"])
def test_plain_values_in_json_are_the_same_coordinates_again(coordinates):
    again = coordinates_from_plain(json.loads(json.dumps(coordinates.plain())))
    assert again == coordinates and hash(again) == hash(coordinates)
    assert coordinates_from_plain(None) is None


def test_markers_of_a_mixture_within_a_mixture_multiply_their_weights():
    markers = WITHIN.markers()
    np.testing.assert_allclose(markers[:, 0], [0, 2, 4, 8, 10])    # first coordinate
    np.testing.assert_allclose(markers[:, 1], [0, 2, 0, 0, 2])     # first output
    np.testing.assert_allclose(markers[:, 3], [0.125, 0.125, 0.125, 0.75, 0.75])
    np.testing.assert_allclose(markers[:, 4], [0.12, 0.3, 0.0, 0.12, 0.3])
    assert Mixture((Stretched(0.1), Identity(4)), (0.5, 0.5), 4).markers() is None


@pytest.mark.parametrize(("make", "message"), [
    (lambda: ConstantCurvature(((0.0, 0.0, 0.0),)), "finite numbers in m, not all zero"),
    (lambda: ConstantCurvature(((0.1,),)), r"base is \(0.1,\); expected 2 or 3"),
    (lambda: ConstantCurvature(((0.0, np.nan),)), "expected 2 or 3 finite numbers"),
    (lambda: Mixture((PLANE, Identity(4)), (1.0,), 4), r"2 coordinates with the weights \(1.0,\)"),
    (lambda: Mixture((PLANE, Identity(4)), (0.5, 0.6), 4), "one positive weight for each, of sum 1"),
    (lambda: small_model(PLANE), "output coordinates for 4 outputs, but the model has 2"),
    (lambda: coordinates_from_plain({"class": "ssmr_torch.models.monomials:Form"}), "is not a class of output coord"),
    (lambda: coordinates_from_plain({"class": "no_such_module:Mine"}), "no_such_module:Mine is not found here"),
    (lambda: coordinates_from_plain({"class": "ssmr_torch.models.monomials:Mine"}), "put its module on the Python")])
def test_invalid_output_coordinates_are_refused_with_the_reason(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_a_class_inside_a_function_is_refused_because_it_cannot_be_loaded():
    @dataclass(frozen=True)
    class Hidden(Identity):
        pass

    with pytest.raises(ValueError, match="defined inside a function.*at the top level of a module"):
        Hidden(2).plain()


def small_model(coordinates, **options):
    """A contraction of two states with quadratic terms, two outputs in the plane."""
    sides = 1 if coordinates is None else coordinates.latent(2) // 2
    structure = Structure(graded(4, 1, 1), (0, 1, 2, 3), graded(2, 1, 1), graded(3, 1, 2), "map", saturated=True)
    dynamics = np.random.default_rng(0).normal(size=(2, len(structure.dynamics))) * 0.1
    dynamics[:, :2] += 0.8 * np.eye(2)
    return PolynomialModel(
        structure=structure, chart=np.eye(2, 4, 2), parametrization=np.tile(np.eye(2), (sides, 1)), dynamics=dynamics,
        input_dim=1, output_dim=2, delays=1, timestep=0.01, window_timestep=0.01, coordinates=coordinates,
        **({"state_scale": np.full(2, 0.1)} | options))


def saved(directory, model):
    return artifact.save(directory, model, output_names=["x", "y"], input_names=["u"], rest=[0.0, 0.0],
                         input_range=[[0.0], [1.0]])


ARC = ConstantCurvature(((0.0, 0.3),))


def test_the_model_and_its_card_describe_the_coordinates(tmp_path):
    model = small_model(ARC)
    assert "output coordinates: bending angle and length of constant-curvature arcs, 300 mm long at rest" in repr(model)
    loaded = artifact.load(saved(tmp_path / "arc", model))
    assert "constant-curvature arcs, 300 mm long at rest" in loaded.card["geometry"]
    assert loaded.card["model"]["reach"] == 1.0 and loaded.card["model"]["coordinates"] == json.loads(
        json.dumps(ARC.plain()))
    assert loaded.model.coordinates == ARC
    words = small_model(Mixture((ARC, Identity(2)), (0.75, 0.25), 2)).geometry
    assert "0.75 of bending angle and length of" in words and "0.25 of the outputs themselves" in words
    assert f"Stretched of {Stretched.__module__}" in small_model(Stretched(0.1)).geometry
    assert "coordinates" not in small_model(None).geometry


def test_an_old_artifact_has_no_coordinates_and_no_reach(tmp_path, rewrite):
    at = saved(tmp_path / "old", small_model(None))
    rewrite(at, noted=lambda noted: [noted["plain"].pop(name) for name in ("coordinates", "reach")])
    model = artifact.load(at).model
    assert model.coordinates is None and model.reach == 1.0


def test_nonlinear_terms_saturate_beyond_the_reach():
    once, twice = (small_model(None, reach=reach) for reach in (1.0, 2.0))
    u = np.zeros(1)
    np.testing.assert_array_equal(twice.edge, 2 * once.state_scale)
    within, beyond = np.array([0.09, -0.09]), np.array([0.19, -0.19])
    np.testing.assert_array_equal(once.step(within, u), twice.step(within, u))
    assert np.abs(once.step(beyond, u) - twice.step(beyond, u)).max() > 1e-5
    with pytest.raises(ValueError, match="reach is 0.0; expected a positive and finite number"):
        small_model(None, reach=0.0)


def test_curved_coordinates_are_not_affine_and_straight_ones_are():
    linear = graded(3, 1, 1)
    model = small_model(None)
    model = replace(model, structure=model.structure._replace(dynamics=linear, saturated=False),
                    dynamics=model.dynamics[:, :3])
    for coordinates, affine in ((None, True), (Identity(2), True), (ARC, False)):
        assert replace(model, coordinates=coordinates).affine is affine


OWN = '''
from dataclasses import dataclass
from ssmr_torch.models.output_coordinates import OutputCoordinates

@dataclass(frozen=True)
class Doubled(OutputCoordinates):
    factor: float

    def forward(self, y):
        return self.factor * y

    def inverse(self, xi):
        return xi / self.factor
'''


def test_coordinates_of_a_user_are_loaded_by_their_module_and_refused_without_it(tmp_path, monkeypatch):
    (tmp_path / "my_coordinates.py").write_text(OWN)
    with monkeypatch.context() as context:
        context.syspath_prepend(tmp_path)
        from my_coordinates import Doubled

        at = saved(tmp_path / "model", small_model(Doubled(2.0)))
        assert artifact.load(at).model.coordinates == Doubled(2.0)
        assert "Doubled of my_coordinates" in artifact.load(at).card["geometry"]
    monkeypatch.delitem(sys.modules, "my_coordinates")
    with pytest.raises(ValueError, match="my_coordinates:Doubled is not found here .*install the package"):
        artifact.load(at)


@pytest.mark.parametrize("named", ["ssmr_torch.models.output_coordinates:Nothing", "collections:OrderedDict"])
def test_an_artifact_that_names_a_wrong_class_is_refused(named, tmp_path, rewrite):
    at = saved(tmp_path / "model", small_model(ARC))
    rewrite(at, noted=lambda noted: noted["plain"]["coordinates"].update({"class": named}))
    with pytest.raises(ValueError, match=f"{named},? is "):
        artifact.load(at)


def test_coordinates_of_a_user_go_through_the_linearization_and_are_refused_in_c(tmp_path):
    model = small_model(Stretched(0.1))
    assert compiled_polynomial(model) is None and compiled_polynomial(small_model(ARC)) is not None
    problem = TrackingProblem(lambda time: np.zeros((len(time), 2)), np.array([[0.0], [1.0]]), output_weight=np.ones(2),
                              input_weight=1.0, horizon=3, period=0.01)
    assert type(horizon_for(model, problem)) is LinearizedHorizon
    with pytest.raises(ValueError, match="Stretched of .* have no C form: .*leave c out of the formats"):
        write_c(model, artifact.load(saved(tmp_path / "model", model)).card)
