"""The paper's robots replay the authors' recordings, given the authors' meshes."""

from functools import cache

import numpy as np
import pytest
from scipy.io import loadmat

from ssmr_torch.plants.diamond import Diamond
from ssmr_torch.plants.trunk import Trunk

AUTHORS = {Trunk: "trunk.vtk", Diamond: "diamond.vtu"}
MM, MN = 1e-3, 1e-3  # m, N


@cache
def made(kind, mesh):
    return kind(mesh=mesh)


@pytest.fixture
def published(measurements):
    """(Trunk or Diamond) -> the robot on the authors' mesh, at rest."""

    def at_rest(kind):
        robot = made(kind, str(measurements("meshes") / AUTHORS[kind]))
        robot.reset()
        return robot

    return at_rest


def replay_error(robot, recording, settling, samples):
    """Largest distance along an axis between the tip and the recorded one, mm; y[k] is before u[k] acts."""
    robot.reset(state=robot.undeformed)
    for u in np.zeros((settling, len(robot.input_names))):
        robot.step(u)
    recorded = loadmat(recording)
    observed = []
    for u in recorded["u"][:samples]:
        observed.append((robot.rest + robot.displacement)[:3] / MM)
        robot.step(MN * u)
    assert robot.clipped == 0
    assert np.ptp(recorded["y"][:samples], axis=0).min() > 10
    return np.abs(observed - recorded["y"][:samples]).max()


@pytest.mark.parametrize(("kind", "recording", "settling", "samples"), [
    (Trunk, "trunk_simulated/static.mat", 95, 400),
    (Trunk, "trunk_simulated/controlled.mat", 45, 400),
    (Diamond, "diamond_simulated/static.mat", 95, 100),
    (Diamond, "diamond_simulated/controlled.mat", 95, 100),
    pytest.param(Trunk, "trunk_simulated/static.mat", 95, 3000, marks=pytest.mark.slow),
    pytest.param(Trunk, "trunk_simulated/controlled.mat", 45, 1106, marks=pytest.mark.slow),
    pytest.param(Diamond, "diamond_simulated/static.mat", 95, 3000, marks=pytest.mark.slow),
    pytest.param(Diamond, "diamond_simulated/controlled.mat", 95, 3686, marks=pytest.mark.slow),
])
def test_the_robot_replays_the_authors_simulation(measurements, published, kind, recording, settling, samples):
    """From the undeformed mesh and steps without tension, to what the authors' iterative solver left."""
    error = replay_error(published(kind), measurements(recording), settling, samples)
    assert error < {Trunk: 1e-7, Diamond: 1e-5}[kind]


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "recording", "seam", "forgotten"), [
    (Trunk, "trunk_simulated/controlled.mat", 1106, 900), (Diamond, "diamond_simulated/controlled.mat", 3686, 400)])
def test_after_a_seam_the_robot_forgets_where_it_started_at_its_own_rate(measurements, published, kind, recording, seam,
                                                                          forgotten):
    """The second run begins in an unknown state; from rest, the slowest mode decays by exp(−1.5 t) or exp(−5.2 t)."""
    robot, recorded = published(kind), loadmat(measurements(recording))
    rows = slice(seam, seam + forgotten + 400)
    errors = []
    for u, y in zip(recorded["u"][rows], recorded["y"][rows]):
        errors.append(np.abs((robot.rest + robot.displacement)[:3] / MM - y).max())
        robot.step(MN * u)
    assert errors[0] > 0.05
    assert max(errors[forgotten:]) < {Trunk: 1e-7, Diamond: 1e-5}[kind]


@pytest.mark.parametrize(("kind", "node"), [(Trunk, 51), (Diamond, 1354)])
def test_the_default_marker_finds_the_authors_tip_node(published, kind, node):
    assert published(kind).markers["tip"] == node


@pytest.mark.parametrize(("kind", "tip"), [(Trunk, (3.5888, 0.2934, 195.6144)), (Diamond, (-7.0769, 1.2132, 97.0405))])
def test_the_tip_rests_where_it_was_published(published, kind, tip):
    np.testing.assert_allclose(published(kind).rest[:3] / MM, tip, atol=1e-3)
