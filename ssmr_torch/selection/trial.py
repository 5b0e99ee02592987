"""Score of a specification: its error on held-out parts, and the spread of its fits beyond the recordings.

    e_h: geometric mean over held-out starts of the rms error up to horizon h
    v_h: the same mean of the deviation of the folds' fits from their average, over training starts with inputs twice as
         fast and 1.25 times larger
    score: mean over h of ½ log(e_h² + v_h²)

e is the error of the model, v the part that the data do not determine; both are relative to the error of persistence.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from time import process_time

import numpy as np

from ssmr_torch.models.polynomial import PolynomialModel
from ssmr_torch.selection.closed_form import ALL, ClosedForm
from ssmr_torch.selection.fast_state import with_fibre
from ssmr_torch.selection.folds_and_starts import FOLDS, Samples, Starts
from ssmr_torch.selection.refinement import LARGEST, Problem, refine
from ssmr_torch.selection.rollouts import rolled_out
from ssmr_torch.selection.specification import Specification
from ssmr_torch.selection.stability import stays_bounded

FAR = 50.0        # error of a diverged rollout, relative to the outputs' size
FLOOR = 1e-9      # smallest error, relative to the outputs' size
MOST_LEFT = 100.0


@dataclass(frozen=True, eq=False)
class Outcome:
    """score, e (h,), v (h,). predictions: scaled predictions of the targets, one per fold, then one per fold at double
    speed.
    """

    score: float
    e: np.ndarray
    v: np.ndarray
    predictions: list[np.ndarray] = field(default_factory=list, repr=False)


FAILED = Outcome(np.inf, np.full(3, np.inf), np.full(3, np.inf))


class Trial:
    """Tries specifications on one set of runs. horizons: indices of the horizons that count."""

    def __init__(self, samples: Samples, *, horizons: Sequence[int] | None = None, noise: float = 0.0):
        self.samples, self.noise, self.began = samples, noise, process_time()
        self.horizons = list(range(len(samples.horizons))) if horizons is None else list(horizons)
        self.held_out = [samples.held_out(fold) for fold in range(FOLDS)]
        self.fast = samples.hurried()
        if sum(len(starts) > 0 for starts in self.held_out) < 2 or not len(self.fast):
            seconds = ", ".join(f"{len(y) * samples.timestep:.3g}" for y, _ in samples.controlled[:5])
            raise ValueError(f"the controlled training runs are too short: {seconds} s. Cross-validation needs two "
                             f"parts to hold out, each after a window of {samples.past + 1} samples; record more runs, "
                             f"or runs longer than {2 * samples.past * samples.timestep:.3g} s")
        self.outcomes: dict[Specification, Outcome] = {}
        self._closed: tuple[tuple, ClosedForm] | None = None
        self._whole: Samples | None = None
        self._training: dict[int, Starts] = {}
        self.left_out = 0
        still = [(starts.window[:, -1:, samples.targets] - starts.follows[:, :, samples.targets]) / samples.scale
                 for starts in self.held_out if len(starts)]
        self.persistence = self._errors([np.square(each).sum(-1) for each in still])

    @property
    def cpu(self) -> float:
        """CPU seconds since the trial began."""
        return process_time() - self.began

    def __call__(self, specification: Specification) -> float:
        """The score; infinite for a specification that cannot be fitted or diverges."""
        if specification not in self.outcomes:
            try:
                closed = self.closed_form(specification)
                models = [self.fitted(closed, specification, fold) for fold in range(FOLDS)]
                predictions = [self.predicted(model, starts) for model, starts in zip(models, self.held_out)]
                predictions += [self.predicted(model, self.fast) for model in models]
                self.outcomes[specification] = self.judged(predictions)
            except (np.linalg.LinAlgError, ValueError):
                self.outcomes[specification] = FAILED
        return self.outcomes[specification].score

    def reconsider(self, specifications: Sequence[Specification]) -> None:
        """Score specifications again that were best with fewer rows and starts."""
        for each in sorted(specifications, key=lambda each: str(each.regression)):
            self(each)

    def closed_form(self, specification: Specification) -> ClosedForm:
        """The closed form of a specification. The last one is kept, because the next one often differs only in ridge.
        """
        if self._closed is None or self._closed[0] != specification.regression:
            self._closed = specification.regression, ClosedForm(self.samples, specification, self.noise)
        return self._closed[1]

    def fitted(self, closed: ClosedForm, specification: Specification, fold: int) -> PolynomialModel:
        """The model fitted to all rows that the fold does not hold out (or to all rows), with its refinement."""
        model = closed.model(specification.ridge, fold)
        if specification.pull:
            model = refine(self._problem(closed, model, fold), specification.pull)
        return with_fibre(model, self.samples, specification.fibre, fold) if specification.fibre else model

    def final(self, specification: Specification) -> PolynomialModel:
        """The model fitted to all rows of all data."""
        if self._whole is None:
            self._whole = self.samples.whole()
        closed = ClosedForm(self._whole, specification, self.noise)
        return self.fitted(closed, specification, ALL)

    def bounded(self, specification: Specification) -> bool:
        """Whether the model fitted to all folds stays near the measured range, see `stays_bounded`."""
        return stays_bounded(self.fitted(self.closed_form(specification), specification, ALL), self.samples)

    def refinable(self, specification: Specification) -> bool:
        """Whether its Gauss-Newton steps take at most some seconds."""
        closed = self.closed_form(specification)
        return self._problem(closed, closed.model(specification.ridge), ALL).work < LARGEST

    def _problem(self, closed: ClosedForm, model: PolynomialModel, fold: int) -> Problem:
        if fold not in self._training:
            self._training[fold] = self.samples.training(fold)
        return Problem(model, closed.charts[fold].E, self._training[fold], self.samples.targets)

    def predicted(self, model: PolynomialModel, starts: Starts) -> np.ndarray:
        """Targets along the horizon, scaled, (N, H, targets); a diverged rollout gets a large constant error."""
        if not len(starts):
            return starts.follows[..., self.samples.targets].astype(np.float32)
        found = rolled_out(model, starts)[..., self.samples.targets] / self.samples.scale
        return np.nan_to_num(found, nan=1e3, posinf=1e3, neginf=-1e3).astype(np.float32)

    def judged(self, predictions: list[np.ndarray]) -> Outcome:
        """The outcome of predictions of one specification or of an average."""
        held, fast = predictions[:FOLDS], np.stack(predictions[FOLDS:])
        held = [each.clip(-FAR, FAR) for each in held]
        fast = fast.clip(-FAR, FAR)
        truth = [starts.follows[:, :, self.samples.targets] / self.samples.scale for starts in self.held_out]
        squares = [np.square(each - true).sum(-1) for each, true in zip(held, truth) if len(true)]
        spread = np.square(fast - fast.mean(0)).sum(-1).mean(0)
        e = self._errors(squares) / self.persistence
        v = self._errors([spread]) / self.persistence
        left = max(np.abs(each).max(initial=0.0) for each in predictions[:FOLDS])
        score = 0.5 * np.log(e ** 2 + v ** 2)[self.horizons].mean() if left < MOST_LEFT else np.inf
        return Outcome(float(score), e, v, predictions)

    def _errors(self, squares: Iterable[np.ndarray]) -> np.ndarray:
        """Geometric mean over starts of the rms error up to each horizon, (h,); squares (N, H) of each group."""
        return np.array([np.exp(np.mean([np.log(np.sqrt(each[:, :steps].mean(1)) + FLOOR).mean() for each in squares]))
                         for steps in self.samples.horizons])

    def best(self, count: int | None = None, keep=lambda specification: True) -> list[Specification]:
        """The specifications with the lowest scores among those for which `keep` is true."""
        order = sorted(self.outcomes, key=lambda specification: self.outcomes[specification].score)
        return [each for each in order if np.isfinite(self.outcomes[each].score) and keep(each)][:count]
