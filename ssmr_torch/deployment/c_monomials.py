"""Monomials in C: each is one of a degree less times a variable; their tables and those of their Jacobians."""

from __future__ import annotations

import numpy as np

from ssmr_torch.deployment.c_text import table
from ssmr_torch.models.monomials import Monomials, count_monomials

MULTIPLY_OUT = """\
/* powers = [1, x, products of x], product i being that at parent[i] times x[factor[i]]. */
static void multiply_out(const double *x, int variables, const int *parent, const int *factor, int products,
                         double *powers)
{
    int i;
    powers[0] = 1.0;
    for (i = 0; i < variables; i++)
        powers[1 + i] = x[i];
    for (i = 0; i < products; i++)
        powers[1 + variables + i] = powers[parent[i]] * x[factor[i]];
}

"""


class CMonomials:
    """[1, x, products of x] as far as `monomials` need it, and tables over it.

    Selected monomials stay a set that holds the parents and the derivatives of its members, so that nothing else is
    computed. parent, factor: as in `MULTIPLY_OUT`. size: how many there are, the constant among them.
    """

    def __init__(self, monomials: Monomials):
        self.monomials, variables = monomials, monomials.variables
        total = count_monomials(variables, 0, monomials.highest)
        lowest = count_monomials(variables, 0, monomials.lowest - 1)
        self._positions = lowest + (np.arange(len(monomials)) if monomials.chosen is None else monomials.chosen)
        kept = np.zeros(total, dtype=bool)
        kept[self._positions] = True
        kept[:1 + variables] = True
        self._compact = np.cumsum(kept) - 1
        parents, factors, offset = [np.zeros(0, dtype=np.int64)], [np.zeros(0, dtype=np.int64)], 1
        for parent, factor in monomials.levels:
            parents.append(parent + offset)
            factors.append(factor)
            offset += parent.max() + 1
        used = kept[1 + variables:]
        self.parent = self._compact[np.concatenate(parents)[used]]
        self.factor = np.concatenate(factors)[used]
        self.size = 1 + variables + len(self.parent)

    def declare(self, name: str) -> str:
        """The index tables NAME_parent and NAME_factor."""
        return (table(f"{name}_parent", self.parent, "position of what each product multiplies")
                + table(f"{name}_factor", self.factor, "variable it is multiplied by"))

    def widened(self, coefficients: np.ndarray) -> np.ndarray:
        """A table over the monomials (rows, q) as one over [1, x, …], without the columns of zeros at its end."""
        positions = self._compact[self._positions]
        wide = np.zeros((len(coefficients), 1 + positions.max(initial=0)))
        wide[:, positions] = coefficients
        return wide

    def derivative(self, coefficients: np.ndarray) -> np.ndarray:
        """The Jacobian of coefficients · monomials as a table over [1, x, …], (rows, q) → (rows · variables, ·)."""
        index = self._compact[self.monomials.derivative_index]
        used = self.monomials.exponents > 0
        wide = np.zeros((len(coefficients), self.monomials.variables, 1 + index[used].max(initial=-1)))
        for monomial, j in np.argwhere(used):
            wide[:, j, index[monomial, j]] += self.monomials.exponents[monomial, j] * coefficients[:, monomial]
        return wide.reshape(len(coefficients) * self.monomials.variables, -1)
