"""Plant and controller in lock-step through true sockets, against the two in one process."""

import numpy as np
import pytest

from ssmr_torch.closed_loop import simulate
from ssmr_torch.evaluation.metrics import closed_loop_metrics
from ssmr_torch.plants.base import Plant
from ssmr_torch.plants.remote import RemotePlant
from ssmr_torch.plants.rig import Rig
from ssmr_torch.wire.controller_end import ControllerEnd
from ssmr_torch.wire.link import RobotLink
from ssmr_torch.wire.record import record_of
from ssmr_torch.wire.robot_end import RobotEnd
from ssmr_torch.wire.serving import serve

SAME = ("time", "reference", "observation", "measurement", "input", "fallback", "iterations")


def assert_same(record, expected):
    """Up to rounding, which depends on where in memory an array lies."""
    for name in SAME:
        np.testing.assert_allclose(getattr(record, name), getattr(expected, name), rtol=1e-6, atol=1e-9, err_msg=name)
    assert record.statuses == expected.statuses
    assert closed_loop_metrics(record)["ise"] == pytest.approx(closed_loop_metrics(expected)["ise"], rel=1e-9)


def served(link, robot_link, plant, build, task, background):
    end = ControllerEnd(build, duration=task.duration, seed=3)
    records = []
    robot = RobotEnd(plant, robot_link)
    other = background(robot.drive, 1, wait=20.0)
    serve(link, end, runs=1, done=lambda end: records.append(record_of(end, task)))
    other.join()
    return records[0], end, robot


def test_a_controller_process_gives_the_record_of_one_process_up_to_rounding(links, plant, build, task, background):
    record, end, robot = served(*links, plant, build, task, background)
    assert_same(record, simulate(plant, build(plant), task))
    assert not end.counts and not robot.counts and record.provenance["wire"] == {}


def test_missing_samples_of_a_rig_count_as_in_one_process(links, plant, build, task, background):
    rig = Rig(plant, noise_std=3e-5, drop_probability=0.1, dropped="missing")
    record, end, _ = served(*links, rig, build, task, background)
    expected = simulate(rig, build(plant), task, seed=3)
    for name in ("measurement", "input", "fallback"):
        np.testing.assert_allclose(getattr(record, name), getattr(expected, name), rtol=1e-6, atol=1e-9, err_msg=name)
    assert end.counts == {"not_finite": np.isnan(record.measurement).any(axis=1).sum()}
    assert np.isfinite(record.observation).all() and record.fallback.any()


def remote(plant, background, runs=1, **settings):
    """A plant elsewhere, and the robot process."""
    ready = {}

    def drive(endpoint):
        with RobotLink(endpoint) as link:
            RobotEnd(plant, link).drive(runs, wait=20.0)

    class Announcing(RemotePlant):
        def _meet(self):
            ready["robot"] = background(drive, self._link.endpoint)
            return super()._meet()

    return Announcing("tcp://127.0.0.1:*", wait=20.0, **settings), ready["robot"]


def test_a_remote_plant_gives_the_record_of_one_process_up_to_rounding(plant, build, task, background):
    elsewhere, robot = remote(plant, background)
    assert isinstance(elsewhere, Plant)
    np.testing.assert_array_equal(elsewhere.displacement, np.zeros(6))
    records = [simulate(elsewhere, build(elsewhere), task, noise_std=3e-5, seed=seed) for seed in (0, 1)]
    elsewhere.close()
    robot.join()
    for seed, record in enumerate(records):
        assert_same(record, simulate(plant, build(plant), task, noise_std=3e-5, seed=seed))
        assert record.provenance["plant"] == "tables"
    assert not elsewhere.counts


def test_a_remote_plant_keeps_the_promises_of_plants(integrator, background):
    elsewhere, robot = remote(integrator, background)
    np.testing.assert_array_equal(elsewhere.step([5.0, -5.0]), [1e-3, 0.0])
    for spoiled in ([1.0], [np.nan, 1.0]):
        with pytest.raises(ValueError, match="expected"):
            elsewhere.step(spoiled)
    np.testing.assert_allclose(elsewhere.step([1.0, 1.0]), [2e-3, 1e-3])
    np.testing.assert_array_equal(elsewhere.displacement, integrator.displacement)
    with pytest.raises(ValueError, match="cannot be put into a state"):
        elsewhere.reset(state=np.zeros(2))
    np.testing.assert_array_equal(elsewhere.reset(seed=7), [0.0, 0.0])
    assert integrator.resets[-1] == 7 and elsewhere.state.shape == (0,)
    elsewhere.close()
    robot.join()


def test_a_remote_plant_that_never_comes_or_leaves_ends_in_a_message(integrator, background):
    with pytest.raises(TimeoutError, match="no robot came"):
        RemotePlant("tcp://127.0.0.1:*", wait=0.05)
    with pytest.raises(OSError, match="cannot wait at"):
        RemotePlant("nonsense")
    elsewhere, robot = remote(integrator, background, patience=0.3)
    elsewhere.reset()
    integrator.step = None  # the robot's process ends in an error, and says goodbye
    with pytest.raises(ConnectionError, match="the robot stops|silent"):
        for _ in range(3):
            elsewhere.step([0.5, 0.5])
    with pytest.raises(TypeError):
        robot.join()
