"""The loop that serves a controller: it waits at an address and answers robots until enough runs are finished."""

from __future__ import annotations

from collections.abc import Callable
from time import monotonic

from ssmr_torch.wire.controller_end import ControllerEnd

# Longest single wait, s; interrupts are handled in between.
LONGEST_WAIT = 0.1


def serve(link, end: ControllerEnd, *, runs: int | None = None, done: Callable[[ControllerEnd], None] | None = None,
          stop: Callable[[], bool] = lambda: False, clock: Callable[[], float] = monotonic) -> None:
    """Answer messages over `link`, a `ControllerLink`, until `runs` runs are finished (None: for ever) or `stop()`.

    done: called after every finished run, while `end` still has its samples.
    At the end, also after an error or an interrupt, the robot is informed and applies its safe input.
    """
    finished = 0
    try:
        while (runs is None or end.finished < runs) and not stop():
            received = link.receive(min(max(end.due() - clock(), 0.0), LONGEST_WAIT))
            now = clock()
            # A message that waits to be read came in time, however long the controller needed for the one before.
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
