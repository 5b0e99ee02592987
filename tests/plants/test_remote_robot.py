"""A driver with a robot elsewhere: other robots, strangers and garbage do not end its run."""

import logging
import threading
import time

import numpy as np
import pytest

pytest.importorskip("zmq", reason="the extra wire is not installed")
from ssmr_torch.plants.remote_robot import RemotePlant  # noqa: E402
from ssmr_torch.wire.link import RobotLink  # noqa: E402
from ssmr_torch.wire.messages import Code, Kind, Message, RobotDescription, unpack  # noqa: E402


class Described:
    """What a HELLO says."""

    name, timestep, input_unit = "two", 0.01, "N"
    input_bounds, rest = np.array([[0.0, 0.0], [1.0, 1.0]]), np.zeros(2)
    output_names, input_names = ("x", "y"), ("u", "v")


HELLO = RobotDescription.of(Described())


class Hand:
    """A robot in words, in lock-step."""

    def __init__(self, link, request=0):
        self.link, self.request, self.run, self.k = link, request, None, 0

    def hello(self, text=HELLO.text):
        self.link.send(Message(Kind.HELLO, sequence=self.request, text=text))

    def heard(self, timeout=5.0):
        data = self.link.receive(timeout)
        return None if data is None else unpack(data)

    def measure(self, number, values=(1.0, 2.0), run=None):
        message = Message(Kind.MEASUREMENT, self.run if run is None else run, number, 5 + 0.01 * number,
                          values=np.array(values))
        while not self.link.send(message):  # its few places for unsent messages are taken on a busy computer
            time.sleep(1e-3)


@pytest.fixture
def both():
    """A plant in its first run, its robot, and the link of a stranger."""
    links, refusals = [], []

    def arrive():
        Hand(links[1]).hello("{}")
        refusals.append(Hand(links[1]).heard(10.0))
        for _ in range(3):
            Hand(links[0], request=9).hello()

    class Meeting(RemotePlant):
        def _meet(self):
            links.extend(RobotLink(self._link.endpoint) for _ in range(2))
            threading.Thread(target=arrive, daemon=True).start()
            return super()._meet()

    plant = Meeting("tcp://127.0.0.1:*", wait=10.0, patience=5.0)
    robot, stranger = Hand(links[0], request=9), Hand(links[1])
    assert refusals[0].kind is Kind.REFUSE and "the keys" in refusals[0].text, "it waits on for one that can be read"
    yield plant, robot, stranger
    plant.close()
    for link in links:
        link.close()


def begun(plant, robot):
    """The first observation; the robot sends it as soon as it hears START."""
    def answer():
        robot.run = robot.heard().run
        robot.measure(0)

    thread = threading.Thread(target=answer)
    thread.start()
    observation = plant.reset()
    thread.join()
    return observation


def test_a_second_robot_is_told_to_wait_and_the_first_one_goes_on(both, caplog):
    plant, robot, stranger = both
    np.testing.assert_array_equal(begun(plant, robot), [1.0, 2.0])
    stranger.hello()
    stranger.link.send(Message(Kind.END, robot.run))
    stranger.measure(1, (9.0, 9.0), run=robot.run)
    time.sleep(0.2)
    robot.hello()  # the copy of the HELLO that began this run, which arrives late
    for k in range(1, 7):
        robot.measure(k, (3.0, float(k)))
        np.testing.assert_array_equal(plant.step([0.5, 0.5]), [3.0, k])
    refusal = stranger.heard()
    assert refusal.kind is Kind.REFUSE and refusal.status == Code.BUSY and "busy with the robot 'two'" in refusal.text
    assert plant.counts["foreign"] == 3 and plant.counts["repeated"] >= 1


def test_a_robot_that_says_hello_anew_during_its_run_ends_the_driver_with_a_message(both):
    plant, robot, _ = both
    begun(plant, robot)
    robot.request = 2**40
    robot.hello()
    with pytest.raises(ConnectionError, match="restarted during a run"):
        plant.step([0.5, 0.5])


def test_garbage_leaves_a_short_log_and_does_not_hold_the_driver_up(both, caplog):
    plant, robot, stranger = both
    begun(plant, robot)
    with caplog.at_level(logging.INFO):
        for _ in range(500):
            stranger.link._socket.send(b"garbage")
        time.sleep(0.2)
        for k in range(1, 150):
            robot.measure(k, (3.0, float(k)))
            np.testing.assert_array_equal(plant.step([0.5, 0.5]), [3.0, k])
    assert plant.counts["malformed"] > 100 and len(caplog.records) < 8


@pytest.mark.parametrize("settings", [{"timeout": float("nan")}, {"wait": -1.0}, {"patience": 0}, {"deadline": -1.0}])
def test_settings_out_of_range_are_refused_before_anything_is_opened(settings):
    with pytest.raises(ValueError, match=f"{next(iter(settings))} is .*; expected"):
        RemotePlant("tcp://127.0.0.1:*", **settings)
