"""A controller that waits at an address and answers robots until enough runs are done."""

from __future__ import annotations

from collections.abc import Callable
from time import monotonic

from ssmr_torch.wire.controller_end import ControllerEnd

# How long one wait lasts at most, s: an interrupt is heeded in between.
LONGEST_WAIT = 0.1


def serve(link, end: ControllerEnd, *, runs: int | None = None, done: Callable[[ControllerEnd], None] | None = None,
          stop: Callable[[], bool] = lambda: False, clock: Callable[[], float] = monotonic) -> None:
    """Answer what comes over `link`, a `ControllerLink`, until `runs` runs are finished (None: for ever) or `stop`.

    done: called after every finished run, whose samples the end then still has.
    However it ends, also by an error or an interrupt, the robot is told, and applies its safe input.
    """
    finished = 0
    try:
        while (runs is None or end.finished < runs) and not stop():
            received = link.receive(min(max(end.due() - clock(), 0.0), LONGEST_WAIT))
            now = clock()
            # What waits to be read has come in time, however long the controller thought about the one before.
            replies = end.tick(now) if received is None else end.receive(*received, now)
            for peer, message in replies:
                link.send(peer, message)
            if replies:
                end.prepare()
            if end.finished > finished:
                finished = end.finished
                if done is not None:
                    done(end)
    finally:
        for peer, message in end.end("the controller stops"):
            link.send(peer, message)
