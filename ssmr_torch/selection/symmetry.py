"""Symmetries of a robot, found in its training runs or stated by the user; the runs are then used again, turned.

The response of a linear model to input steps suggests turns. A turn is used if models that are also fitted to the
turned copies predict the held-out parts better than models without copies. A copy is in the same fold as its original.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ssmr_torch.models.polynomial import PolynomialModel
from ssmr_torch.selection.closed_form import ALL, ClosedForm
from ssmr_torch.selection.folds_and_starts import Samples, Starts
from ssmr_torch.selection.rollouts import rolled_out
from ssmr_torch.selection.specification import Specification
from ssmr_torch.selection.stability import decays_at_rest
from ssmr_torch.selection.suggested_turns import NEAR, placed, suggested
from ssmr_torch.selection.trial import Trial
from ssmr_torch.symmetry_turns import Turn, closed, marker_size, stated

STEP, INSTANTS = 1.0, 10    # length in s and number of samples of the responses that are compared
SIGNED = 0.5                # an input counts as signed if its smaller extreme exceeds this share of its larger one
TIE = 1.03                  # errors within this factor count as equal; the larger of two such groups of turns is used
RIVALS = 20                 # number of specifications that are also fitted without copies
LINEAR = [Specification(delays=delays, memory=("shift", delays)) for delays in (4, 2, 1)]
FORMS = (Specification(features="configuration_affine", ridge=1e-2),
         Specification(delays=4, memory=("shift", 4), features="bilinear"),
         Specification(delays=2, features="configuration_affine"),
         Specification(delays=4, memory=("shift", 4), features="configuration_affine", ridge=1e-3))


@dataclass(frozen=True, eq=False)
class Symmetric:
    """trial: the trial on the runs and their turned copies; turns: the symmetries; found: a sentence about them; plain:
    the trial without copies.
    """

    trial: Trial
    turns: list[Turn] = field(default_factory=list)
    found: str = ""
    plain: Trial | None = None

    def kept(self) -> Symmetric:
        """The better of both, after specifications were tried: with the turned copies, or without them."""
        best = self.trial.best(RIVALS)
        if self.plain is None or not best:
            return self
        with_copies = self.trial.outcomes[best[0]].score
        without = min(self.plain(each) for each in best[:3])
        if with_copies <= without:
            return self
        for each in best[3:]:
            self.plain(each)
        return Symmetric(self.plain, [], f"{self.found} But the best model predicts better without the turned runs "
                                         f"(score {without:.3f}, with them {with_copies:.3f}), so they are not used.")


def with_symmetry(make: Callable[[Sequence[Turn]], Trial], wish: str | Mapping,
                  input_names: Sequence[str] | None = None) -> Symmetric:
    """The trial that uses the symmetries of the runs. make: builds a trial on the runs and their turned copies.

    wish: "find", "none", or a symmetry in the form of `ssmr_torch.symmetry_turns.stated`, which is used without a test.
    Raises ValueError for an invalid symmetry.
    """
    plain = make(())
    if wish == "none":
        return Symmetric(plain)
    samples = plain.samples
    names = [str(k + 1) for k in range(samples.input_dim)] if input_names is None else list(input_names)
    told = None if wish == "find" else stated(wish, names, samples.output_dim)
    try:
        G = response(samples)
    except (ValueError, np.linalg.LinAlgError):
        G = None
    if told is not None:
        turn = told if G is None else placed(G, told)
        return _used(plain, make(closed([turn])), _as_stated(turn, G, names), judged=False)
    if G is None:
        return Symmetric(plain, found="No symmetry was searched: no linear model of the runs is stable.")
    if not marker_size(samples.output_dim):
        return Symmetric(plain, found=f"No symmetry was searched: {samples.output_dim} outputs are not markers with 3 "
                                      "or 2 coordinates each.")
    return _found(make, plain, G, names)


def response(samples: Samples) -> np.ndarray:
    """Responses G (H, p, m), m, of a linear model to a step of each input; the step is the mean spread of the inputs.

    Raises ValueError if no linear model of the runs is stable.
    """
    model, m = _stable_linear(samples), samples.input_dim
    steps = max(INSTANTS, round(STEP / samples.timestep))
    inputs = np.tile(samples.input_mean, (m + 1, steps, 1))
    inputs[1:] += samples.input_scale.mean() * np.eye(m)[:, None]
    window = np.zeros((m + 1, samples.past + 1, samples.output_dim))
    past = np.tile(samples.input_mean, (m + 1, samples.past, 1))
    y = rolled_out(model, Starts(window, past, inputs, window[:, :0]))
    at = np.linspace(0, steps - 1, INSTANTS + 1).astype(int)[1:]
    return (y[1:, at] - y[:1, at]).transpose(1, 2, 0)


def _stable_linear(samples: Samples) -> PolynomialModel:
    for form in LINEAR:
        model = ClosedForm(samples, form).model(form.ridge, ALL)
        if decays_at_rest(model):
            return model
    raise ValueError("no linear model of the runs is stable; record longer runs")


def groups(turns: Sequence[Turn]) -> list[list[Turn]]:
    """Groups of turns that are tried, by their generators: all turns that form a group, the largest group of one
    rotation, the best rotation alone, and the best reflection alone.
    """
    if not turns:
        return []
    rotations, reflections = ([turn for turn in turns if (np.linalg.det(turn.isometry) > 0) == kept]
                              for kept in (True, False))
    largest = sorted(rotations, key=lambda turn: -len(closed([turn])))[:1]
    together: list[Turn] = []
    for turn in [*largest, *turns]:
        already = together and any(turn.same(each) for each in closed(together))
        if not already and closed([*together, turn]):
            together.append(turn)
    chosen: list[list[Turn]] = []
    for generators in (together, largest, rotations[:1], reflections[:1]):
        if generators and not any(_same(generators, each) for each in chosen):
            chosen.append(generators)
    return chosen


def _same(some: Sequence[Turn], others: Sequence[Turn]) -> bool:
    one, other = closed(some), closed(others)
    return len(one) == len(other) and all(any(a.same(b) for b in other) for a in one)


def _found(make, plain: Trial, G: np.ndarray, names: list[str]) -> Symmetric:
    samples = plain.samples
    inputs = np.concatenate([u for _, u in samples.controlled])
    least, most = np.maximum(-inputs.min(0), 0.0), np.maximum(inputs.max(0), 0.0)
    signed = np.minimum(least, most) > SIGNED * np.maximum(least, most)
    turns = [suggested(G, signed, samples.input_scale, inferred) for inferred in (False, True)]
    if not any(turns):
        return Symmetric(plain, found="No symmetry was found: turns by 60°, 90°, 120° and 180° and reflections, with "
                                      f"the inputs renumbered, change the response to steps by {100 * NEAR:.0f} % or "
                                      "more.")
    for form in FORMS:
        for name in samples.coordinates:
            plain(replace(form, coordinates=name))
    form = min(plain.outcomes, key=lambda each: _value(plain, each))
    if not np.isfinite(_value(plain, form)):
        return Symmetric(plain, found="No symmetry was used: no model of the runs is good enough to test it.")
    tried = [(make(closed(generators)), generators) for each in turns for generators in groups(each)]
    tied = min(_value(each, form) for each, _ in tried) + np.log(TIE)
    trial, generators = max((each for each in tried if _value(each[0], form) <= tied),
                            key=lambda each: (len(each[0].samples.turns), -_value(each[0], form)))
    before, after = (_error(each, form) for each in (plain, trial))
    words = _words(generators, G, names)
    if not (_value(trial, form) < _value(plain, form) and after < TIE * before):
        return Symmetric(plain, found=f"No symmetry was used. {words}, but with the turned runs the error on held-out "
                                      f"parts is {after / before:.2f} times the error without them (score "
                                      f"{_value(trial, form):.3f}, without {_value(plain, form):.3f}).")
    return _used(plain, trial, f"{words}: the runs were used {1 + len(trial.samples.turns)} times, because the error "
                               f"on held-out parts is then {after / before:.2f} times the error without.")


def _used(plain: Trial, trial: Trial, found: str, judged: bool = True) -> Symmetric:
    trial.began = plain.began
    return Symmetric(trial, list(trial.samples.turns), found, plain if judged else None)


def _value(trial: Trial, form: Specification) -> float:
    """The score without the penalty for single diverged rollouts, because with few runs most models have one."""
    trial(form)
    outcome = trial.outcomes[form]
    return float(0.5 * np.log(outcome.e ** 2 + outcome.v ** 2)[trial.horizons].mean())


def _error(trial: Trial, form: Specification) -> float:
    """Error on the held-out parts, as geometric mean over the horizons that count."""
    return float(np.exp(np.log(trial.outcomes[form].e[trial.horizons]).mean()))


def _words(turns: Sequence[Turn], G: np.ndarray, names: list[str]) -> str:
    """A sentence on the turns and on how well they leave the response unchanged."""
    each = " and a ".join(f"{turn.name} with the inputs renumbered ({turn.renumbering(names)})" for turn in turns)
    return (f"A {each} {'leave' if len(turns) > 1 else 'leaves'} the response to steps unchanged to "
            f"{100 * max(turn.missed(G) for turn in turns):.2g} %")


def _as_stated(turn: Turn, G: np.ndarray | None, names: list[str]) -> str:
    if G is None:
        return f"As stated, a {turn.name} ({turn.renumbering(names)}) is a symmetry; the runs cannot confirm it."
    doubtful = " (this is much: check the axis and the order of the inputs)" if turn.missed(G) > NEAR else ""
    return f"As stated: {_words([turn], G, names)}{doubtful}: the runs were used {1 + len(closed([turn]))} times."
