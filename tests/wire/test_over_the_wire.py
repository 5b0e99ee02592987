"""Plant and controller in lock-step through true sockets, against the two in one process."""

import json
from pathlib import Path

import numpy as np
import pytest

from ssmr_torch.closed_loop.simulation import simulate
from ssmr_torch.closed_loop.wire_record import record_of
from ssmr_torch.control.base import Command
from ssmr_torch.evaluation.metrics import closed_loop_metrics
from ssmr_torch.plants.base import Plant
from ssmr_torch.plants.emulated_rig import Rig
from ssmr_torch.plants.remote_robot import RemotePlant
from ssmr_torch.wire.controller_end import ControllerEnd
from ssmr_torch.wire.link import ControllerLink, RobotLink
from ssmr_torch.wire.messages import Kind, Message, RobotDescription, unpack
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
        assert record.provenance["plant"] == "model"
    assert not elsewhere.counts


def test_a_remote_plant_behaves_like_any_plant(integrator, background):
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
    with pytest.raises(TimeoutError, match="no robot connected"):
        RemotePlant("tcp://127.0.0.1:*", wait=0.05)
    with pytest.raises(ValueError, match="bind is 'nonsense'; expected an address"):
        RemotePlant("nonsense")
    elsewhere, robot = remote(integrator, background, patience=0.3)
    elsewhere.reset()
    integrator.step = None  # the robot's process ends in an error, and says goodbye
    with pytest.raises(ConnectionError, match="the robot stops|silent"):
        for _ in range(3):
            elsewhere.step([0.5, 0.5])
    with pytest.raises(TypeError):
        robot.join()


def blind_once(link, plant):
    """A robot in real time that keeps measurement 1 back until the command for it has come."""
    link.send(Message(Kind.HELLO, text=RobotDescription.of(plant, real_time=True).text))
    run = None

    def send(*numbers):
        for number in numbers:
            link.send(Message(Kind.MEASUREMENT, run, number, 5.0 + plant.timestep * number, values=np.full(2, number)))

    while (data := link.receive(20.0)) is not None:
        message = unpack(data)
        if message.kind is Kind.START:
            run = message.run
            send(0)
        elif message.kind is Kind.END:
            return
        elif message.sequence == 1:
            send(1, 2, 2, 4)


def test_a_remote_plant_in_real_time_gives_nan_where_measurements_are_missing(integrator, background):
    integrator.timestep = 1.0  # as time for this machine to find its way between the two ends

    class Waiting(RemotePlant):
        def _meet(self):
            self.link = RobotLink(self._link.endpoint)
            self.robot = background(blind_once, self.link, integrator)
            return super()._meet()

    elsewhere = Waiting("tcp://127.0.0.1:*", wait=20.0, deadline=0.0, timeout=20.0)
    np.testing.assert_array_equal(elsewhere.reset(), [0, 0])
    assert np.isnan(elsewhere.step([0.5, 0.5])).all()                       # 1 does not come in time
    np.testing.assert_array_equal(elsewhere.displacement, [0, 0])
    np.testing.assert_array_equal(elsewhere.step([0.5, 0.5]), [2, 2])       # it comes late, and then 2
    assert np.isnan(elsewhere.step([0.5, 0.5])).all()                       # after 2 again comes 4
    np.testing.assert_array_equal(elsewhere.step([0.5, 0.5]), [4, 4])
    assert elsewhere.counts == {"missing": 2, "late": 1, "repeated": 1}
    elsewhere.close()
    elsewhere.robot.join()
    elsewhere.link.close()


def test_a_restarted_controller_finds_the_robot_and_begins_a_new_run(build, plant, task, background):
    """The first controller vanishes without a word after three answers; the second has the same address.

    The robot learns it by its own patience, or from the second controller, which does not know its run.
    """
    first = ControllerLink("tcp://127.0.0.1:*")
    endpoint, answered, robots = first.endpoint, 0, {}

    def drive():
        with RobotLink(endpoint) as link:
            robots["end"] = RobotEnd(plant, link, patience=1.0)
            robots["end"].drive(1, wait=20.0)

    other = background(drive)
    end = ControllerEnd(build)
    while answered < 3:
        peer, data = first.receive(20.0)
        for reply in end.receive(peer, data, 0.0):
            first.send(*reply)
            answered += reply.message.kind is Kind.COMMAND
    first.close()
    with ControllerLink(endpoint) as second:
        end = ControllerEnd(build, duration=task.duration)
        serve(second, end, runs=1)
    other.join()
    assert robots["end"].counts["lost_controllers"] <= 1 and end.finished == 1
    assert len(end.samples) == np.ceil(task.duration / plant.timestep) + 1


class Constant:
    """A controller of one answer."""

    period = 0.01

    def reset(self):
        pass

    def __call__(self, time, observation):
        return Command(np.array([0.4, 0.6]))


def test_in_real_time_a_whole_task_runs_over_the_wire_under_other_load(links, integrator, background):
    end = ControllerEnd(lambda robot: Constant(), duration=0.3, timeout=20.0)
    robot = RobotEnd(integrator, links[1], real_time=True, timeout=20.0)
    other = background(robot.drive, 1, wait=20.0)
    serve(links[0], end, runs=1)
    other.join()
    np.testing.assert_allclose([sample.time for sample in end.samples], 0.01 * np.arange(31))
    assert end.finished == 1
    assert set(end.counts) <= {"missing", "late", "reordered", "irregular", "foreign"}
    assert end.counts["late"] <= end.counts["missing"]


def test_the_client_in_the_documentation_is_a_robot(integrator, background):
    text = (Path(__file__).parents[2] / "docs" / "wire.md").read_text()
    code = text.split("```python\n")[1].split("```")[0]
    assert "tcp://127.0.0.1:5555" in code and "poll(1000)" in code
    end, applied = ControllerEnd(lambda robot: Constant(), duration=0.05), []

    def apply(u):
        applied.append(u)
        integrator.step(u)

    with ControllerLink("tcp://127.0.0.1:*") as link:
        code = code.replace("tcp://127.0.0.1:5555", link.endpoint).replace("poll(1000)", "poll(20000)")
        names = {"DESCRIPTION": json.loads(RobotDescription.of(integrator).text), "TIMESTEP": 0.01,
                 "SAFE_INPUT": (0.1, 0.0), "measure": lambda: integrator.displacement, "apply": apply}
        other = background(exec, code, names)
        serve(link, end, runs=1)
        other.join()
    names["socket"].close(0)
    assert len(end.samples) == 6 and not end.counts
    np.testing.assert_allclose(applied, [[0.4, 0.6]] * 5 + [(0.1, 0.0)])
    np.testing.assert_allclose(end.samples[-1].observation, [2e-3, 3e-3])
