"""Closed-form least squares as a Torch optimizer: it accumulates the rows of an epoch and solves in one step."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import torch
from torch import Tensor

from ssmr_torch.fitting.streamed_least_squares import Solution, StreamedRegression, gather


class ExactSolve(torch.optim.Optimizer):
    """Solves the regressions accumulated since the last step, over all processes of a distributed run.

    ridge: the relative λ of every regression; or several λ, from which cross-validation over the folds chooses; or a
    mapping {regression name: either of them}. A regression that the mapping does not name takes its "default", or λ =
    0. penalty: "ridge" or "lasso", see `StreamedRegression.solve`.
    After `step`, `solutions` holds the solutions. The owner of the parameters writes them into the parameters.
    """

    def __init__(self, parameters: Iterable[Tensor], ridge: float | tuple | Mapping = 0.0,
                 penalty: str = "ridge"):
        super().__init__(parameters, {})
        self.ridge, self.penalty = ridge, penalty
        self.regressions: dict[str, StreamedRegression] = {}
        self.solutions: dict[str, Solution] = {}

    def accumulate(self, name: str, features: Tensor, targets: Tensor, fold: int = 0) -> None:
        """Add rows, features (N, k) and targets (N, q), to the regression of this name."""
        self.regressions.setdefault(name, StreamedRegression()).accumulate(features, targets, fold)

    @torch.no_grad()
    def step(self, closure=None):
        loss = closure() if closure is not None else None
        self.solutions = {}
        for name, regression in sorted(gather(self.regressions).items()):
            ridge = self.ridge
            if isinstance(ridge, Mapping):
                ridge = ridge.get(name, ridge.get("default", 0.0))
            self.solutions[name] = regression.solve(ridge, penalty=self.penalty)
        self.regressions = {}
        return loss
