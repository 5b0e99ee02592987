"""Symmetries of a robot (turns): isometries of its outputs with a permutation of its inputs, y(P u) = T y(u)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

MOST = 24        # largest number of turns in a group
SAME = 1e-6
STATED = ("angle", "axis", "inputs")


@dataclass(frozen=True, eq=False)
class Turn:
    """outputs: T (p, p), orthogonal. inputs: P (m, m), a permutation, which may change signs. name: a short text."""

    outputs: np.ndarray
    inputs: np.ndarray
    name: str = ""

    def of(self, run: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """The run (y (T, p), u (T, m)) that follows from a run by the symmetry."""
        return run[0] @ self.outputs.T, run[1] @ self.inputs.T

    def after(self, other: Turn) -> Turn:
        """The turn that does the other first and then this one."""
        return Turn(self.outputs @ other.outputs, self.inputs @ other.inputs)

    def same(self, other: Turn) -> bool:
        """Whether both are equal."""
        return self.same_in("outputs", other) and self.same_in("inputs", other)

    def same_in(self, part: str, other: Turn) -> bool:
        """Whether their "outputs" or their "inputs" are equal."""
        return np.allclose(getattr(self, part), getattr(other, part), atol=SAME)

    def missed(self, response: np.ndarray) -> float:
        """‖T G − G P‖ / ‖G‖ of a response G (H, p, m)."""
        return float(np.linalg.norm(self.outputs @ response - response @ self.inputs) / np.linalg.norm(response))

    @property
    def isometry(self) -> np.ndarray:
        """The isometry of every marker, (3, 3) or (2, 2)."""
        size = marker_size(len(self.outputs))
        return self.outputs[:, :size].reshape(-1, size, size).sum(0)

    def moved(self) -> np.ndarray:
        """(m,), for every input, the number of the input that has the same effect on the turned robot."""
        return np.abs(self.inputs).argmax(0)

    def renumbering(self, names: Sequence[str]) -> str:
        """The permutation of the inputs as cycles of names, "a → b → −a, c ↔ d"; inputs that stay are left out."""
        cycles, to, left = [], self.moved(), list(range(len(names)))
        while left:
            first = k = left[0]
            words, sign = [names[first]], 1.0
            while k in left:
                left.remove(k)
                sign *= self.inputs[to[k], k]
                k = to[k]
                words.append(("−" if sign < 0 else "") + names[k])
            if len(words) == 3 and words[2] == words[0]:
                cycles.append(" ↔ ".join(words[:2]))
            elif len(words) > 2 or sign < 0:
                cycles.append(" → ".join(words))
        return ", ".join(cycles)


def closed(turns: Sequence[Turn]) -> list[Turn] | None:
    """All turns that follow from these, without the identity. None if they form no group with one permutation for each
    isometry, or a group of more than `MOST` turns.
    """
    start = Turn(np.eye(len(turns[0].outputs)), np.eye(len(turns[0].inputs)))
    group, fresh = [start], [start]
    while fresh:
        fresh = [new for new in (turn.after(old) for old in fresh for turn in turns)]
        kept: list[Turn] = []
        for new in fresh:
            if not any(new.same(each) for each in group):
                group.append(new)
                kept.append(new)
        fresh = kept
        if len(group) > MOST:
            return None
    alike = [turn.same_in(part, start) for turn in group[1:] for part in ("outputs", "inputs")]
    return None if any(alike) else group[1:]


def rotation(angle: float, axis: Sequence[float]) -> np.ndarray:
    """Rotation matrix for an angle in degrees about an axis (3,), right-handed. An axis (2,) of any value gives the
    rotation in the plane.
    """
    c, s = np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))
    if len(axis) == 2:
        return np.array([[c, -s], [s, c]])
    x, y, z = e = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
    return c * np.eye(3) + s * np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) + (1 - c) * np.outer(e, e)


def mirror(normal: Sequence[float]) -> np.ndarray:
    """Reflection at the plane (line) through the origin with this normal."""
    n = np.asarray(normal, dtype=float) / np.linalg.norm(normal)
    return np.eye(len(n)) - 2 * np.outer(n, n)


def on_markers(isometry: np.ndarray, places: Sequence[int]) -> np.ndarray:
    """T (p, p): the isometry (3, 3) or (2, 2) of every marker; marker i moves to places[i]."""
    return np.kron(np.eye(len(places))[:, list(places)], isometry)


def marker_size(outputs: int) -> int:
    """Number of coordinates per marker if this many outputs are markers: 3, otherwise 2; 0 if they are not markers."""
    return 3 if outputs % 3 == 0 else 2 if outputs % 2 == 0 else 0


def stated(statement: Mapping, input_names: Sequence[str], outputs: int) -> Turn:
    """The turn that a user states by angle (degrees), axis and inputs. inputs: for each input, the name of the input
    that has the same effect on the turned robot, with "-" before the name if the sign changes, as in
        {"angle": 90, "axis": [0, 0, 1], "inputs": ["cable2", "cable3", "cable4", "cable1"]}

    Every marker is turned. Leave axis out if markers have two coordinates.
    Raises ValueError for invalid keys, names or numbers, and for a turn whose repetition does not restore the inputs.
    """
    unknown = [key for key in statement if key not in STATED]
    missing = [key for key in ("angle", "inputs") if key not in statement]
    if unknown or missing:
        raise ValueError(f"symmetry has the keys {list(statement)}; expected angle, axis and inputs")
    size, angle, axis = marker_size(outputs), statement["angle"], statement.get("axis", [0, 0])
    if not size:
        raise ValueError(f"symmetry: {outputs} outputs are not markers with 3 or 2 coordinates each; use all "
                         "coordinates of the markers as outputs, or leave the symmetry out")
    if not isinstance(angle, (int, float)) or isinstance(angle, bool) or not 0 < abs(angle) <= 180 \
            or abs(360 / angle - round(360 / angle)) > SAME:
        raise ValueError(f"symmetry.angle is {angle!r}; expected degrees that divide 360, such as 180, 120, 90 or "
                         "60")
    if size == 3:
        axis = np.asarray(axis, dtype=float) if _are_numbers(axis) else np.zeros(0)
        if axis.shape != (3,) or not np.isfinite(axis).all() or not axis.any():
            raise ValueError(f"symmetry.axis is {statement.get('axis')!r}; expected three numbers, such as [0, 0, 1]")
    P = _renumbering(statement["inputs"], list(input_names))
    R = rotation(float(angle), axis if size == 3 else (0, 0))
    turn = Turn(np.kron(np.eye(outputs // size), R), P, f"turn by {angle:g}°")
    if closed([turn]) is None:
        raise ValueError(f"symmetry: after {round(360 / abs(angle))} turns by {angle:g}° the robot is as before, but "
                         f"the inputs {list(statement['inputs'])} are not; correct the angle or the order of the "
                         "inputs")
    return turn


def _are_numbers(values) -> bool:
    return isinstance(values, Sequence) and all(isinstance(value, (int, float)) for value in values)


def _renumbering(names, known: list[str]) -> np.ndarray:
    if isinstance(names, str) or not isinstance(names, Sequence):
        raise ValueError(f"symmetry.inputs is {names!r}; expected a list of the {len(known)} inputs {known}")
    P, strange = np.zeros((len(known),) * 2), []
    for column, name in enumerate(map(str, names)):
        plain = name if name in known else name.removeprefix("-")
        if plain not in known:
            strange.append(name)
        elif column < len(known):
            P[known.index(plain), column] = 1.0 if plain == name else -1.0
    if strange:
        raise ValueError(f"symmetry.inputs names {strange}, but the inputs are {known}")
    if len(names) != len(known) or not (np.abs(P).sum(1) == 1).all():
        raise ValueError(f"symmetry.inputs is {list(names)}; expected each of the {len(known)} inputs {known} once")
    return P
