"""A robot and a controller in words, for the controller's end of the wire without sockets."""

import numpy as np

from ssmr_torch.control.base import Command
from ssmr_torch.status import Status
from ssmr_torch.wire.messages import Kind, Message

H = 0.01


class Echo:
    """Answers with the observation, and with 0.5 where there is none."""

    period = H

    def __init__(self):
        self.seen, self.resets = [], 0

    def reset(self):
        self.resets += 1

    def __call__(self, time, observation):
        self.seen.append((round(time, 9), tuple(observation)))
        if np.isnan(observation).any():
            return Command(np.full(2, 0.5), fallback=Status.NOT_FINITE)
        return Command(np.array(observation))


class Talk:
    """A robot in words: its run, and its messages at times s."""

    def __init__(self, end, hello, peer=b"robot", at=0.0):
        self.end, self.peer = end, peer
        (_, start), = end.receive(peer, hello, at)
        assert start.kind is Kind.START
        self.run = start.run

    def measure(self, sequence, at, stamp=None, values=None, run=None):
        values = np.full(2, float(sequence)) if values is None else np.array(values)
        message = Message(Kind.MEASUREMENT, self.run if run is None else run, sequence,
                          50.0 + sequence * H if stamp is None else stamp, values=values)
        return [reply.message for reply in self.end.receive(self.peer, message.pack(), at)]

    def tick(self, at):
        return [reply.message for reply in self.end.tick(at)]
