"""Symmetries of a robot: a rotation of its outputs that goes with a permutation of its inputs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple


class Symmetric(NamedTuple):
    """Controlled runs, those that follow by symmetry among them; found: what was found, in words, or empty."""

    controlled: list
    found: str


def with_symmetry(controlled: Sequence, find: bool) -> Symmetric:
    """The runs as they are, until a symmetry is found in them."""
    return Symmetric(list(controlled), "")
