"""Candidate symmetries (turns) from a linear response of the outputs: axes, permutations of inputs and of markers."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import combinations

import numpy as np

from ssmr_torch.symmetry_turns import Turn, closed, marker_size, mirror, on_markers, rotation

ANGLES = (60, 90, 120, 180)   # degrees
NEAR = 0.25                   # largest relative error of the turned response for a turn to be tried
CLEARER = 0.8                 # markers are permuted only if this multiplies the error by less than this factor
SMALL, EXACT = 1e-2, 1e-9     # smaller differences of the response have no direction; tolerance of a coordinate axis
UNLIKE = 1.5                  # inputs whose spreads differ by a larger ratio are not permuted
ALTERNATIONS = 3


def suggested(response: np.ndarray, signed: np.ndarray, spread: np.ndarray, inferred: bool = False) -> list[Turn]:
    """Turns that leave a linear response G (H, p, m) to input steps nearly unchanged, best first, one per permutation.

    The outputs are markers of 3 (or 2) coordinates. A turn may permute the inputs and the markers.
    signed: (m,), whether an input takes both signs alike. spread: (m,), spread of each input; only inputs of similar
    spread are permuted. inferred: whether axes are estimated from the response, for markers that are measured in a
    frame other than the robot's. Otherwise the axes are coordinate axes, and the normals of reflections are at
    multiples of 15° to them.
    """
    size = marker_size(response.shape[1])
    if not size or not np.linalg.norm(response):
        return []
    found: dict[tuple, Turn] = {}
    axes, normals = _inferred(response, size) if inferred else (list(np.eye(size)[::-1]), _plain_normals(size))
    for R, name in _isometries(size, axes, normals):
        turn = _assigned(response, R, signed, name)
        missed, key = turn.missed(response), (turn.inputs.tobytes(), bool(np.linalg.det(R) > 0))
        better = key not in found or missed < found[key].missed(response)
        alike = (spread[turn.moved()] < UNLIKE * spread).all()
        if missed < NEAR and alike and better and closed([turn]):
            found[key] = turn
    return sorted(found.values(), key=lambda turn: turn.missed(response))


def _isometries(size: int, axes: Sequence, normals: Sequence) -> Iterable[tuple[np.ndarray, str]]:
    """Rotations and reflections, with their names. Turns by 180° in the plane are left out: for inputs of both signs
    they leave every linear response unchanged.
    """
    if size == 2:
        yield from ((rotation(angle, (0, 0)), f"turn by {angle}°") for angle in ANGLES if angle < 180)
    else:
        for axis in map(_pointing, axes):
            yield from ((rotation(angle, axis), f"turn by {angle}° about {_direction(axis)}") for angle in ANGLES)
    yield from ((mirror(normal), f"reflection along {_direction(normal)}") for normal in map(_pointing, normals))


def _plain_normals(size: int) -> list[np.ndarray]:
    """Coordinate axes, and every 15° between two of them."""
    turned = [np.cos(angle) * one + np.sin(angle) * other for one, other in combinations(np.eye(size), 2)
              for angle in np.deg2rad(np.arange(15, 180, 15)) if angle != np.pi / 2]
    return [*np.eye(size), *turned]


def _inferred(response: np.ndarray, size: int) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Axes of rotations and normals of reflections, estimated from the response.

    The matrix of second moments of the response commutes with its symmetries. Their axes and normals are therefore
    eigenvectors; if two eigenvalues are equal, normals are differences of the responses to two inputs.
    """
    markers = response.reshape(len(response), -1, size, response.shape[2])
    axes = list(np.linalg.eigh(np.einsum("hiam,hibm->ab", markers, markers))[1].T)
    mean = markers.mean((0, 1)).T
    differences = [one - sign * other for one, other in combinations(mean, 2) for sign in (1, -1)]
    least = SMALL * np.abs(mean).max()
    return axes, [*axes, *(each / np.linalg.norm(each) for each in differences if np.linalg.norm(each) > least)]


def _pointing(axis: np.ndarray) -> np.ndarray:
    return axis * np.sign(axis[np.abs(axis).argmax()])


def _direction(axis: np.ndarray) -> str:
    nearest = int(np.abs(axis).argmax())
    if np.abs(axis[nearest]) > 1 - EXACT:
        return "xyz"[nearest]
    return "(" + ", ".join(f"{round(value, 2) + 0.0:.2f}" for value in axis) + ")"


def placed(response: np.ndarray, turn: Turn) -> Turn:
    """The same turn with the permutation of the markers that gives the smallest error of the response."""
    size = marker_size(response.shape[1])
    R = turn.outputs[:size, :size]
    turned, markers = _turned(response, R)
    places = _places(turned, markers, turn.inputs)
    other = Turn(on_markers(R, places), turn.inputs, turn.name)
    return other if closed([other]) and other.missed(response) < CLEARER * turn.missed(response) else turn


def _assigned(response: np.ndarray, R: np.ndarray, signed: np.ndarray, name: str) -> Turn:
    """The turn with this isometry and the smallest error of the response. It optimizes the permutations of inputs and
    of markers in turn.
    """
    turned, markers = _turned(response, R)
    count, found = markers.shape[1], []
    for places in (np.roll(np.arange(count), -shift) for shift in range(count)):
        for _ in range(ALTERNATIONS):
            P = _permutation(turned, markers[:, places], signed)
            before, places = places, _places(turned, markers, P)
            if (before == places).all():
                break
        found.append(Turn(on_markers(R, places), P, name))
    return min(found, key=lambda turn: turn.missed(response))


def _turned(response: np.ndarray, R: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    markers = response.reshape(len(response), -1, len(R), response.shape[2])
    return np.einsum("ab,hibm->hiam", R, markers), markers


def _places(turned: np.ndarray, markers: np.ndarray, P: np.ndarray) -> np.ndarray:
    """The permutation of the markers with the least squared error, by linear assignment."""
    return _matched(np.square(turned[:, :, None] - (markers @ P)[:, None]).sum((0, 3, 4)))


def _permutation(turned: np.ndarray, to: np.ndarray, signed: np.ndarray) -> np.ndarray:
    """P (m, m) with turned ≈ to P and the least squared error, by linear assignment."""
    a, b = (each.reshape(-1, each.shape[-1]) for each in (turned, to))
    inner = a.T @ b                                   # [j, l]: turned response to input j times response to input l
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
