"""Turns of a robot: an isometry of its outputs that goes with a permutation of its inputs, y(P u) = T y(u)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

ANGLES = (60, 90, 120, 180)   # degrees
NEAR = 0.15                   # of the response, by which a turn that is looked at more closely may miss
CLEARER = 0.8                 # times the miss of another axis, for an axis to be taken instead
MOST = 24                     # turns of a group
SAME = 1e-6


@dataclass(frozen=True, eq=False)
class Turn:
    """outputs T (p, p) orthogonal, inputs P (m, m) a permutation, with signs where inputs have; name: in words."""

    outputs: np.ndarray
    inputs: np.ndarray
    name: str = ""

    def of(self, run: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """The run (y (T, p), u (T, m)) that follows from one by symmetry."""
        return run[0] @ self.outputs.T, run[1] @ self.inputs.T

    def after(self, other: Turn) -> Turn:
        """This one after another."""
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

    def moved(self) -> np.ndarray:
        """For every input the number of the one that takes its place, (m,)."""
        return np.abs(self.inputs).argmax(0)


def closed(turns: Sequence[Turn]) -> list[Turn] | None:
    """All turns that follow from these but the identity; None where these are no group of one permutation for each
    isometry, or of more than `MOST`.
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
    """Rotation by an angle (degrees) about an axis (3,), right-handed; in the plane for an axis (2,) of any value."""
    c, s = np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))
    if len(axis) == 2:
        return np.array([[c, -s], [s, c]])
    x, y, z = e = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
    return c * np.eye(3) + s * np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) + (1 - c) * np.outer(e, e)


def mirror(normal: Sequence[float]) -> np.ndarray:
    """Reflection at the plane (line) through the origin with this normal."""
    n = np.asarray(normal, dtype=float) / np.linalg.norm(normal)
    return np.eye(len(n)) - 2 * np.outer(n, n)


def suggested(response: np.ndarray, signed: np.ndarray) -> list[Turn]:
    """Turns that a linear response G (H, p, m) to steps of the inputs nearly allows, best first, one for each
    permutation.

    signed: (m,) inputs that take both signs alike. The outputs are markers of 3 (or 2) coordinates; markers may change
    places, too.
    """
    outputs = response.shape[1]
    size = 3 if outputs % 3 == 0 else 2 if outputs % 2 == 0 else 0
    if not size or not np.linalg.norm(response):
        return []
    found: dict[tuple, Turn] = {}
    for R, name in _isometries(response.reshape(len(response), -1, size, response.shape[2])):
        turn = _assigned(response, R, signed, name)
        missed, key = turn.missed(response), (turn.inputs.tobytes(), bool(np.linalg.det(R) > 0))
        if missed < NEAR and closed([turn]) and (key not in found or missed < CLEARER * found[key].missed(response)):
            found[key] = turn
    return sorted(found.values(), key=lambda turn: turn.missed(response))


def _isometries(markers: np.ndarray) -> Iterable[tuple[np.ndarray, str]]:
    """Rotations and reflections that may be symmetries of a response (H, markers, size, m), plain axes first.

    The matrix of second moments of the response commutes with its symmetries: their axes and normals are eigenvectors,
    or, where two values are alike, normals are differences of two inputs' responses. In the plane no turn by 180° is
    among them: with inputs of both signs every linear response allows it.
    """
    size = markers.shape[2]
    axes = np.linalg.eigh(np.einsum("hiam,hibm->ab", markers, markers))[1].T
    if size == 2:
        yield from ((rotation(angle, (0, 0)), f"turn by {angle}°") for angle in ANGLES if angle < 180)
    else:
        for axis in map(_pointing, (*np.eye(3)[::-1], *axes)):
            yield from ((rotation(angle, axis), f"turn by {angle}° about {_direction(axis)}") for angle in ANGLES)
    mean = markers.mean((0, 1)).T
    differences = [one - sign * other for k, one in enumerate(mean) for other in mean[:k] for sign in (1, -1)]
    least = 1e-2 * np.abs(mean).max()
    for normal in (*np.eye(size), *axes, *(each for each in differences if np.linalg.norm(each) > least)):
        normal = _pointing(normal / np.linalg.norm(normal))
        yield mirror(normal), f"reflection along {_direction(normal)}"


def _pointing(axis: np.ndarray) -> np.ndarray:
    return axis * np.sign(axis[np.abs(axis).argmax()])


def _direction(axis: np.ndarray) -> str:
    nearest = int(np.abs(axis).argmax())
    if np.abs(axis[nearest]) > 0.999:
        return "xyz"[nearest]
    return "(" + ", ".join(f"{value:.2f}" for value in axis) + ")"


def _assigned(response: np.ndarray, R: np.ndarray, signed: np.ndarray, name: str) -> Turn:
    """The turn with this isometry of every marker that misses the response least, by turns over inputs and markers."""
    count, inputs = response.shape[1] // len(R), response.shape[2]
    markers = response.reshape(len(response), count, len(R), inputs)
    turned = np.einsum("ab,hibm->hiam", R, markers)
    best = None
    starts = [np.arange(count)] + [np.array([(k + shift) % count for k in range(count)]) for shift in range(1, count)]
    for places in starts:
        for _ in range(3):
            P = _permutation(turned, markers[:, places], signed)
            # markers[places[i]] is where marker i goes
            cost = np.array([[np.sum((turned[:, i] - markers[:, j] @ P) ** 2) for j in range(count)]
                             for i in range(count)])
            again = _matched(cost)
            if (again == places).all():
                break
            places = again
        T = np.zeros((count * len(R),) * 2)
        for i, j in enumerate(places):
            T[j * len(R):(j + 1) * len(R), i * len(R):(i + 1) * len(R)] = R
        turn = Turn(T, P, name)
        if best is None or turn.missed(response) < best.missed(response):
            best = turn
    return best


def _permutation(turned: np.ndarray, to: np.ndarray, signed: np.ndarray) -> np.ndarray:
    """P (m, m) with turned ≈ to P, by the assignment of least squares."""
    a, b = (each.reshape(-1, each.shape[-1]) for each in (turned, to))
    inner = a.T @ b                                   # [j, l]: input j's turned response on that of input l
    both = signed[:, None] & signed[None]
    signs = np.where(both & (inner < 0), -1.0, 1.0)
    cost = (a ** 2).sum(0)[:, None] + (b ** 2).sum(0)[None] - 2 * signs * inner
    places = _matched(cost)
    P = np.zeros((len(places),) * 2)
    P[places, np.arange(len(places))] = signs[np.arange(len(places)), places]
    return P


def _matched(cost: np.ndarray) -> np.ndarray:
    from scipy.optimize import linear_sum_assignment

    return linear_sum_assignment(cost)[1]
