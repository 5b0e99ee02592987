"""Two real processes that are stopped, killed and ended by signals, and a bad network between them."""

import heapq
import signal
import threading
import time

import numpy as np
import pytest
from wire.processes import TIMEOUT, Pair, Process, fresh, oldest, recoveries

zmq = pytest.importorskip("zmq", reason="the extra wire is not installed")
T = 0.05       # s, long enough for a machine with other work
SLACK = 0.04   # s, by which such a machine may be late
SAFE = [0.1, 0.0]

pytestmark = pytest.mark.slow


@pytest.fixture
def pair(tmp_path):
    with Pair(tmp_path, T) as pair:
        yield pair


def safe_since(pair, moment):
    """s from a moment to the first safe input after it; all later ones must be safe as well."""
    steps = pair.steps
    later = steps[steps[:, 0] > moment]
    first = int(np.argmax((later[:, 1:] == SAFE).all(axis=1)))
    assert (later[first:, 1:] == SAFE).all() and len(later) > first
    return later[first, 0] - moment


def test_after_pauses_of_either_process_the_run_goes_on_within_three_timesteps(pair):
    ends = pair.paused([0.005, 0.03, 0.26, 0.8, 0.1, 0.6, 0.3, 1.2], np.random.default_rng(1), 0.4)
    recovered = recoveries(pair.steps, np.array([end for end, _ in ends]), T)
    assert recovered.max() <= 3.0 + SLACK / T, recovered
    assert oldest(pair.steps) <= TIMEOUT + 3 * T + SLACK
    pair.robot.signal(signal.SIGTERM)
    status, told = pair.robot.result()
    assert status == 128 + signal.SIGTERM and told["resets"] == 1, "it was one run"


def test_a_killed_controller_leaves_the_safe_input_and_its_successor_gets_the_robot(pair, tmp_path):
    pair.controller.signal(signal.SIGKILL)
    killed = pair.now
    time.sleep(TIMEOUT + 6 * T)
    assert safe_since(pair, killed) <= TIMEOUT + 2 * T + SLACK
    with Process("controller", pair.address, T, 0.5, pair.base) as successor:
        assert successor.line() == pair.address
        status, told = successor.result()
        assert status == 0 and told["finished"] == 1
    status, told = pair.robot.result()
    assert status == 0 and told["resets"] == 2


def test_a_controller_that_is_ended_tells_the_robot_which_is_safe_at_once(pair):
    pair.controller.signal(signal.SIGTERM)
    moment = pair.now
    pair.controller.result()
    time.sleep(3 * T)
    assert safe_since(pair, moment) <= 2 * T + SLACK < TIMEOUT


def test_a_robot_that_is_ended_applies_its_safe_input_and_the_next_one_is_taken_at_once(pair, tmp_path):
    pair.robot.signal(signal.SIGTERM)
    status, told = pair.robot.result()
    assert status == 128 + signal.SIGTERM and told["resets"] == 1 and list(pair.steps[-1, 1:]) == SAFE
    with Process("robot", pair.address, T, tmp_path / "second.steps", pair.base) as second:
        pair.path = tmp_path / "second.steps"
        time.sleep(2.0)
        second.signal(signal.SIGTERM)
        assert "busy" not in second.result()[1]["counts"] and fresh(pair.steps, T).sum() > 5


def test_a_second_robot_waits_until_the_first_is_dead_and_a_second_controller_cannot_have_the_address(pair, tmp_path):
    with Process("controller", pair.address, T, 0.5, pair.base) as second:
        assert second.line() == "" and second.popen.wait(20) != 0
    with Process("robot", pair.address, T, tmp_path / "second.steps", pair.base) as second:
        time.sleep(2.0)
        first, pair.path = pair.path, tmp_path / "second.steps"
        assert (pair.steps[:, 1:] == SAFE).all() and len(pair.steps), "it is told that the controller is busy"
        pair.path = first
        assert fresh(pair.steps, T)[-10:].sum() >= 8, "the first goes on"
        pair.robot.signal(signal.SIGKILL)
        time.sleep(2.0)
        second.signal(signal.SIGTERM)
        assert second.result()[1]["counts"]["busy"] > 1
        pair.path = tmp_path / "second.steps"
        assert fresh(pair.steps, T).sum() > 5


class BadNetwork(threading.Thread):
    """Stands between a robot and a controller; loses, repeats and delays one message in ten each."""

    def __init__(self, address):
        super().__init__(daemon=True)
        self.context, self.over, self.rng = zmq.Context(), False, np.random.default_rng(0)
        self.front, self.back = self.context.socket(zmq.ROUTER), self.context.socket(zmq.DEALER)
        self.front.bind("tcp://127.0.0.1:*")
        self.back.connect(address)
        self.endpoint, self.carried = self.front.getsockopt_string(zmq.LAST_ENDPOINT), 0

    def run(self):
        poller, waiting, robot = zmq.Poller(), [], b""
        poller.register(self.front, zmq.POLLIN)
        poller.register(self.back, zmq.POLLIN)
        while not self.over:
            for socket, _ in poller.poll(1):
                parts = socket.recv_multipart()
                robot = parts[0] if socket is self.front else robot
                for _ in range(0 if self.rng.random() < 0.1 else 1 + (self.rng.random() < 0.1)):
                    self.carried += 1
                    delay = 3 * T if self.rng.random() < 0.1 else 0.0
                    heapq.heappush(waiting, (time.monotonic() + delay, self.carried, socket is self.front, parts[-1]))
            while waiting and waiting[0][0] <= time.monotonic():
                _, _, forth, data = heapq.heappop(waiting)
                (self.back.send(data) if forth else self.front.send_multipart([robot, data]))
        self.context.destroy(linger=0)


def test_over_a_bad_network_the_same_run_goes_on_and_no_input_is_old(tmp_path):
    base = time.monotonic() - 1.0
    with Process("controller", "tcp://127.0.0.1:*", T, 0.0, base) as controller:
        network = BadNetwork(controller.line())
        network.start()
        with Process("robot", network.endpoint, T, tmp_path / "robot.steps", base) as robot:
            pair = Pair.__new__(Pair)
            pair.path = tmp_path / "robot.steps"
            time.sleep(4.5)
            robot.signal(signal.SIGTERM)
            _, told = robot.result()
        controller.signal(signal.SIGTERM)
        _, heard = controller.result()
        network.over = True
        network.join(20.0)
    steps = pair.steps
    assert told["resets"] == 1 and told["counts"]["repeated"] > 2 and heard["counts"]["reordered"] > 2
    assert oldest(steps) <= TIMEOUT + 3 * T + SLACK and fresh(steps, T).sum() > 30
    assert (steps[:, 1:] >= SAFE).all() and (steps[:, 1:] <= 1.0).all()
