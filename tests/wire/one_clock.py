"""Both ends on one clock of their own: pauses, and a network that loses, repeats and reorders, take no time."""

from __future__ import annotations

import heapq
from dataclasses import dataclass, field

import numpy as np

from ssmr_torch.control.base import Command
from ssmr_torch.status import Status
from ssmr_torch.wire.controller_end import ControllerEnd
from ssmr_torch.wire.messages import Kind, RobotDescription, unpack
from ssmr_torch.wire.robot_end import RobotEnd
from ssmr_torch.wire.serving import answer

T = 0.01
SAFE = (0.1, 0.0)
SPAN = 1e4  # s, that an input tells


class Told:
    """The second output is the time; the second input tells from which measurement it comes."""

    name, timestep, input_unit = "told", T, "N"
    input_bounds, rest = np.array([[0.1, 0.0], [1.0, 1.0]]), np.zeros(2)
    output_names, input_names = ("x", "time"), ("u", "from")

    def __init__(self, world):
        self.world, self.steps, self.resets = world, [], 0

    def reset(self, seed=None, state=None):
        self.resets += 1
        return self._seen()

    def step(self, input):
        u = tuple(float(part) for part in input)
        self.steps.append((self.world.now, u))
        return self._seen()

    def _seen(self):
        return np.array([0.0, self.world.now])


class Telling:
    """A controller whose input says from which measurement it comes, 0.3 in the first one where it was blind."""

    period = T

    def __init__(self):
        self.reset()

    def reset(self):
        self.last = 0.0

    def __call__(self, time, observation):
        if np.isnan(observation).any():
            return Command(np.array([0.3, self.last]), fallback=Status.NOT_FINITE)
        self.last = observation[1] / SPAN
        return Command(np.array([0.6, self.last]))


@dataclass
class World:
    """pauses: (start, end) s of each end.   delay: s on the way.   loss, twice, reordered: probabilities."""

    end: ControllerEnd
    robot_pauses: list = field(default_factory=list)
    controller_pauses: list = field(default_factory=list)
    delay: float = 3e-4
    loss: float = 0.0
    twice: float = 0.0
    reordered: float = 0.0
    seed: int = 0

    def __post_init__(self):
        self.now, self.sent = 0.0, 0
        self.to_robot, self.to_controller = [], []
        self.rng = np.random.default_rng(self.seed)
        self.robot_pauses, self.controller_pauses = sorted(self.robot_pauses), sorted(self.controller_pauses)

    def clock(self):
        return self.now

    def carry(self, heap, data):
        for _ in range(0 if self.rng.random() < self.loss else 1 + (self.rng.random() < self.twice)):
            self.sent += 1
            delay = self.delay * (1 + self.rng.random()) + (3 * T if self.rng.random() < self.reordered else 0.0)
            heapq.heappush(heap, (self.now + delay, self.sent, data))

    def next_event(self):
        """When the controller does something next, s."""
        while self.controller_pauses and self.controller_pauses[0][1] <= self.now:
            self.controller_pauses.pop(0)
        when = max(self.now, min(self.end.due(), self.to_controller[0][0] if self.to_controller else np.inf))
        return next((end for start, end in self.controller_pauses if start <= when < end), when)

    def advance(self, until):
        """Let time pass for the controller."""
        while (when := self.next_event()) <= until:
            self.now = when
            answer(ControllersLink(self), self.end, self.clock)
        self.now = max(self.now, until)


class ControllersLink:
    def __init__(self, world):
        self.world = world

    def receive(self, timeout):
        heap = self.world.to_controller
        return (b"robot", heapq.heappop(heap)[2]) if heap and heap[0][0] <= self.world.now else None

    def send(self, peer, message):
        self.world.carry(self.world.to_robot, message.pack())


class RobotsLink:
    def __init__(self, world):
        self.world, self.hellos = world, 0

    def send(self, message):
        self.hellos += unpack(message.pack()).kind is Kind.HELLO
        self.world.carry(self.world.to_controller, message.pack())
        return True

    def receive(self, timeout):
        world = self.world
        until = world.now + timeout
        while True:
            heap, pauses = world.to_robot, world.robot_pauses
            if heap and heap[0][0] <= world.now:
                return heapq.heappop(heap)[2]
            if world.now >= until:
                return None
            target = min(until, heap[0][0] if heap else np.inf, world.next_event())
            if pauses and pauses[0][0] <= target:
                _, target = pauses.pop(0)
            world.advance(target)


def run(duration, *, timeout=0.2, **world):
    """One run in real time: (steps as (s, input), RobotEnd, ControllerEnd, RobotsLink)."""
    end = ControllerEnd(lambda robot: Telling(), duration=duration)
    world = World(end, **world)
    plant, link = Told(world), RobotsLink(world)
    assert RobotDescription.of(plant).timestep == T
    robot = RobotEnd(plant, link, real_time=True, timeout=timeout, clock=world.clock)
    robot.drive(1, wait=30.0)
    return plant, robot, end, link
