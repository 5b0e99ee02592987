"""The two ends of a ZeroMQ connection. No other file imports ZeroMQ."""

from __future__ import annotations

import logging
from collections import Counter
from time import monotonic

from ssmr_torch.wire.limits import LARGEST_BODY
from ssmr_torch.wire.messages import HEADER, Message
from ssmr_torch.wire.notices import Notices
from ssmr_torch.wire.seal import TAG, Seal

try:
    import zmq
except ImportError as error:
    raise ImportError("a connection to a robot or controller needs ZeroMQ, which is not installed: "
                      "pip install 'ssmr_torch[wire]'") from error

# Messages that may wait: enough for a second of silence at 1 kHz. Older ones would be useless.
QUEUE = 1000
# Unsent messages of a robot without a controller: few HELLOs, and few old measurements, which would be ignored.
UNSENT = 16
# So many unsigned frames are dropped in one call, so that a flood of them cannot hold up an end.
DROPPED_AT_ONCE = 256

log = logging.getLogger(__name__)


class _Link:
    """A socket with timeouts for everything, which leaves nothing behind when it is closed.

    seal: signs and checks all frames; None: they are not signed.   counts: "unauthenticated", frames that were dropped
    because the key's signature was missing or wrong.
    """

    def __init__(self, kind: int, seal: Seal | None):
        self.seal = seal
        self.counts: Counter[str] = Counter()
        self._notices = Notices(log)
        self._context = zmq.Context()
        self._socket = self._context.socket(kind)
        self._socket.setsockopt(zmq.LINGER, 200)  # ms, so that the last message is still sent
        self._socket.setsockopt(zmq.SNDHWM, QUEUE)
        self._socket.setsockopt(zmq.RCVHWM, QUEUE)
        self._socket.setsockopt(zmq.MAXMSGSIZE, HEADER.size + LARGEST_BODY + TAG)

    @property
    def endpoint(self) -> str:
        """The address with the chosen port, such as tcp://127.0.0.1:5555."""
        return self._socket.getsockopt_string(zmq.LAST_ENDPOINT)

    def close(self) -> None:
        """Release the address; a second call does nothing."""
        if not self._socket.closed:
            self._socket.close()
            self._context.term()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    def _frames(self, timeout: float) -> list[bytes] | None:
        """The frames of the next message, or None when none came within `timeout` s."""
        if not self._socket.poll(max(0, round(1e3 * timeout)), zmq.POLLIN):
            return None
        return self._socket.recv_multipart()

    def _next(self, timeout: float, addressed: bool) -> tuple[bytes, bytes] | None:
        """(peer, bytes) of the next message of somebody with the key; addressed: whether the first frame is the peer.
        """
        until = monotonic() + timeout
        for _ in range(DROPPED_AT_ONCE):
            frames = self._frames(until - monotonic())
            if frames is None:
                return None
            # No message of ours has several parts. Joined, it is counted as malformed like any other.
            peer, data = (frames[0], b"".join(frames[1:])) if addressed else (b"", b"".join(frames))
            message = data if self.seal is None else self.seal.opened(data)
            if message is not None:
                return peer, message
            self.counts["unauthenticated"] += 1
            self._notices.say("unauthenticated", "a message without the signature of the key was dropped; both ends "
                              "need the same key")
        return None

    def _packed(self, message: Message) -> bytes:
        return message.pack() if self.seal is None else self.seal.sealed(message.pack())


class ControllerLink(_Link):
    """The controller's end: waits at an address for robots.

    bind: such as tcp://*:5555; with tcp://127.0.0.1:* the system chooses a port that only this computer can reach.
    key: see `seal.read_key`; None: frames are not signed.
    Raises OSError for an address that is in use or is not an address, and ValueError for a key that is too short.
    """

    def __init__(self, bind: str, key: bytes | None = None):
        super().__init__(zmq.ROUTER, None if key is None else Seal(key, "controller", "robot"))
        try:
            self._socket.bind(bind)
        except zmq.ZMQError as error:
            self.close()
            raise OSError(f"cannot wait at {bind!r}: {error}; expected a free address such as tcp://*:5555") from error

    def receive(self, timeout: float) -> tuple[bytes, bytes] | None:
        """(peer, bytes) of the next message, or None when none came within `timeout` s."""
        return self._next(timeout, addressed=True)

    def send(self, peer: bytes, message: Message) -> bool:
        """Send without waiting, because a robot that is gone must not delay the controller. Whether it was accepted."""
        try:
            self._socket.send_multipart([peer, self._packed(message)], zmq.NOBLOCK)
        except zmq.ZMQError:
            return False
        return True


class RobotLink(_Link):
    """The robot's end: connects to the controller's address, and tries again until a controller is there.

    connect: such as tcp://192.168.0.2:5555.   key: see `seal.read_key`; None: frames are not signed.
    Raises OSError for something that is not an address, and ValueError for a key that is too short.
    """

    def __init__(self, connect: str, key: bytes | None = None):
        super().__init__(zmq.DEALER, None if key is None else Seal(key, "robot", "controller"))
        # IMMEDIATE would queue nothing, but would also throw away the last message of a controller that is gone.
        self._socket.setsockopt(zmq.SNDHWM, UNSENT)
        try:
            self._socket.connect(connect)
        except zmq.ZMQError as error:
            self.close()
            raise OSError(f"cannot connect to {connect!r}: {error}; expected an address such as "
                          "tcp://192.168.0.2:5555") from error

    def receive(self, timeout: float) -> bytes | None:
        """The bytes of the next message, or None when none came within `timeout` s."""
        received = self._next(timeout, addressed=False)
        return None if received is None else received[1]

    def send(self, message: Message) -> bool:
        """Send without waiting. Whether the message was accepted."""
        try:
            self._socket.send(self._packed(message), zmq.NOBLOCK)
        except zmq.Again:
            return False
        return True
