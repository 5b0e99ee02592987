"""The chain by MuJoCo against the linear theory of a chain, written out here."""

import numpy as np
import pytest
from scipy.linalg import eigh

pytest.importorskip("mujoco", reason="the extra robots is not installed")

from ssmr_torch.plants.tendon_chain import TendonChain  # noqa: E402

LINKS, LENGTH, MASS, RADIUS, STIFFNESS, GRAVITY = 12, 0.192, 0.03, 0.012, 0.095, 9.81


def linear_theory(gravity=GRAVITY):
    """Mass and stiffness (links, links) of small bending in a plane, by joint angles."""
    link, disc = LENGTH / LINKS, MASS / LINKS
    turned = np.tril(np.ones((LINKS, LINKS)))     # link k by joint j
    moved = link * (turned - 0.5 * np.eye(LINKS))  # the middle of link k by the angle of link j
    inertia = disc * (3 * RADIUS ** 2 + (link / 2) ** 2) / 12
    mass = turned.T @ (disc * moved.T @ moved + inertia * np.eye(LINKS)) @ turned
    hanging = np.diag(gravity * disc * moved.sum(axis=0))
    return mass, turned.T @ hanging @ turned + STIFFNESS * np.eye(LINKS)


def decay(chain, steps=300):
    chain.reset(state=np.concatenate([np.full(2 * LINKS, 0.08), np.zeros(2 * LINKS)]))
    energies = [chain.energy()]
    for _ in range(steps):
        chain.step(np.zeros(4))
        energies.append(chain.energy())
    return np.array(energies)


def test_its_frequencies_without_damping_are_those_of_the_linear_theory():
    exact = np.sqrt(eigh(linear_theory()[1], linear_theory()[0], eigvals_only=True))[:3]
    rates = TendonChain(damping=0.0, substep=1e-4).eigenvalues
    found = np.sort(rates.imag[rates.imag > 0])
    np.testing.assert_allclose(found[::2][:3], exact, rtol=1e-3)
    np.testing.assert_allclose(found[::2][:3], found[1::2][:3], rtol=1e-3)  # both planes alike


def test_a_small_pull_bends_it_as_the_linear_theory_says():
    chain, pull = TendonChain(), 1e-3
    for _ in range(400):
        displacement = chain.step(np.array([pull, 0.0, 0.0, 0.0]))
    angles = np.linalg.solve(linear_theory()[1], np.full(LINKS, pull * RADIUS))
    tip = LENGTH / LINKS * np.cumsum(angles).sum()
    assert displacement[0] == pytest.approx(tip, rel=2e-3)


def test_released_it_only_loses_energy():
    chain = TendonChain()
    energies = decay(chain)
    chain.reset()
    least = chain.energy()
    assert (np.diff(energies) < 1e-12).all()
    assert energies[-1] - least < 1e-3 * (energies[0] - least)


def test_without_damping_its_energy_stays_within_the_integrators_error():
    drifts = []
    for substep in (1e-3, 5e-4):
        chain = TendonChain(damping=0.0, substep=substep)
        energies = decay(chain, 50)
        chain.reset()
        drifts.append(np.abs(energies - energies[0]).max() / (energies[0] - chain.energy()))
    assert drifts[1] < 0.6 * drifts[0]
    assert drifts[1] < 0.06


def test_opposite_tendons_mirror_each_other():
    chain = TendonChain()
    for _ in range(50):
        right = chain.step(np.array([0.5, 0.0, 0.0, 0.0]))
    chain.reset()
    for _ in range(50):
        left = chain.step(np.array([0.0, 0.5, 0.0, 0.0]))
    np.testing.assert_allclose(left, right * [-1, 1, 1, -1, 1, 1], atol=1e-12)
    assert right[0] > 0


@pytest.mark.parametrize("settings, message", [({"links": 11}, "links is 11"), ({"mass": 0.0}, "mass is 0.0 kg"),
                                               ({"substep": 3e-3}, "whole multiple")])
def test_impossible_settings_of_a_chain_are_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        TendonChain(**settings)


def test_a_payload_stiffens_the_hanging_chain_as_the_linear_theory_says():
    chain, pull, payload = TendonChain(payload=0.006), 1e-3, 0.006
    for _ in range(600):
        displacement = chain.step(np.array([pull, 0.0, 0.0, 0.0]))
    link, turned = LENGTH / LINKS, np.tril(np.ones((LINKS, LINKS)))
    stiffness = linear_theory()[1] + turned.T @ (GRAVITY * payload * link * np.eye(LINKS)) @ turned
    angles = np.linalg.solve(stiffness, np.full(LINKS, pull * RADIUS))
    assert displacement[0] == pytest.approx(link * np.cumsum(angles).sum(), rel=2e-3)
    with pytest.raises(ValueError, match="payload is -1"):
        TendonChain(payload=-1)
