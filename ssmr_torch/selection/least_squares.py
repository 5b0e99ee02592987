"""Ridge regressions from second moments, of all rows and of those that a fold leaves."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

FLOOR = 1e-13  # relative ridge on every column: two that are equal share their coefficient


class Moments(NamedTuple):
    """Means over rows: XᵀX / N and XᵀT / N of regressors X (N, F) and targets T (N, k), and N."""

    regressors: np.ndarray
    targets: np.ndarray
    rows: int

    @classmethod
    def of(cls, X: np.ndarray, T: np.ndarray) -> Moments:
        """The moments of these rows."""
        return cls(X.T @ X / len(X), X.T @ T / len(X), len(X))

    def without(self, others: Moments) -> Moments:
        """Those of the rows that are left when others are taken away."""
        left = self.rows - others.rows
        if left < 1:
            raise ValueError(f"{self.rows} rows, of which a fold holds out {others.rows}; record longer or more runs")
        return Moments(*((self.rows * mine - others.rows * theirs) / left
                         for mine, theirs in zip(self[:2], others[:2])), left)

    def solution(self, ridge) -> np.ndarray:
        """Coefficients (k, F); ridge: number or (F,), relative to each column's mean square."""
        scale = np.sqrt(np.maximum(np.diag(self.regressors), 0.0))
        scale[scale < 1e-12] = 1.0
        normal = self.regressors / np.outer(scale, scale)
        normal[np.diag_indices_from(normal)] += np.asarray(ridge) + FLOOR
        return (np.linalg.solve(normal, self.targets / scale[:, None]) / scale[:, None]).T


def by_fold(X: np.ndarray, T: np.ndarray, touching: np.ndarray) -> Iterator[Moments]:
    """Moments of the rows that each fold leaves, touching (FOLDS, N), then of all rows."""
    whole = Moments.of(X, T)
    for touched in touching:
        yield whole.without(Moments.of(X[touched], T[touched])) if touched.any() else whole
    yield whole
