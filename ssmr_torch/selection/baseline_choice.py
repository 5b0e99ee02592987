"""Chooses the best model of a known kind: its coordinates, delays, size, ridge, and whether decays are used.

The rule and the folds are the same as for the form of a slow-fast model.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from time import process_time

import numpy as np

from ssmr_torch.models.polynomial import PolynomialModel
from ssmr_torch.selection.baseline import RIDGES, Baseline
from ssmr_torch.selection.folds_and_starts import FOLDS
from ssmr_torch.selection.koopman_baselines import LIFTINGS, KoopmanForm
from ssmr_torch.selection.manifold_baselines import ControlAugmentedForm, SubmanifoldForm
from ssmr_torch.selection.stability import stays_bounded
from ssmr_torch.selection.trial import FAILED, Outcome, Trial

KINDS = {**dict.fromkeys(LIFTINGS, KoopmanForm), "sssr": SubmanifoldForm, "ssmr": SubmanifoldForm,
         "ssmr_control_augmented": ControlAugmentedForm}
FIRST_RIDGES = (1e-7, 1e-4)  # ridges with which sizes are compared; the best sizes are tried with all ridges
REFINED = 3                  # number of the best sizes that are tried with all ridges
SECONDS = 6.0                # CPU time after which no further form of a kind is tried
SIZING = 0.6                 # share of this time for sizes; the rest is for ridges and decays
LOOKED_AT = 20               # number of the best forms that are checked for stability


@dataclass(frozen=True, eq=False)
class BaselineChoice:
    """The chosen model; baseline: its form, with `outcome` on the folds.

    tried: number of forms that were tried; refused: number of better forms that diverged; left_out: number of forms
    that were not tried because the time was over; cpu: CPU time, s.
    """

    model: PolynomialModel
    baseline: Baseline
    outcome: Outcome
    tried: int
    refused: int
    left_out: int
    cpu: float

    def __str__(self) -> str:
        words = [f"{self.baseline}; best of {self.tried} forms in {self.cpu:.0f} s of CPU time",
                 *([f"{self.refused} better ones diverge"] if self.refused else []),
                 *([f"{self.left_out} not tried because the time was over"] if self.left_out else [])]
        return "; ".join(words)


def choose_baseline(trial: Trial, kind: str, *, seconds: float = SECONDS,
                    say: Callable[[str], None] = lambda line: None) -> BaselineChoice:
    """Choose and fit a model of one of `KINDS` on the runs of a trial. seconds: CPU time for the forms that are tried.

    Raises ValueError for another kind, and if no form of the kind stays bounded.
    """
    if kind not in KINDS:
        raise ValueError(f"there is no baseline {kind!r}; the baselines are {', '.join(KINDS)}")
    found = _Search(trial)
    decays = bool(trial.samples.decays)
    found.stage((replace(each, ridge=ridge) for each in _forms(trial, kind) for ridge in FIRST_RIDGES),
                SIZING * seconds)
    sizes = {each.regression: each for each in reversed(found.best())}
    best = sorted(sizes.values(), key=lambda each: found.outcomes[each].score)[:REFINED]
    found.stage((replace(each, ridge=ridge, decays=with_decays, smoothed=smoothed) for each in best
                 for smoothed in ((False, True) if KINDS[kind] is SubmanifoldForm else (False,))
                 for with_decays in ((True, False) if decays else (True,)) for ridge in RIDGES), seconds)
    refused = 0
    for each in found.best()[:LOOKED_AT]:
        model = found.closed_form(each).model(each.ridge)
        if stays_bounded(model, trial.samples):
            say(f"{kind}: {each}")
            return BaselineChoice(model, each, found.outcomes[each], len(found.outcomes), refused, found.left_out,
                                  found.cpu)
        refused += 1
    raise ValueError(f"all {len(found.outcomes)} forms of {kind} that were tried leave three times the measured range "
                     "in rollouts; record longer runs, or leave this kind out")


class _Search:
    """Forms that were tried, with their outcomes."""

    def __init__(self, trial: Trial):
        self.trial, self.began = trial, process_time()
        self.outcomes: dict[Baseline, Outcome] = {}
        self.left_out = 0
        self._closed: dict[tuple, object] = {}

    @property
    def cpu(self) -> float:
        return process_time() - self.began

    def stage(self, forms: Iterable[Baseline], seconds: float) -> None:
        """Try these forms until this much CPU time, s, has passed since the search began."""
        for each in dict.fromkeys(forms):
            if each in self.outcomes:
                continue
            if self.cpu > seconds:
                self.left_out += 1
                continue
            self.outcomes[each] = self._outcome(each)

    def closed_form(self, baseline: Baseline):
        """The closed form of a baseline. The last one is kept, because the next form often differs only in its ridge.
        """
        if baseline.regression not in self._closed:
            self._closed = {baseline.regression: KINDS[baseline.kind](self.trial.samples, baseline)}
        return self._closed[baseline.regression]

    def _outcome(self, baseline: Baseline) -> Outcome:
        trial = self.trial
        try:
            closed = self.closed_form(baseline)
            models = [closed.model(baseline.ridge, fold) for fold in range(FOLDS)]
            with np.errstate(over="ignore", invalid="ignore"):  # a diverged model gets an infinite score
                predictions = [trial.predicted(model, starts) for model, starts in zip(models, trial.held_out)]
                found = trial.judged([*predictions, *(trial.predicted(model, trial.fast) for model in models)])
        except (np.linalg.LinAlgError, ValueError):
            return FAILED
        return replace(found, predictions=[])

    def best(self) -> list[Baseline]:
        """All forms that were tried and did not diverge, the lowest score first."""
        return sorted((each for each, found in self.outcomes.items() if np.isfinite(found.score)),
                      key=lambda each: self.outcomes[each].score)


def _forms(trial: Trial, kind: str) -> Iterable[Baseline]:
    """Forms of a kind with all coordinates, delays and sizes. Small ones come first, because the time may run out."""
    names: Sequence[str] = list(trial.samples.coordinates)
    if kind in LIFTINGS:
        yield from (Baseline(kind, name, delays, past) for delays in (1, 2, 4, 8)
                    for past in ((0,) if kind == "static_pregain" else sorted({1, delays})) for name in names)
    elif kind == "ssmr_control_augmented":
        yield from (Baseline(kind, name, delays, delays, states) for states in (6, 10, 14) for delays in (4, 10)
                    for name in names)
    else:
        yield from (Baseline(kind, name, delays, 0, states) for states in (4, 6, 10, 14) for delays in (1, 2, 4)
                    for name in names)
