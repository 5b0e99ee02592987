"""Signed frames: with a key that both ends have, nobody else can take part (docs/wire.md).

A signed frame is a message with version 2, followed by a tag of 32 bytes:
tag = HMAC-SHA256(key, sender ‖ frame), sender the text "robot" or "controller" (RFC 2104). Run and sequence are in the
frame, so that a copy of an old one is recognized by them. The sender keeps a frame from being sent back to where it
came from.
"""

from __future__ import annotations

import hmac
import os
from pathlib import Path

from ssmr_torch.wire.messages import HEADER, MAGIC, SEALED, VERSION

VARIABLE = "SSMR_TORCH_WIRE_KEY"
TAG = 32        # bytes
SHORTEST = 16   # bytes of a key
LONGEST = 4096


class Seal:
    """Signs the frames of one end, and checks those of the other.

    key: the secret, `SHORTEST` bytes or more.   own, other: "robot" or "controller".
    """

    def __init__(self, key: bytes, own: str, other: str):
        if not isinstance(key, bytes) or not SHORTEST <= len(key) <= LONGEST:
            raise ValueError(f"the key of the wire has {len(key)} bytes; expected {SHORTEST} to {LONGEST}")
        self._key, self._own, self._other = key, own.encode(), other.encode()

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self._own.decode()})"

    def __reduce__(self):
        raise TypeError("a key is not copied or stored; read it again at the other place")

    def sealed(self, frame: bytes) -> bytes:
        """The signed frame to send, for a packed message."""
        frame = _with_version(frame, SEALED)
        return frame + hmac.digest(self._key, self._own + frame, "sha256")

    def opened(self, data: bytes) -> bytes | None:
        """The packed message in a signed frame of the other end; None for anything else."""
        frame, tag = data[:-TAG], data[-TAG:]
        if len(frame) < HEADER.size or frame[:5] != MAGIC + bytes([SEALED]):
            return None
        expected = hmac.digest(self._key, self._other + frame, "sha256")
        return _with_version(frame, VERSION) if hmac.compare_digest(tag, expected) else None


def read_key(key_file: str | Path | None = None) -> bytes | None:
    """The key in a file, else in the environment variable SSMR_TORCH_WIRE_KEY, else None: frames are not signed.

    White space around the key is left out. Raises OSError for a file that cannot be read, and ValueError for a key that
    is too short or too long, without showing it.
    """
    if key_file is not None:
        where, key = str(key_file), _read(Path(key_file))
    elif os.environ.get(VARIABLE):
        where, key = VARIABLE, os.environ[VARIABLE].encode()
    else:
        return None
    key = key.strip()
    if not SHORTEST <= len(key) <= LONGEST:
        raise ValueError(f"the key of the wire in {where} has {len(key)} bytes; expected {SHORTEST} to {LONGEST}: "
                         "python -c 'import secrets; print(secrets.token_hex(32))' writes one")
    return key


def _read(path: Path) -> bytes:
    if not path.is_file():
        raise FileNotFoundError(f"no key at {path}; expected the file with the key that both ends of the wire have")
    with open(path, "rb") as file:
        return file.read(LONGEST + 64)


def _with_version(frame: bytes, version: int) -> bytes:
    return frame[:4] + bytes([version]) + frame[5:]
