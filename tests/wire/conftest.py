"""A robot and a controller for both ends of the wire, and stand-ins for what lies between."""

import threading
from collections import deque
from dataclasses import replace

import numpy as np
import pytest
from wire.in_words import Echo, Talk

from ssmr_torch.control.mpc import ModelPredictiveController
from ssmr_torch.wire.controller_end import ControllerEnd
from ssmr_torch.wire.link import ControllerLink, RobotLink
from ssmr_torch.wire.messages import Kind, Message, RobotDescription, unpack
from ssmr_torch.wire.robot_end import RobotEnd


@pytest.fixture
def task(trial):
    return trial.figure_eight(laps=1.0)


@pytest.fixture
def plant(trial):
    return trial.ModelPlant(trial.perturbed(trial.oscillators(), 0.03))


@pytest.fixture
def build(trial, task):
    """RobotDescription or plant → the controller of the benchmark."""
    return lambda robot: ModelPredictiveController(trial.oscillators(), task, robot.input_bounds,
                                                  timestep=robot.timestep, output_names=robot.output_names)


class FakeClock:
    """A clock that only moves when somebody waits."""

    def __init__(self):
        self.now = 100.0

    def __call__(self):
        return self.now


class FakeLink:
    """A robot's link whose other end is a function: Message → bytes or Messages to hear, each after a delay in s."""

    def __init__(self, clock, answer):
        self.clock, self.answer, self.sent, self.coming = clock, answer, [], deque()

    def send(self, message):
        message = unpack(message.pack())
        self.sent.append(message)
        for delay, reply in self.answer(message):
            self.coming.append((self.clock.now + delay, reply if isinstance(reply, bytes) else reply.pack()))
        self.coming = deque(sorted(self.coming, key=lambda entry: entry[0]))
        return True

    def receive(self, timeout):
        until = self.clock.now + timeout
        if self.coming and self.coming[0][0] <= until:
            when, data = self.coming.popleft()
            self.clock.now = max(self.clock.now, when)
            return data
        self.clock.now = until
        return None

    def of_kind(self, kind):
        return [message for message in self.sent if message.kind is kind]


@pytest.fixture
def fake_robot():
    """(answer, plant, **settings) → (RobotEnd, its FakeLink)"""

    def make(answer, plant, **settings):
        clock = FakeClock()
        link = FakeLink(clock, answer)
        return RobotEnd(plant, link, clock=clock, **settings), link

    return make


class Integrator:
    """Two outputs that follow two inputs, and remember them."""

    name, timestep, input_unit = "integrator", 0.01, "N"
    input_bounds, rest = np.array([[0.1, 0.0], [1.0, 1.0]]), np.zeros(2)
    output_names, input_names = ("x", "y"), ("u", "v")

    def __init__(self):
        self.applied, self.resets = [], []
        self.reset()

    @property
    def displacement(self):
        return self.state.copy()

    def reset(self, seed=None, state=None):
        self.resets.append(seed)
        self.state = np.zeros(2) if state is None else np.array(state, dtype=float)
        return self.displacement

    def step(self, input):
        self.applied.append(np.array(input))
        self.state = self.state + 1e-3 * np.array(input)
        return self.displacement


@pytest.fixture
def integrator():
    return Integrator()


@pytest.fixture
def links():
    """Both ends of a true connection on a port that the system chose."""
    with ControllerLink("tcp://127.0.0.1:*") as controller, RobotLink(controller.endpoint) as robot:
        yield controller, robot


class Background:
    """A function in a thread, whose error is raised again by `join`."""

    def __init__(self, function, *arguments, **more):
        self.error = None

        def run():
            try:
                function(*arguments, **more)
            except Exception as error:
                self.error = error

        self.thread = threading.Thread(target=run, daemon=True)
        self.thread.start()

    def join(self, timeout=20.0):
        self.thread.join(timeout)
        assert not self.thread.is_alive(), "the other end still runs"
        if self.error is not None:
            raise self.error


@pytest.fixture
def background():
    return Background


@pytest.fixture
def hello(integrator):
    """The bytes of the integrator's HELLO, with changes: hello(real_time=True, timestep=0.02)."""
    return lambda **changes: Message(Kind.HELLO, text=replace(RobotDescription.of(integrator), **changes).text).pack()


@pytest.fixture
def echo():
    return Echo()


@pytest.fixture
def end(echo):
    return ControllerEnd(lambda robot: echo, timeout=0.1, patience=10.0)


@pytest.fixture
def paced(end, hello):
    """A robot in real time that has sent measurement 0 at 0 s; the next is due at 0.01 s and missed from 0.015 s on."""
    talk = Talk(end, hello(real_time=True))
    talk.measure(0, at=0.0)
    return talk
