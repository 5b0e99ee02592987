"""Least squares over streamed data: only one triangular factor per fold is kept in memory.

The factor R of [features | targets] = Q R contains everything that a regression needs. Unlike normal equations, it does
not square the condition number. Factors of two batches, folds or processes are merged by a QR of both stacked.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.linalg.lapack import dtpqrt
from torch import Tensor, distributed

WAITING = 4     # number of rows per column that are factorized together
FEWEST = 2048   # smallest number of rows that are factorized together
BLOCK = 64      # columns in a block

# lars_path_gram stops at a penalty of 1e-7, independent of the size of the targets
PATH_SCALE = 1e6


@dataclass(frozen=True)
class Factor:
    """Triangular factor (k, k) of the `rows` rows seen so far."""

    triangle: Tensor
    rows: int

    @staticmethod
    def of(matrix: Tensor) -> Factor:
        """Factor of a batch of rows (N, k)."""
        return Factor(_triangle(matrix), len(matrix))

    def merged(self, other: Factor) -> Factor:
        """Factor of both sets of rows."""
        return Factor(_joined(self.triangle, other.triangle), self.rows + other.rows)


@dataclass(frozen=True)
class Solution:
    """coefficients (targets, features) of targets ≈ coefficients · features, and how well they were determined.

    condition: condition number of the features scaled to unit norm. ridge: relative λ, see `solve`. residual:
    ‖error‖ / ‖targets‖. validation: relative held-out error of each ridge that was tried, empty if there was no choice.
    factor: factor of [features | targets].
    """

    factor: Factor
    coefficients: Tensor
    rows: int
    condition: float
    rank: int
    ridge: float
    residual: float
    validation: dict[float, float]


class StreamedRegression:
    """targets ≈ C · features over any number of batches, stored separately by fold for cross-validation.

    accumulate(features (N, k), targets (N, q), fold); `folds` maps fold → Factor of [features | targets]. Rows are
    collected until there are `WAITING` times more rows than columns, because the factorization of a few rows takes as
    long as that of as many rows as columns.
    """

    def __init__(self):
        self.split: tuple[int, int] | None = None
        self._folds: dict[int, Factor] = {}
        self._waiting: dict[int, list[Tensor]] = {}

    @property
    def folds(self) -> dict[int, Factor]:
        for fold in list(self._waiting):
            self._factorize(fold)
        return self._folds

    def accumulate(self, features: Tensor, targets: Tensor, fold: int = 0) -> None:
        split = (features.shape[1], targets.shape[1])
        if self.split not in (None, split):
            raise ValueError(f"a batch has {split} features and targets, but earlier batches had {self.split}; give "
                             "every batch the same columns")
        self.split = split
        waiting = self._waiting.setdefault(fold, [])
        waiting.append(torch.cat([features, targets], dim=1))
        if sum(map(len, waiting)) >= max(WAITING * sum(split), FEWEST):
            self._factorize(fold)

    def _factorize(self, fold: int) -> None:
        self.merge(fold, Factor.of(torch.cat(self._waiting.pop(fold))))

    def merge(self, fold: int, factor: Factor) -> None:
        """Add the rows of a factor to a fold."""
        self._folds[fold] = self._folds[fold].merged(factor) if fold in self._folds else factor

    def total(self, without: int | None = None) -> Factor:
        """Factor of all folds, or of all except one."""
        kept = [factor for fold, factor in sorted(self.folds.items()) if fold != without]
        total = kept[0]
        for factor in kept[1:]:
            total = total.merged(factor)
        return total

    def solve(self, ridge: float | tuple[float, ...] = 0.0, *, penalty: str = "ridge") -> Solution:
        """Minimize Σ‖targets - C features‖² + a penalty on C that does not depend on units, s_j² = Σ feature_j²:

        "ridge": λ Σ_j s_j² ‖C_j‖²;   "lasso": 2 λ Σ_ij ‖target_i‖ s_j |C_ij|, where λ = 1 leaves nothing.
        Of several λ, it takes the one with the least held-out error over the folds. Raises ValueError if no rows were
        accumulated, if a λ is negative, or if there are several λ but only one fold.
        """
        if not self.folds:
            raise ValueError("no rows were accumulated: the training data contain no runs of the required kind")
        candidates = ridge_candidates(ridge)
        solve, validation = PENALTIES[penalty], {}
        if len(candidates) > 1 and self.split[1] > 0:
            if len(self.folds) < 2:
                raise ValueError(f"a choice among {len(candidates)} ridges needs at least 2 folds, but there is "
                                 f"{len(self.folds)}; give more trajectories, or only one ridge")
            validation = self._cross_validate(candidates, solve)
            candidates = (min(validation, key=validation.get),)
        total = self.total()
        (coefficients,) = solve(total, self.split[0], candidates[:1])
        residual = _relative_error(total, self.split[0], coefficients)
        return Solution(total, coefficients, total.rows, *_conditioning(total, self.split[0]), candidates[0], residual,
                        validation)

    def _cross_validate(self, candidates: tuple[float, ...], solve: Callable) -> dict[float, float]:
        squared, target = dict.fromkeys(candidates, 0.0), 0.0
        for fold, held_out in self.folds.items():
            solutions = solve(self.total(without=fold), self.split[0], candidates)
            for candidate, coefficients in zip(candidates, solutions):
                error, size = _squared_error(held_out, self.split[0], coefficients)
                squared[candidate] += error
            target += size
        return {candidate: (error / max(target, 1e-300)) ** 0.5 for candidate, error in squared.items()}


def ridge_candidates(ridge: float | Sequence[float]) -> tuple[float, ...]:
    """The λ to choose from. Raises ValueError unless there is at least one, and each is finite and 0 or more."""
    candidates = tuple(map(float, ridge)) if isinstance(ridge, Sequence) else (float(ridge),)
    if not candidates or not all(0 <= value < float("inf") for value in candidates):
        raise ValueError(f"ridge is {ridge}; expected 0 or more, one value or several")
    return candidates


def lasso_solutions(factor: Factor, features: int, candidates: Sequence[float]) -> list[Tensor]:
    """Coefficients (targets, features) for each lasso λ, from scikit-learn's least-angle regression on the factor.

    Its path over λ is exact, also for strongly correlated features such as neighbouring samples, for which coordinate
    descent does not converge.
    """
    from sklearn.linear_model import lars_path_gram

    matrix, targets = factor.triangle[:features, :features], factor.triangle[:features, features:]
    norms = (torch.linalg.vector_norm(columns, dim=0) for columns in (matrix, factor.triangle[:, features:]))
    scale, size = (torch.where(norm > 0, norm, torch.ones_like(norm)) for norm in norms)
    X, Y = (matrix / scale).cpu().numpy(), (PATH_SCALE * targets / size).cpu().numpy()
    gram, wanted = X.T @ X, PATH_SCALE * np.array(candidates)
    found = np.zeros((len(wanted), Y.shape[1], features))
    for row, correlation in enumerate((X.T @ Y).T):
        levels, _, path = lars_path_gram(correlation, gram, n_samples=1, alpha_min=wanted.min(), method="lasso",
                                         max_iter=20 * features)
        for feature, values in enumerate(path):
            found[:, row, feature] = np.interp(-wanted, -levels, values) / PATH_SCALE
    return [torch.as_tensor(each, dtype=matrix.dtype, device=matrix.device) / scale * size[:, None] for each in found]


PENALTIES = {"ridge": lambda *problem: ridge_solutions(*problem), "lasso": lasso_solutions}


def gather(regressions: dict[str, StreamedRegression]) -> dict[str, StreamedRegression]:
    """The regressions summed over all processes of a distributed run, equal in every process."""
    if not (distributed.is_available() and distributed.is_initialized()):
        return regressions
    for regression in regressions.values():
        _ = regression.folds  # factorizes waiting rows, because a triangle is smaller to send
    shares: list = [None] * distributed.get_world_size()
    distributed.all_gather_object(shares, regressions)
    together: dict[str, StreamedRegression] = {}
    for share in shares:
        for name, regression in share.items():
            whole = together.setdefault(name, StreamedRegression())
            whole.split = whole.split or regression.split
            for fold, factor in regression.folds.items():
                whole.merge(fold, factor)
    return together


def singular_values(factor: Factor) -> tuple[Tensor, Tensor]:
    """Singular values (k,) and right singular vectors (k, k), one per column, of the rows of a factor.

    The sign of each vector is fixed: its largest component is positive.
    """
    _, values, rows = torch.linalg.svd(factor.triangle, full_matrices=False)
    vectors = rows.T
    largest = vectors.abs().argmax(dim=0)
    return values, vectors * torch.sign(vectors[largest, torch.arange(vectors.shape[1])])


def _triangle(matrix: Tensor) -> Tensor:
    if len(matrix) < matrix.shape[1]:
        padding = matrix.new_zeros(matrix.shape[1] - len(matrix), matrix.shape[1])
        matrix = torch.cat([matrix, padding])
    return torch.linalg.qr(matrix, mode="r").R


def _joined(upper: Tensor, lower: Tensor) -> Tensor:
    """Triangular factor of two stacked triangles, by LAPACK's routine for triangles, which takes a fifth of the time.
    """
    if upper.device.type != "cpu" or upper.dtype != torch.float64 or not len(upper):
        return _triangle(torch.cat([upper, lower]))
    size = len(upper)
    return torch.from_numpy(np.ascontiguousarray(dtpqrt(size, min(BLOCK, size), upper.numpy(), lower.numpy())[0]))


def ridge_solutions(factor: Factor, features: int, candidates: Sequence[float]) -> list[Tensor]:
    """Coefficients (targets, features) for each ridge λ, from one singular value decomposition."""
    scale, left, values, right = _scaled_svd(factor, features)
    kept = values > values[0] * 1e-14 * max(factor.rows, features) ** 0.5
    projected = left.T @ factor.triangle[:features, features:]
    found = []
    for ridge in candidates:
        weights = torch.where(kept, values / (values**2 + ridge), torch.zeros_like(values))
        found.append(((right.T @ (weights[:, None] * projected)) / scale[:, None]).T.contiguous())
    return found


def _conditioning(factor: Factor, features: int) -> tuple[float, int]:
    """Condition number and rank of the features scaled to unit norm."""
    values = _scaled_svd(factor, features)[2]
    kept = values > values[0] * 1e-14 * max(factor.rows, features) ** 0.5
    return float(values[0] / values[-1]) if values[-1] > 0 else float("inf"), int(kept.sum())


def _scaled_svd(factor: Factor, features: int) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    triangle = factor.triangle[:features, :features]
    scale = torch.linalg.vector_norm(triangle, dim=0)
    scale = torch.where(scale > 0, scale, torch.ones_like(scale))
    return scale, *torch.linalg.svd(triangle / scale, full_matrices=False)


def _squared_error(factor: Factor, features: int, coefficients: Tensor) -> tuple[float, float]:
    # below the first rows of the triangle there are only targets: the part that no coefficients can explain
    explained, rest = factor.triangle[:features], factor.triangle[features:, features:]
    error = explained[:, features:] - explained[:, :features] @ coefficients.T
    unexplained = float((rest**2).sum())
    return float((error**2).sum()) + unexplained, float((explained[:, features:] ** 2).sum()) + unexplained


def _relative_error(factor: Factor, features: int, coefficients: Tensor) -> float:
    error, size = _squared_error(factor, features, coefficients)
    return (error / max(size, 1e-300)) ** 0.5
