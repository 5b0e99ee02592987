"""Ridge regressions from second moments, for all rows and for the rows that each fold does not hold out."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

FLOOR = 1e-13  # relative ridge on every column; two equal columns then get equal coefficients


class Moments(NamedTuple):
    """Second moments XᵀX / N and XᵀT / N of regressors X (N, F) and targets T (N, k), and the number of rows N."""

    regressors: np.ndarray
    targets: np.ndarray
    rows: int

    @classmethod
    def of(cls, X: np.ndarray, T: np.ndarray) -> Moments:
        """The moments of these rows."""
        return cls(X.T @ X / len(X), X.T @ T / len(X), len(X))

    def without(self, others: Moments) -> Moments:
        """The moments of the remaining rows after the rows of `others` are removed."""
        left = self.rows - others.rows
        if left < 1:
            raise ValueError(f"{self.rows} rows, of which a fold holds out {others.rows}, so that none remain; record "
                             "longer or more runs")
        return Moments(*((self.rows * mine - others.rows * theirs) / left
                         for mine, theirs in zip(self[:2], others[:2])), left)

    def solution(self, ridge) -> np.ndarray:
        """Coefficients (k, F). ridge: a number or (F,), relative to each column's mean square."""
        scale = np.sqrt(np.maximum(np.diag(self.regressors), 0.0))
        scale[scale < 1e-12] = 1.0
        normal = self.regressors / np.outer(scale, scale)
        normal[np.diag_indices_from(normal)] += np.asarray(ridge) + FLOOR
        return (np.linalg.solve(normal, self.targets / scale[:, None]) / scale[:, None]).T


def by_fold(X: np.ndarray, T: np.ndarray, touching: np.ndarray) -> Iterator[Moments]:
    """Moments for each fold of the rows that it does not touch, then of all rows. touching: (FOLDS, N)."""
    whole = Moments.of(X, T)
    for touched in touching:
        yield whole.without(Moments.of(X[touched], T[touched])) if touched.any() else whole
    yield whole
