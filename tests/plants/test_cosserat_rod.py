"""The rod by PyElastica against the theory of beams."""

import numpy as np
import pytest

pytest.importorskip("elastica", reason="the extra robots is not installed")

from ssmr_torch.plants.cosserat_rod import CosseratRod  # noqa: E402

LENGTH, RADIUS, YOUNG, DENSITY = 0.2, 0.01, 3e5, 1070.0
AREA, SECOND_MOMENT = np.pi * RADIUS ** 2, np.pi * RADIUS ** 4 / 4
CANTILEVER = 1.87510407  # ω = (1.8751 / L)² √(EI / ρA)


def bent(elements, force):
    """Where the tip of a weightless rod rests under a force, m."""
    rod = CosseratRod(elements=elements, gravity=0.0, drag=3.0, turning_drag=0.02)
    for _ in range(400):
        displacement = rod.step(np.array([force, 0.0]))
    return displacement[0]


def beam(elements, force):
    """Timoshenko's tip, m. The frame of the first element is clamped, at its middle: that is where bending begins."""
    free, shear = LENGTH * (1 - 0.5 / elements), 27 / 28 * YOUNG / 3 * AREA  # PyElastica's factor of a circle
    return force * free ** 3 / (3 * YOUNG * SECOND_MOMENT) + force * LENGTH / shear


def test_a_small_force_bends_it_as_timoshenko_says_with_second_order_in_the_elements():
    force = 1e-4
    errors = np.array([bent(elements, force) / beam(elements, force) - 1 for elements in (6, 12, 24)])
    assert abs(errors[-1]) < 2e-3
    np.testing.assert_allclose(errors[:-1] / errors[1:], 4.0, rtol=0.2)


def test_its_slowest_frequency_is_the_cantilevers():
    rates = CosseratRod(gravity=0.0, drag=0.1, turning_drag=1e-6).eigenvalues
    free = LENGTH * (1 - 0.5 / 20)
    exact = (CANTILEVER / free) ** 2 * np.sqrt(YOUNG * SECOND_MOMENT / (DENSITY * AREA))
    assert np.abs(rates.imag)[np.abs(rates.imag) > 1.0].min() == pytest.approx(exact, rel=0.01)


def test_the_rod_stays_at_rest_where_each_element_carries_the_weight_below_it():
    rod = CosseratRod()
    for _ in range(20):
        drift = rod.step(np.zeros(2))
    np.testing.assert_allclose(drift, 0.0, atol=1e-13)
    stretched = DENSITY * 9.81 * LENGTH ** 2 / (2 * YOUNG)
    assert -rod.rest[2] - LENGTH == pytest.approx(stretched, rel=0.02)


def test_signed_forces_mirror_each_other():
    rod = CosseratRod()
    for _ in range(30):
        right = rod.step(np.array([0.1, 0.0]))
    rod.reset()
    for _ in range(30):
        left = rod.step(np.array([-0.1, 0.0]))
    np.testing.assert_allclose(left, right * [-1, 1, 1, -1, 1, 1], atol=1e-9)
    assert right[0] > 0


@pytest.mark.parametrize("settings, message", [({"elements": 7}, "elements is 7"), ({"young": 0.0}, "young is 0.0 Pa"),
                                               ({"substep": 3e-4}, "whole multiple")])
def test_impossible_settings_of_a_rod_are_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        CosseratRod(**settings)


def test_a_payload_is_carried_by_the_whole_rod():
    loaded, payload = CosseratRod(payload=0.01), 0.01
    for _ in range(20):
        drift = loaded.step(np.zeros(2))
    np.testing.assert_allclose(drift, 0.0, atol=1e-13)
    longer = CosseratRod().rest[2] - loaded.rest[2]
    assert longer == pytest.approx(payload * 9.81 * LENGTH / (YOUNG * AREA), rel=0.02)
    with pytest.raises(ValueError, match="payload is -1"):
        CosseratRod(payload=-1)
