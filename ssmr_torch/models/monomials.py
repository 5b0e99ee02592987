"""Monomials of a vector, ordered by degree: x1, …, xn, x1², x1x2, …, x1xn, x2², …, or any set of them."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cached_property, lru_cache
from itertools import combinations_with_replacement
from math import comb
from typing import NamedTuple

import numpy as np

from ssmr_torch.models.arrays import Array, like, namespace

HIGHEST = 30  # degree of a monomial
MOST = 50_000  # monomials, together with all their divisors


def count_monomials(variables: int, lowest: int, highest: int) -> int:
    """Number of monomials of `variables` variables with lowest ≤ degree ≤ highest."""
    return comb(variables + highest, highest) - (comb(variables + lowest - 1, lowest - 1) if lowest else 0) \
        if highest >= lowest else 0


class Derivative(NamedTuple):
    """Structure of ∂(T φ)/∂x for the variables first ≤ j < last and any table T (r, q).

    It is polynomial: row i of ∂(T φ)_i / ∂x_j = Σ_c T[i, source[j, c]] · multiplicity[j, c] · (closure at needed[c]).
    needed (K,): positions in the closure. source, multiplicity (last − first, K): the monomial whose derivative is that
    entry, and the factor from its exponent; a factor of 0 means that there is no such monomial.
    """

    needed: np.ndarray
    source: np.ndarray
    multiplicity: np.ndarray


class Monomials:
    """φ(x), one entry Π_j x[f_j] for each row of `factors`. It holds structure only, no coefficients.

    variables: length of x. factors: the variables of each monomial; x_j² is (j, j), and () is the constant. The order
    within a row does not matter. Raises ValueError for a variable that x does not have, or a monomial given twice.

    The `closure` is the set of the monomials and all their divisors, ordered by degree, with the constant and all
    variables first. Each of its products is a monomial of one degree less times one variable. Values and derivatives
    are computed from it.
    exponents: (q, variables) integers. positions: (q,) of the monomials in the closure.
    levels: per degree d ≥ 2, the position of each product's parent among those of degree d − 1, and its variable.
    """

    def __init__(self, variables: int, factors: Iterable[Iterable[int]]):
        self.variables = int(variables)
        self.factors = tuple(tuple(sorted(int(factor) for factor in row)) for row in factors)
        outside = [row for row in self.factors if row and not 0 <= row[0] <= row[-1] < self.variables]
        if variables < 1 or outside:
            raise ValueError(f"monomials of {variables} variables; a monomial outside them has the factors "
                             f"{outside[:1] or 'none'}; expected at least 1 variable and factors from 0 to "
                             f"{self.variables - 1}")
        if len(set(self.factors)) < len(self.factors):
            twice = next(row for row in self.factors if self.factors.count(row) > 1)
            raise ValueError(f"the monomial with the factors {twice} is given twice; give each once")
        if len(self.factors) > MOST or max(map(len, self.factors), default=0) > HIGHEST:
            raise ValueError(f"{len(self.factors)} monomials, up to the degree {max(map(len, self.factors))}; expected "
                             f"at most {MOST} of a degree of at most {HIGHEST}")
        self._grade()

    def _grade(self) -> None:
        graded: dict[int, set] = {0: {()}, 1: {(j,) for j in range(self.variables)}}
        for row in self.factors:
            graded.setdefault(len(row), set()).add(row)
        highest = max(graded)
        for degree in range(highest, 1, -1):
            below = graded.setdefault(degree - 1, set())
            for row in graded.get(degree, ()):
                below.update(row[:k] + row[k + 1:] for k in range(degree))
                if len(below) > MOST:
                    raise ValueError(f"monomials with more than {MOST} divisors of the degree {degree - 1}; expected "
                                     "monomials of a lower degree")
        self.closure = [row for degree in range(highest + 1) for row in sorted(graded[degree])]
        self._position = {row: position for position, row in enumerate(self.closure)}
        self.levels = []
        for degree in range(2, highest + 1):
            rows, before = sorted(graded[degree]), {row: k for k, row in enumerate(sorted(graded[degree - 1]))}
            self.levels.append((np.array([before[row[:-1]] for row in rows], dtype=np.int64),
                                np.array([row[-1] for row in rows], dtype=np.int64)))
        self.highest = max(map(len, self.factors), default=0)
        self.positions = np.array([self._position[row] for row in self.factors], dtype=np.int64)
        first = int(self.positions[0]) if len(self.positions) else 0
        consecutive = np.array_equal(self.positions, first + np.arange(len(self.positions)))
        self._chosen = slice(first, first + len(self.positions)) if consecutive else self.positions

    def __len__(self) -> int:
        return len(self.factors)

    def position(self, factors: tuple[int, ...]) -> int:
        """Position of a monomial in the closure."""
        return self._position[factors]

    @cached_property
    def exponents(self) -> np.ndarray:
        counts = np.zeros((len(self), self.variables), dtype=np.int64)
        for row, factors in enumerate(self.factors):
            for factor in factors:
                counts[row, factor] += 1
        return counts

    def multiplied_out(self, x: Array) -> Array:
        """The closure of x (..., variables): (..., size), [1, x, products]."""
        if x.shape[-1] != self.variables:
            raise ValueError(f"{x.shape[-1]} values for monomials of {self.variables} variables; expected "
                             f"{self.variables}: check the sizes of the arrays that the model takes")
        xp = namespace(x)
        parts = [xp.ones_like(x[..., :1]), x]
        for parent, variable in self.levels:
            parts.append(parts[-1][..., self._on(x, parent)] * x[..., self._on(x, variable)])
        return xp.concatenate(parts, -1)

    def rows(self, x: Array) -> Array:
        """The closure at points x (variables, M), one row per monomial, (size, M). Rows multiply faster than columns.
        """
        xp = namespace(x)
        parts = [xp.ones_like(x[:1]), x]
        for parent, variable in self.levels:
            parts.append(parts[-1][on_device(x, parent)] * x[on_device(x, variable)])
        return xp.concatenate(parts, 0)

    def chosen_rows(self, closure: Array) -> Array:
        """φ, picked from the result of `rows`: (size, M) → (q, M)."""
        return closure[self._chosen if isinstance(self._chosen, slice) else on_device(closure, self._chosen)]

    def __call__(self, x: Array) -> Array:
        """φ(x), (..., variables) → (..., q)."""
        return self.chosen(self.multiplied_out(x))

    def chosen(self, closure: Array) -> Array:
        """φ, picked from the closure: (..., size) → (..., q)."""
        return closure[..., self._chosen if isinstance(self._chosen, slice) else self._on(closure, self._chosen)]

    def derivative(self, first: int, last: int) -> Derivative:
        """Structure of the Jacobian with respect to the variables first ≤ j < last."""
        if (first, last) not in self._derivatives:
            self._derivatives[first, last] = self._differentiated(first, last)
        return self._derivatives[first, last]

    @cached_property
    def _derivatives(self) -> dict[tuple[int, int], Derivative]:
        return {}

    def _differentiated(self, first: int, last: int) -> Derivative:
        found = []
        for row, factors in enumerate(self.factors):
            for variable in {factor for factor in factors if first <= factor < last}:
                found.append((row, variable - first, self._position[without(factors, variable)],
                              factors.count(variable)))
        needed = np.array(sorted({position for _, _, position, _ in found}), dtype=np.int64)
        column = {int(position): k for k, position in enumerate(needed)}
        source = np.zeros((last - first, len(needed)), dtype=np.int64)
        multiplicity = np.zeros(source.shape)
        for row, variable, position, count in found:
            source[variable, column[position]], multiplicity[variable, column[position]] = row, count
        return Derivative(needed, source, multiplicity)

    def jacobian(self, x: Array) -> Array:
        """∂φ/∂x, (..., variables) → (..., q, variables)."""
        below = self.multiplied_out(x)[..., on_device(x, self._below)]
        return like(x, self.exponents.astype(np.float64)) * below

    @cached_property
    def _below(self) -> np.ndarray:
        """(q, variables): position in the closure of each monomial's derivative by x_j, 0 if the derivative is zero."""
        places = np.zeros(self.exponents.shape, dtype=np.int64)
        for row, variable in np.argwhere(self.exponents):
            rest = list(self.factors[row])
            rest.remove(variable)
            places[row, variable] = self._position[tuple(rest)]
        return places

    def _on(self, array: Array, index: np.ndarray) -> Array:
        return on_device(array, index)


class Form:
    """f(x) = table · φ(x), table (r, q) of NumPy or Torch, and its exact Jacobian.

    A form caches values that it derives from the table. After a change of the table, make a new form.
    """

    def __init__(self, monomials: Monomials, table: Array):
        self.monomials, self.table = monomials, table
        self._slopes: dict[tuple[int, int], tuple] = {}

    def __call__(self, x: Array) -> Array:
        """(..., variables) → (..., r)."""
        return self.monomials(x) @ self.table.T

    def slopes(self, first: int, last: int) -> tuple[np.ndarray, Array]:
        """∂f/∂x, row by row, as positions in the closure (K,) and the table (r (last − first), K) over them."""
        if (first, last) not in self._slopes:
            needed, source, multiplicity = self.monomials.derivative(first, last)
            slopes = self.table[:, on_device(self.table, source)] * like(self.table, multiplicity)
            self._slopes[first, last] = needed, slopes.reshape(len(self.table) * (last - first), len(needed))
        return self._slopes[first, last]

    def jacobian(self, closure: Array, first: int, last: int) -> Array:
        """∂f/∂x_j for first ≤ j < last, (..., r, last − first), from the closure (..., size)."""
        needed, slopes = self.slopes(first, last)
        flat = closure[..., on_device(closure, needed)] @ slopes.T
        return flat.reshape(*flat.shape[:-1], len(self.table), last - first)


def without(factors: tuple[int, ...], factor: int) -> tuple[int, ...]:
    """The factors of a monomial after it is divided by one of them."""
    first = factors.index(factor)
    return factors[:first] + factors[first + 1:]


def on_device(array: Array, index: np.ndarray) -> Array:
    """An index array for the library and device of `array`; it is copied to a device only once."""
    if isinstance(array, np.ndarray):
        return index
    import torch

    if array.device.type == "cpu":
        return torch.from_numpy(index)
    copied = _copied.__wrapped__ if torch.compiler.is_compiling() else _copied  # a trace must not reuse tensors
    return copied(index.tobytes(), index.shape, array.device)


@lru_cache(maxsize=1024)
def _copied(content: bytes, shape: tuple, device):
    import torch

    return torch.from_numpy(np.frombuffer(content, dtype=np.int64).reshape(shape).copy()).to(device)


@lru_cache(maxsize=256)
def graded(variables: int, lowest: int, highest: int) -> Monomials:
    """x^{lowest:highest}, all monomials of these degrees, in the order of scikit-learn's PolynomialFeatures.

    Raises ValueError for fewer than one variable or a negative degree.
    """
    if variables < 1 or lowest < 0:
        raise ValueError(f"monomials of {variables} variables with lowest degree {lowest}; "
                         "expected at least 1 variable and a lowest degree of at least 0")
    if highest > HIGHEST or (count := count_monomials(variables, lowest, highest)) > MOST:
        many = f"{count} monomials" if highest <= HIGHEST else "more monomials than can be counted"
        raise ValueError(f"a degree of {highest} in {variables} variables makes {many}; expected at most {MOST}, of a "
                         f"degree of at most {HIGHEST}: lower the degree or the number of variables")
    return Monomials(variables, [factors for degree in range(lowest, highest + 1)
                                 for factors in combinations_with_replacement(range(variables), degree)])
