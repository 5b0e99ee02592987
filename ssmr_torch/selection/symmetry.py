"""Symmetries of a robot, found in its training runs or stated: whether the runs are used once more, turned.

A linear model's response to steps of the inputs suggests turns; a turn is used if models that learn from the turned
copies, too, predict what the folds hold out better than models that do not, copies and original in the same fold.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ssmr_torch.models.polynomial import PolynomialModel
from ssmr_torch.selection.candidate import ALL, ClosedForm
from ssmr_torch.selection.rollouts import rolled_out
from ssmr_torch.selection.samples import Samples, Starts
from ssmr_torch.selection.specification import Specification
from ssmr_torch.selection.stability import decays_at_rest
from ssmr_torch.selection.suggested_turns import NEAR, placed, suggested
from ssmr_torch.selection.trial import Trial
from ssmr_torch.turns import Turn, closed, marker_size, stated

STEP, INSTANTS = 1.0, 10    # s and samples of the responses that are compared
SIGNED = 0.5                # of an input's largest value, that it takes with the other sign, too
TIE = 1.03                  # times an error, that is no difference: of two such groups of turns the larger is used
RIVALS = 20                 # specifications whose fits without copies are looked at, where the best does without
LINEAR = [Specification(delays=delays, memory=("shift", delays)) for delays in (4, 2, 1)]
FORMS = (Specification(features="configuration_affine", ridge=1e-2),
         Specification(delays=4, memory=("shift", 4), features="bilinear"),
         Specification(delays=2, features="configuration_affine"),
         Specification(delays=4, memory=("shift", 4), features="configuration_affine", ridge=1e-3))


@dataclass(frozen=True, eq=False)
class Symmetric:
    """trial: on the runs and their turned copies; turns: by which; found: in words; plain: the trial without copies."""

    trial: Trial
    turns: list[Turn] = field(default_factory=list)
    found: str = ""
    plain: Trial | None = None

    def kept(self) -> Symmetric:
        """What predicts better, once specifications have been tried: this, or the runs as they are."""
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
                                         f"(score {without:.3f}, with them {with_copies:.3f}): they were left out.")


def with_symmetry(make: Callable[[Sequence[Turn]], Trial], wish: str | Mapping,
                  input_names: Sequence[str] | None = None) -> Symmetric:
    """The trial that uses what symmetry there is; make: a trial on the runs and their copies by turns.

    wish: "find", "none", or a symmetry as `ssmr_torch.turns.stated` takes it, which is used without being judged.
    Raises ValueError for a symmetry that makes no sense.
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
        return Symmetric(plain, found="No symmetry was looked for: the runs determine no stable linear response.")
    if not marker_size(samples.output_dim):
        return Symmetric(plain, found=f"No symmetry was looked for: {samples.output_dim} outputs are no markers of 3 "
                                      "or 2 coordinates.")
    return _found(make, plain, G, names)


def response(samples: Samples) -> np.ndarray:
    """Responses G (H, p, m) of a linear model to a step of each input, of the size of the inputs' mean spread, m.

    Raises ValueError where no linear model of the runs is stable.
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
    """What is tried: all turns that fit together, the largest group of one rotation, the best rotation and reflection
    alone; as generators.
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
        return Symmetric(plain, found="No symmetry was used: no model of the runs judges it.")
    tried = [(make(closed(generators)), generators) for each in turns for generators in groups(each)]
    tied = min(_value(each, form) for each, _ in tried) + np.log(TIE)
    trial, generators = max((each for each in tried if _value(each[0], form) <= tied),
                            key=lambda each: (len(each[0].samples.turns), -_value(each[0], form)))
    before, after = (_error(each, form) for each in (plain, trial))
    words = _words(generators, G, names)
    if not (_value(trial, form) < _value(plain, form) and after < TIE * before):
        return Symmetric(plain, found=f"No symmetry was used. {words}, but with runs turned so the error on stretches "
                                      f"held out is {after / before:.2f} times that without (score "
                                      f"{_value(trial, form):.3f}, without {_value(plain, form):.3f}).")
    return _used(plain, trial, f"{words}: the runs were used {1 + len(trial.samples.turns)} times, for the error on "
                               f"stretches held out is {after / before:.2f} times that without.")


def _used(plain: Trial, trial: Trial, found: str, judged: bool = True) -> Symmetric:
    trial.began = plain.began
    return Symmetric(trial, list(trial.samples.turns), found, plain if judged else None)


def _value(trial: Trial, form: Specification) -> float:
    """The score as if no single rollout were a reason to refuse: of few runs, most models lose one."""
    trial(form)
    outcome = trial.outcomes[form]
    return float(0.5 * np.log(outcome.e ** 2 + outcome.v ** 2)[trial.horizons].mean())


def _error(trial: Trial, form: Specification) -> float:
    """Geometric mean over the horizons that count of the error on what the folds hold out."""
    return float(np.exp(np.log(trial.outcomes[form].e[trial.horizons]).mean()))


def _words(turns: Sequence[Turn], G: np.ndarray, names: list[str]) -> str:
    """What is done, and what it leaves unchanged."""
    each = " and a ".join(f"{turn.name} with the inputs renumbered ({turn.renumbering(names)})" for turn in turns)
    return (f"A {each} {'leave' if len(turns) > 1 else 'leaves'} the response to steps unchanged to "
            f"{100 * max(turn.missed(G) for turn in turns):.2g} %")


def _as_stated(turn: Turn, G: np.ndarray | None, names: list[str]) -> str:
    if G is None:
        return f"As stated, a {turn.name} ({turn.renumbering(names)}) is a symmetry; the runs cannot tell."
    doubtful = " (this is much: look whether axis and order of the inputs are right)" if turn.missed(G) > NEAR else ""
    return f"As stated: {_words([turn], G, names)}{doubtful}: the runs were used {1 + len(closed([turn]))} times."
