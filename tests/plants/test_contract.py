"""What every plant promises, held against each of them."""

from copy import deepcopy
from functools import cache

import numpy as np
import pytest

from ssmr_torch.plants.base import Plant
from ssmr_torch.plants.cosserat_rod import CosseratRod
from ssmr_torch.plants.diamond import Diamond
from ssmr_torch.plants.emulated_rig import Rig
from ssmr_torch.plants.isupport import ISupport
from ssmr_torch.plants.planar_hsa import PlanarHSA
from ssmr_torch.plants.pressure_arm import PressureArm
from ssmr_torch.plants.slow_manifold import SlowManifold
from ssmr_torch.plants.tendon_chain import TendonChain
from ssmr_torch.plants.trunk import Trunk

CONTINUUM = {"law": "neo_hookean", "mass_distribution": "volume"}
IDEAL = {
    "slow manifold, markers": SlowManifold,
    "slow manifold, state": lambda: SlowManifold(observe="state", input_bounds=(0.2, 1.0)),
    "trunk": lambda: Trunk("trunk_coarse"),
    "trunk, generalized-alpha": lambda: Trunk("trunk_coarse", scheme="generalized_alpha", input_bounds=(0, 0.3),
                                              **CONTINUUM),
    "diamond": lambda: Diamond("diamond_coarse"),
    "diamond, BDF2": lambda: Diamond("diamond_coarse", scheme="bdf2", **CONTINUUM),
    "pressure arm": PressureArm,
    "tendon chain": TendonChain,
    "Cosserat rod": CosseratRod,
    "I-SUPPORT": ISupport,
    "planar HSA": PlanarHSA,
}
PLANTS = IDEAL | {
    "slow manifold on a rig": lambda: Rig(
        SlowManifold(input_bounds=(0.1, 1.5)), noise_std=1e-4, sensor_delay=0.02, drop_probability=0.2,
        actuator_lag=0.03, rate_limit=20.0, saturation=1.2, cable_friction=0.1),
    "pressure arm before a camera": lambda: Rig(PressureArm(), noise_std=5e-5),
    "diamond on a rig": lambda: Rig(Diamond("diamond_coarse"), noise_std=1e-4, sensor_delay=0.01, cable_friction=0.2),
    "trunk, two outputs on a rig": lambda: Rig(Trunk("trunk_coarse"), outputs=["tip_z", "tip_x"], sensor_delay=0.02),
}
# Simulated by a package of the extra robots; soromox compiles for some ten seconds.
PACKAGES = {"tendon chain": "mujoco", "Cosserat rod": "elastica", "I-SUPPORT": "soromox", "planar HSA": "soromox"}


def marked(names):
    return [pytest.param(name, marks=pytest.mark.slow) if PACKAGES.get(name) == "soromox" else name for name in names]


@cache
def built(name):
    if name in PACKAGES:
        pytest.importorskip(PACKAGES[name], reason="the extra robots is not installed")
    return PLANTS[name]()


@pytest.fixture(params=marked(PLANTS))
def plant(request):
    return deepcopy(built(request.param))


@pytest.fixture(params=marked(IDEAL))
def ideal(request):
    return deepcopy(built(request.param))


def random_inputs(plant, count, seed=0):
    low, high = plant.input_bounds
    return np.random.default_rng(seed).uniform(low, high, (count, len(low)))


def run(plant, inputs):
    return np.array([plant.step(u) for u in inputs])


def test_it_offers_the_plant_interface(plant):
    assert isinstance(plant, Plant)
    assert plant.timestep > 0
    assert plant.input_bounds.shape == (2, len(plant.input_names))
    assert (plant.input_bounds[0] < plant.input_bounds[1]).all()
    assert plant.rest.shape == (len(plant.output_names),)
    assert isinstance(plant.name, str) and plant.name


def test_the_displacement_is_zero_at_rest(plant):
    run(plant, random_inputs(plant, 3))
    plant.reset()
    np.testing.assert_array_equal(plant.displacement, np.zeros(len(plant.output_names)))


def test_an_ideal_plant_observes_its_displacement(ideal):
    np.testing.assert_array_equal(ideal.reset(), ideal.displacement)
    for u in random_inputs(ideal, 10):
        np.testing.assert_array_equal(ideal.step(u), ideal.displacement)
    saved = ideal.state
    ideal.reset()
    np.testing.assert_array_equal(ideal.reset(state=saved), ideal.displacement)


def test_observations_are_finite_vectors_of_at_most_robot_size(plant):
    plant.reset(seed=0)
    observations = run(plant, random_inputs(plant, 50))
    assert observations.shape == (50, len(plant.output_names))
    assert np.isfinite(observations).all()
    assert 0 < np.abs(observations).max() < 1.0


def test_reset_returns_to_the_same_start_whatever_happened_before(plant):
    inputs = random_inputs(plant, 20)
    first = np.vstack([plant.reset(seed=3), run(plant, inputs)])
    run(plant, inputs[::-1])
    np.testing.assert_array_equal(np.vstack([plant.reset(seed=3), run(plant, inputs)]), first)


def test_a_saved_state_is_restored_exactly(plant):
    inputs = random_inputs(plant, 30)
    plant.reset(seed=0)
    last = run(plant, inputs[:10])[-1]
    saved = plant.state
    continued = run(plant, inputs[10:])
    run(plant, inputs)
    np.testing.assert_array_equal(plant.reset(seed=0, state=saved), last)
    np.testing.assert_array_equal(plant.state, saved)
    np.testing.assert_array_equal(run(plant, inputs[10:]), continued)


def test_inputs_out_of_bounds_act_as_the_nearest_bound(plant):
    low, high = plant.input_bounds
    for excess, bound in ((high + 5.0, high), (low - 5.0, low)):
        plant.reset(seed=0)
        clipped = plant.step(excess)
        plant.reset(seed=0)
        np.testing.assert_array_equal(clipped, plant.step(bound))


@pytest.mark.parametrize("spoil", [lambda u: u[:-1], lambda u: u[None], lambda u: u * np.nan,
                                   lambda u: u + np.inf],
                         ids=["too few", "two-dimensional", "NaN", "infinite"])
def test_a_bad_input_is_refused_and_the_state_unharmed(plant, spoil):
    plant.reset(seed=0)
    inputs = random_inputs(plant, 4)
    run(plant, inputs)
    before = plant.state
    with pytest.raises(ValueError, match="expected"):
        plant.step(spoil(inputs[0]))
    np.testing.assert_array_equal(plant.state, before)


@pytest.mark.parametrize("spoil", [lambda x: x[:-1], lambda x: x * np.nan], ids=["too short", "NaN"])
def test_a_bad_state_is_refused_and_the_state_unharmed(plant, spoil):
    plant.reset(seed=0)
    run(plant, random_inputs(plant, 4))
    before = plant.state
    with pytest.raises(ValueError, match="expected"):
        plant.reset(state=spoil(before + 1.0))
    np.testing.assert_array_equal(plant.state, before)


def test_the_arrays_of_the_caller_are_neither_changed_nor_kept(plant):
    plant.reset(seed=0)
    run(plant, random_inputs(plant, 4))
    state, u = plant.state, plant.input_bounds[1] + 1.0
    kept_state, kept_input, bounds = state.copy(), u.copy(), plant.input_bounds.copy()
    plant.reset(state=state)
    observation = plant.step(u)
    np.testing.assert_array_equal(state, kept_state)
    np.testing.assert_array_equal(u, kept_input)
    after, where = plant.state, plant.displacement
    for array in (state, u, observation, plant.state, plant.displacement):
        array[...] = 7.0
    np.testing.assert_array_equal(plant.state, after)
    np.testing.assert_array_equal(plant.displacement, where)
    np.testing.assert_array_equal(plant.input_bounds, bounds)
