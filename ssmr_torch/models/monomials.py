"""Monomials z^{c:d} of a vector, degree-graded: x1, …, xn, x1², x1x2, …, x1xn, x2², …"""

from __future__ import annotations

from copy import copy
from itertools import combinations_with_replacement
from math import comb

import numpy as np


def count_monomials(variables: int, lowest: int, highest: int) -> int:
    """Number of monomials of `variables` variables with lowest ≤ degree ≤ highest."""
    return sum(comb(variables + degree - 1, degree) for degree in range(lowest, highest + 1))


class Monomials:
    """The vector z^{lowest:highest} as index tables: every monomial is one of a degree less times a variable.

    exponents: (q, n) integers, one row per monomial, in the order of scikit-learn's PolynomialFeatures.
    levels: per degree d ≥ 2, the position of each monomial's parent among those of degree d-1, and its variable.
    derivative_index: (q, n) positions in z^{0:highest} such that ∂z^α/∂z_j = α_j (z^{0:highest})[index[α, j]].
    """

    def __init__(self, variables: int, lowest: int, highest: int):
        if variables < 1 or lowest < 0:
            raise ValueError(f"monomials of {variables} variables from degree {lowest}; "
                             "expected at least 1 variable and a lowest degree of at least 0")
        self.variables, self.lowest, self.highest = variables, lowest, highest
        self.chosen: np.ndarray | None = None
        tuples = [list(combinations_with_replacement(range(variables), degree)) for degree in range(highest + 1)]
        self.levels = []
        for degree in range(2, highest + 1):
            position = {factors: index for index, factors in enumerate(tuples[degree - 1])}
            self.levels.append((np.array([position[f[:-1]] for f in tuples[degree]], dtype=np.int64),
                                np.array([f[-1] for f in tuples[degree]], dtype=np.int64)))
        everything = [factors for level in tuples for factors in level]
        position = {factors: index for index, factors in enumerate(everything)}
        chosen = [factors for factors in everything if lowest <= len(factors)]
        self.exponents = np.zeros((len(chosen), variables), dtype=np.int64)
        self.derivative_index = np.zeros((len(chosen), variables), dtype=np.int64)
        for row, factors in enumerate(chosen):
            for variable in set(factors):
                rest = list(factors)
                rest.remove(variable)
                self.exponents[row, variable] = factors.count(variable)
                self.derivative_index[row, variable] = position[tuple(rest)]

    def __len__(self) -> int:
        return len(self.exponents)

    def selected(self, rows: np.ndarray) -> Monomials:
        """Only these of the monomials, rows (q,) of truth values, in the same order."""
        part = copy(self)
        whole = self.chosen if self.chosen is not None else np.arange(len(self))
        part.chosen, part.exponents = whole[rows], self.exponents[rows]
        part.derivative_index = self.derivative_index[rows]
        return part

    def all_degrees(self, z: np.ndarray) -> np.ndarray:
        """z^{0:highest}, shape (..., 1 + n + …)."""
        parts = [np.ones(z.shape[:-1] + (1,), dtype=z.dtype)]
        if self.highest >= 1:
            parts.append(z)
        for parent, variable in self.levels:
            parts.append(parts[-1][..., parent] * z[..., variable])
        return np.concatenate(parts, axis=-1)

    def __call__(self, z: np.ndarray) -> np.ndarray:
        """z (..., n) → z^{lowest:highest} (..., q)."""
        powers = self.all_degrees(z)
        lowest = powers.shape[-1] - count_monomials(self.variables, self.lowest, self.highest)
        return powers[..., lowest:] if self.chosen is None else powers[..., lowest + self.chosen]

    def jacobian(self, z: np.ndarray) -> np.ndarray:
        """∂ z^{lowest:highest} / ∂z, shape (..., q, n)."""
        return self.exponents * self.all_degrees(z)[..., self.derivative_index]
