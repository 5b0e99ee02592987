"""Output coordinates ξ = χ(y), in which a robot's motion is closer to linear; every χ is exactly invertible."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, fields
from math import factorial
from typing import ClassVar

import numpy as np

from ssmr_torch.models.arrays import Array, like, namespace
from ssmr_torch.named_classes import class_named

TERMS = 16  # number of terms of each power series; up to a = π, the first omitted term is below rounding
TINY = 1e-37  # m², added to a lateral square: a chord straight back along the axis has no lateral direction
HALVINGS = 4  # how often an angle up to π is halved; the square of its tangent is then below 0.04

# sin(a)/a, its derivative by a², and cos(a), as power series in a² / SPREAD, and atan(x)/x in x² / SPREAD. They are
# smooth and need no special case at a = 0. SPREAD is a power of two, so it changes no digit. It keeps the coefficients
# so large that an optimizer of ONNX graphs does not replace them by zero.
SPREAD = 64.0
SINC = tuple((-SPREAD) ** k / factorial(2 * k + 1) for k in range(TERMS))
SINC_SLOPE = tuple(k * SINC[k] / SPREAD for k in range(1, TERMS))
COSINE = tuple((-SPREAD) ** k / factorial(2 * k) for k in range(TERMS))
ARCTANGENT = tuple((-SPREAD) ** k / (2 * k + 1) for k in range(12))


@dataclass(frozen=True)
class OutputCoordinates(ABC):
    """ξ = χ(y) maps displacements from rest (..., p), m, to coordinates (..., p'), m, with χ(0) = 0.

    A subclass is a frozen dataclass of plain values (numbers, strings, tuples of them), which an artifact stores. Its
    `forward` and `inverse` use only functions that NumPy and Torch share. It is loaded again by its module and name.

    latent: p', the number of coordinates; p unless a subclass has more. linear: whether y is linear in ξ.
    """

    linear: ClassVar[bool] = False

    @abstractmethod
    def forward(self, y: Array) -> Array:
        """ξ = χ(y), (..., p) → (..., p')."""

    @abstractmethod
    def inverse(self, xi: Array) -> Array:
        """y = χ⁻¹(ξ), (..., p') → (..., p)."""

    def inverse_jacobian(self, xi: Array) -> Array:
        """∂y/∂ξ, (..., p, p'); by central differences unless a subclass computes it exactly."""
        xp, columns = namespace(xi), []
        step = 1e-6
        for j in range(xi.shape[-1]):
            along = like(xi, np.eye(xi.shape[-1])[j] * step)
            columns.append((self.inverse(xi + along) - self.inverse(xi - along)) / (2.0 * step))
        return xp.stack(columns, -1)

    def latent(self, output_dim: int) -> int:
        """p' for p outputs. Raises ValueError if these coordinates are for another number of outputs."""
        return output_dim

    def markers(self) -> np.ndarray | None:
        """The table that compiled code needs, see `Mixture.markers`; None if it does not support these coordinates."""
        return None

    @property
    def words(self) -> str:
        """Their description on a model card."""
        return f"{type(self).__name__} of {type(self).__module__}"

    def plain(self) -> dict:
        """Plain values for JSON; `coordinates_from_plain` is the inverse. Raises ValueError for a class that is defined
        inside a function, because it cannot be loaded by its name.
        """
        family = type(self)
        if "<locals>" in family.__qualname__:
            raise ValueError(f"the class of output coordinates {family.__qualname__} is defined inside a function, so "
                             "it cannot be loaded again by its name; define it at the top level of a module")
        return {"class": f"{family.__module__}:{family.__qualname__}",
                **{field.name: getattr(self, field.name) for field in fields(self)}}

    @classmethod
    def from_plain(cls, values: dict) -> OutputCoordinates:
        """The coordinates with these fields."""
        return cls(**{name: _tuples(value) for name, value in values.items()})


@dataclass(frozen=True)
class Identity(OutputCoordinates):
    """ξ = y, of `size` outputs."""

    linear: ClassVar[bool] = True

    size: int

    @property
    def words(self) -> str:
        return "the outputs themselves"

    def forward(self, y: Array) -> Array:
        return y

    def inverse(self, xi: Array) -> Array:
        return xi

    def latent(self, output_dim: int) -> int:
        return _agreeing(self.size, output_dim)

    def inverse_jacobian(self, xi: Array) -> Array:
        return like(xi, np.eye(self.size)) + 0.0 * xi[..., None]

    def markers(self) -> np.ndarray:
        return np.array([[0.0, 0.0, self.size, 1.0, 0.0, 0.0, 0.0, 0.0]])


@dataclass(frozen=True)
class ConstantCurvature(OutputCoordinates):
    """Bending angle and length of a constant-curvature arc from a base to each marker.

    With c the vector from the base to the marker at rest, e = c/‖c‖, r₀ = ‖c‖, P = c + y, a the angle between P and e,
    and n the lateral unit direction of P:

        ξ = r₀ a n + (‖P‖ a / sin a − r₀) e,

    so that the lateral part is the bending angle times r₀, and the axial part is the change of arc length.
    bases: c of each marker, 2 or 3 numbers in m; markers may move in a plane or in space. An arc must bend by less than
    π. Raises ValueError for a base of length zero, or with another number of coordinates.
    [Webster and Jones, Design and kinematic modeling of constant curvature continuum robots, 2010]
    """

    bases: tuple[tuple[float, ...], ...]

    def __post_init__(self):
        for base in self.bases:
            if len(base) not in (2, 3) or not 0 < np.linalg.norm(base) < np.inf:
                raise ValueError(f"a marker's base is {tuple(base)}; expected 2 or 3 finite numbers in m, not all "
                                 "zero: the vector from the base of the arc to the marker at rest")

    @property
    def words(self) -> str:
        lengths = ", ".join(f"{1e3 * np.linalg.norm(base):.4g}" for base in self.bases)
        return f"bending angle and length of constant-curvature arcs, {lengths} mm long at rest"

    def latent(self, output_dim: int) -> int:
        return _agreeing(sum(map(len, self.bases)), output_dim)

    def forward(self, y: Array) -> Array:
        xp, parts = namespace(y), []
        for d, e, r0 in self._of_markers(y):
            P = d + r0 * e
            axial = (P * e).sum(-1, keepdims=True)
            lateral = P - axial * e
            squares = (lateral * lateral).sum(-1, keepdims=True) + TINY
            # the tangent of the half angle is ρ / (axial + ‖P‖), and so on for each halving. It is smooth in ρ² and
            # needs no special case for a chord along the axis or at right angles to it
            adjacent = axial
            for _ in range(HALVINGS):
                adjacent = adjacent + xp.sqrt(adjacent * adjacent + squares)
            over_rho = 2.0**HALVINGS * _series(ARCTANGENT, squares / (adjacent * adjacent)) / adjacent     # a / ρ
            # sin a = ρ / ‖P‖
            parts.append(r0 * over_rho * lateral + ((axial * axial + squares) * over_rho - r0) * e)
        return xp.concatenate(parts, -1)

    def inverse(self, xi: Array) -> Array:
        xp, parts = namespace(xi), []
        for d, e, r0 in self._of_markers(xi):
            along = (d * e).sum(-1, keepdims=True)
            lateral = (d - along * e) / r0
            t = (lateral * lateral).sum(-1, keepdims=True)
            sinc = _series(SINC, t)
            parts.append((along + r0) * sinc * (_series(COSINE, t) * e + sinc * lateral) - r0 * e)
        return xp.concatenate(parts, -1)

    def inverse_jacobian(self, xi: Array) -> Array:
        xp, blocks, first, size = namespace(xi), [], 0, xi.shape[-1]
        for d, e, r0 in self._of_markers(xi):
            q = d.shape[-1]
            block = _arc_jacobian(d, e, r0)
            zeros = xp.zeros_like(d)
            left = [zeros[..., :1] * 0.0 + like(xi, np.zeros(first))] if first else []
            right = [zeros[..., :1] * 0.0 + like(xi, np.zeros(size - first - q))] if size > first + q else []
            blocks += [xp.concatenate([*left, block[..., i, :], *right], -1) for i in range(q)]
            first += q
        return xp.stack(blocks, -2)

    def markers(self) -> np.ndarray:
        rows, first = [], 0
        for base in self.bases:
            r0 = float(np.linalg.norm(base))
            axis = [*(np.array(base) / r0), 0.0][:3]
            rows.append([first, first, len(base), 1.0, r0, *axis])
            first += len(base)
        return np.array(rows)

    def _of_markers(self, array: Array):
        """Columns (..., q), axis e and rest length r₀ of each marker."""
        first = 0
        for base in self.bases:
            r0 = float(np.linalg.norm(base))
            yield array[..., first:first + len(base)], like(array, np.array(base) / r0), r0
            first += len(base)


@dataclass(frozen=True)
class Mixture(OutputCoordinates):
    """Several coordinates of the same outputs side by side, ξ = [χ_1(y), χ_2(y), …], and y = Σ_i w_i χ_i⁻¹(ξ_i).

    It serves to average models with different coordinates. χ⁻¹ is the inverse of χ if all parts give the same y.
    parts: the coordinates. weights: w_i, positive, with sum 1. Raises ValueError for other weights.
    """

    parts: tuple[OutputCoordinates, ...]
    weights: tuple[float, ...]
    size: int

    def __post_init__(self):
        right = len(self.weights) == len(self.parts) and all(weight > 0 for weight in self.weights)
        if not (right and abs(sum(self.weights) - 1.0) < 1e-9):
            raise ValueError(f"{len(self.parts)} coordinates with the weights {tuple(self.weights)}; expected one "
                             "positive weight for each, of sum 1")

    @property
    def linear(self) -> bool:
        return all(part.linear for part in self.parts)

    @property
    def words(self) -> str:
        return " and ".join(f"{weight:.3g} of {part.words}" for part, weight in zip(self.parts, self.weights))

    def latent(self, output_dim: int) -> int:
        return sum(part.latent(_agreeing(self.size, output_dim)) for part in self.parts)

    def forward(self, y: Array) -> Array:
        return namespace(y).concatenate([part.forward(y) for part in self.parts], -1)

    def inverse(self, xi: Array) -> Array:
        return sum(weight * part.inverse(piece) for part, weight, piece in self._pieces(xi))

    def inverse_jacobian(self, xi: Array) -> Array:
        return namespace(xi).concatenate([weight * part.inverse_jacobian(piece)
                                          for part, weight, piece in self._pieces(xi)], -1)

    def markers(self) -> np.ndarray | None:
        """Rows (first coordinate, first output, how many, weight, r₀, e); r₀ = 0 if the coordinates are the outputs."""
        rows, first = [], 0
        for part, weight in zip(self.parts, self.weights):
            each = part.markers()
            if each is None:
                return None
            each[:, 0] += first
            each[:, 3] *= weight
            rows.append(each)
            first += part.latent(self.size)
        return np.concatenate(rows)

    def plain(self) -> dict:
        return super().plain() | {"parts": [part.plain() for part in self.parts]}

    @classmethod
    def from_plain(cls, values: dict) -> Mixture:
        parts = tuple(coordinates_from_plain(part) for part in values["parts"])
        return cls(parts, tuple(values["weights"]), int(values["size"]))

    def _pieces(self, xi: Array):
        first = 0
        for part, weight in zip(self.parts, self.weights):
            count = part.latent(self.size)
            yield part, weight, xi[..., first:first + count]
            first += count


def coordinates_from_plain(plain: dict | None) -> OutputCoordinates | None:
    """The coordinates that `plain` described; None for None. Raises ValueError for a class that is not installed here,
    or that is not a class of output coordinates.
    """
    if plain is None:
        return None
    values = dict(plain)
    try:
        family = class_named(values.pop("class"), OutputCoordinates)
    except (ImportError, AttributeError) as error:
        raise ValueError(f"the class of output coordinates {plain['class']} is not found here ({error}); install the "
                         "package that has it, or put its module on the Python path") from error
    except TypeError as error:
        raise ValueError(f"{plain['class']} is not a class of output coordinates; expected a subclass of "
                         f"{OutputCoordinates.__module__}.{OutputCoordinates.__name__}") from error
    return family.from_plain(values)


def _series(coefficients: tuple[float, ...], square: Array) -> Array:
    """Σ_k coefficients[k] (square / SPREAD)^k."""
    t = square / SPREAD
    total = coefficients[-2] + coefficients[-1] * t
    for coefficient in coefficients[-3::-1]:
        total = coefficient + t * total
    return total


def _arc_jacobian(d: Array, e: Array, r0: float) -> Array:
    """∂y/∂ξ of one marker, (..., q, q)."""
    along = (d * e).sum(-1, keepdims=True)
    lateral = (d - along * e) / r0
    t = (lateral * lateral).sum(-1, keepdims=True)
    sinc, cosine, slope = _series(SINC, t), _series(COSINE, t), _series(SINC_SLOPE, t)
    q = d.shape[-1]
    across = (like(d, np.eye(q)) - e[:, None] * e) / r0                       # ∂lateral/∂ξ
    of_t = 2.0 * lateral @ across                                             # ∂t/∂ξ, and so on
    chord, of_chord = (along + r0) * sinc, sinc * e + (along + r0) * slope * of_t
    direction = cosine * e + sinc * lateral
    of_direction = ((-0.5 * sinc * e + slope * lateral)[..., :, None] * of_t[..., None, :]
                    + sinc[..., None] * across)
    return direction[..., :, None] * of_chord[..., None, :] + chord[..., None] * of_direction


def _agreeing(size: int, output_dim: int) -> int:
    if size != output_dim:
        raise ValueError(f"output coordinates for {size} outputs, but the model has {output_dim} outputs; expected one "
                         "set of coordinates for all of them")
    return size


def _tuples(value):
    return tuple(map(_tuples, value)) if isinstance(value, (list, tuple)) else value
