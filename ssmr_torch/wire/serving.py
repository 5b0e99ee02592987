"""The loop that serves a controller: it waits at an address and answers robots until enough runs are finished."""

from __future__ import annotations

from collections.abc import Callable
from time import monotonic

from ssmr_torch.wire.controller_end import ControllerEnd
from ssmr_torch.wire.stopping import ended_by_signals

# Longest single wait, s; interrupts are handled in between.
LONGEST_WAIT = 0.1
# Most messages that are read before they are answered.
AT_ONCE = 128
# During a run in real time so many of those messages are heeded that others than its robot sent.
OF_OTHERS = 8


def serve(link, end: ControllerEnd, *, runs: int | None = None, done: Callable[[ControllerEnd], None] | None = None,
          stop: Callable[[], bool] = lambda: False, clock: Callable[[], float] = monotonic) -> None:
    """Answer messages over `link`, a `ControllerLink`, until `runs` runs are finished (None: for ever) or `stop()`.

    done: called after every finished run, while `end` still has its samples.
    At the end, also after an error, an interrupt or a signal that ends the process, the robot is informed and applies
    its safe input.
    """
    finished, link.counts = 0, end.counts
    with ended_by_signals():
        try:
            while (runs is None or end.finished < runs) and not stop():
                answer(link, end, clock)
                if end.finished > finished:
                    finished = end.finished
                    if done is not None:
                        done(end)
        finally:
            for peer, message in end.end("the controller stops"):
                link.send(peer, message)


def answer(link, end: ControllerEnd, clock: Callable[[], float] = monotonic) -> None:
    """Wait for a message, `LONGEST_WAIT` at most; answer all that can be read; go on without those that are overdue."""
    waiting, wait = [], min(max(end.due() - clock(), 0.0), LONGEST_WAIT)
    while len(waiting) < AT_ONCE and (received := link.receive(0.0 if waiting else wait)) is not None:
        waiting.append(received)
    now = clock()
    # The robot comes first, and a flood from elsewhere must not hold it up.
    peer = end.paced_peer
    own, others = [each for each in waiting if each[0] == peer], [each for each in waiting if each[0] != peer]
    # A message that waits to be read came in time, however long the controller needed for the one before.
    replies = end.receive_all(own, now) + end.tick(now)
    for peer, message in replies:
        link.send(peer, message)
    heeded = others if peer is None else others[:OF_OTHERS]
    if len(others) > len(heeded):
        end.counts["unread"] += len(others) - len(heeded)
    for peer, message in end.receive_all(heeded, now):
        link.send(peer, message)
    if replies:
        end.prepare()
