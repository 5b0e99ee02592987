"""Search over specifications in stages: charts, memory, decays, features, size, fast state."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np

from ssmr_torch.selection.specification import Specification
from ssmr_torch.selection.trial import Trial

FIRST = (("bilinear", 0, 1e-4), ("configuration_affine", 0, 1e-3), ("cubic", 3, 1e-4), ("full_quadratic", 0, 1e-5))
FIBRE = 12                          # number of fast states, if they are tried
RIDGES = (1e-6, 1e-4, 1e-2)
ACTUATORS = (0.02, 0.05, 0.1, 0.2)  # s, time constants


def search(trial: Trial, *, decays: bool, minutes: float = np.inf,
           say: Callable[[str], None] = lambda line: None) -> None:
    """Try specifications until all stages are done or the time is over; the results are in `trial.outcomes`."""
    def stage(name: str, specifications: Iterable[Specification]) -> None:
        chosen = [each for each in dict.fromkeys(specifications) if each not in trial.outcomes]
        for each in sorted(chosen, key=lambda each: str(each.regression)):
            if trial.cpu > 60.0 * minutes:
                trial.left_out += 1
                continue
            trial(each)
        best = trial.best(1)
        if best:
            found = trial.outcomes[best[0]]
            say(f"{name}: {len(trial.outcomes)} tried, best {found.score:.4f} {best[0]} "
                f"e {np.round(found.e, 4)} v {np.round(found.v, 4)} cpu {trial.cpu:.0f}")

    names = list(trial.samples.coordinates)
    stage("charts", _first(names, decays))
    poles = [("pole", round(float(np.exp(-trial.samples.timestep / tau)), 4)) for tau in ACTUATORS]
    stage("memory", (replace(each, memory=memory) for each in _charts(trial, 3)
                     for memory in [("shift", k) for k in (1, 4, 8)] + poles))
    stage("decays", (replace(each, decays=False) for each in _charts(trial, 3) if decays))
    stage("features", (replace(each, features=features, leading=leading, ridge=ridge)
                       for each in _charts(trial, 2) for features, leading in _FEATURES
                       for ridge in ((1e-4,) if features == "linear" else RIDGES)))
    stage("size", (changed for each in _charts(trial, 2) for changed in _sizes(each)))
    stage("memory", (replace(each, memory=memory) for each in _charts(trial, 2) for memory in _memories(each, poles)))
    stage("decays", (replace(each, decays=not each.decays) for each in _charts(trial, 2) if decays))
    stage("fibre", (replace(each, fibre=FIBRE) for each in trial.best(3)))


_FEATURES = (("linear", 0), ("quadratic_map", 0), ("bilinear", 0), ("leading_bilinear", 0), ("quadratic", 0),
             ("configuration_affine", 0),
             ("configuration_affine", 3), ("leading_cubic", 0), ("cubic", 0), ("cubic", 3), ("full_quadratic", 0))


def _first(names: list[str], decays: bool) -> Iterable[Specification]:
    for name in names:
        for delays in (1, 2, 4, 8):
            for steps in sorted({1, delays}):
                for features, leading, ridge in (*FIRST, ("linear", 0, 1e-4), ("quadratic_map", 0, 1e-4)):
                    yield Specification(name, "delay", delays=delays, memory=("shift", steps), features=features,
                                        leading=leading, ridge=ridge)
        for states in (8, 14, 20):
            for future in (3, 10):
                for features, leading, ridge in (*FIRST[:3], ("linear", 0, 1e-4)):
                    yield Specification(name, "predictive", states, 12, future, features=features, leading=leading,
                                        ridge=ridge)
        if decays:
            yield from (Specification(name, "tangent_space", states, 12) for states in (8, 12))


def _charts(trial: Trial, count: int) -> list[Specification]:
    """The best specification of each of the best charts, with at least two kinds of chart among them."""
    def key(each: Specification):
        return each.coordinates, each.chart, each.states, each.delays, each.future

    best = {}
    for each in trial.best(60):
        best.setdefault(key(each), each)
    for kind in ("delay", "predictive"):
        for each in trial.best(1, lambda each, kind=kind: each.chart == kind):
            best.setdefault(key(each), each)
    kinds: dict[str, Specification] = {}
    for each in best.values():
        kinds.setdefault(each.chart, each)
    first = list(kinds.values())[:2]
    rest = [each for each in best.values() if each not in first]
    return sorted([*first, *rest[:max(0, count - len(first))]], key=lambda each: trial.outcomes[each].score)


def _sizes(each: Specification) -> Iterable[Specification]:
    if each.chart == "delay":
        yield from (replace(each, delays=delays) for delays in (2, 3, 6, 10))
        return
    for more in (-4, 0, 4):
        for delays in (each.delays, 19):
            if each.states + more > 1:
                yield replace(each, states=each.states + more, delays=delays)


def _memories(each: Specification, poles: list) -> list:
    if each.pole:
        return [("pole", round(each.memory[1] ** power, 4)) for power in (0.6, 0.8, 1.25, 1.6)]
    return poles[1:3]
